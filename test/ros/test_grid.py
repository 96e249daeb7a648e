"""~/grid and ~/grid_labels: what the export of the same map says, and updates that add up."""

import bags
from harness import LATCHED, Player, until
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid
import numpy as np
from persem_ros.outputs.export.choice import Choice
from persem_ros.outputs.export.nav2 import grid_of
from persem_ros.outputs.export.source import MapSource

FRAMES = 8
LEGEND = 'classes:\n' + '\n'.join(f'- {{id: {c}, name: c{c}, cost: {20 * c}}}'
                                  for c in range(1, 5)) + '\n'
GRID = {'grid.rate': 10.0, 'grid.min_observations': 1, 'grid.window': 3, 'grid.height': 1.0}


def known(grid, values=None):
    """Return {(x, y): value} of the known cells of an OccupancyGrid, counted from the origin."""
    values = np.array(grid.data, np.int8).reshape(grid.info.height, grid.info.width) \
        if values is None else values
    x0, y0 = (round(v / grid.info.resolution) for v in (grid.info.origin.position.x,
                                                        grid.info.origin.position.y))
    return {(int(x) + x0, int(y) + y0): int(values[y, x]) for y, x in zip(*np.nonzero(
        values >= 0))}


def summed(wholes, updates):
    """Return the known cells of the last whole grid with the updates that came after it."""
    grid = wholes[-1]
    values = np.array(grid.data, np.int8).reshape(grid.info.height, grid.info.width)
    for update in list(updates):
        if (update.header.stamp.sec, update.header.stamp.nanosec) >= (
                grid.header.stamp.sec, grid.header.stamp.nanosec):
            values[update.y:update.y + update.height, update.x:update.x + update.width] = \
                np.array(update.data, np.int8).reshape(update.height, update.width)
    return known(grid, values)


def test_the_grid_is_that_of_the_map(ros, tmp_path):
    (tmp_path / 'legend.yaml').write_text(LEGEND)
    mapper = ros.mapper({**GRID, 'labels.legend': str(tmp_path / 'legend.yaml'),
                         'map.path': str(tmp_path / 'm.persem')}).ready()
    heard = {name: (ros.client.listen(OccupancyGrid, f'/mapper/{name}', LATCHED),
                    ros.client.listen(OccupancyGridUpdate, f'/mapper/{name}_updates'))
             for name in ('grid', 'grid_labels')}
    Player(ros.client, bags.write(tmp_path / 'bag', FRAMES)).play()
    mapper.frames(FRAMES)
    assert mapper.call('refine')[0] and mapper.call('save_map')[0]
    wanted = grid_of(MapSource(tmp_path / 'm.persem'), Choice())
    y, x = np.nonzero(wanted.cost >= 0)
    for name, layer in (('grid', wanted.cost), ('grid_labels', wanted.label)):
        cells = {(int(i) + wanted.corner[0], int(j) + wanted.corner[1]): int(layer[j, i])
                 for i, j in zip(x, y)}
        until(lambda: heard[name][0] and summed(*heard[name]).items() >= cells.items(),
              lambda: f'{name}: {heard[name][0] and len(summed(*heard[name]))} of {len(cells)}')
        assert heard[name][0][-1].header.frame_id == 'map'
    # Nothing changes any more: a late listener is told the whole grid.
    late = ros.client.listen(OccupancyGrid, '/mapper/grid', LATCHED)
    until(lambda: late and known(late[-1]) == summed(*heard['grid']), 'the whole grid')


def test_a_legend_without_costs_is_said_once(ros, tmp_path):
    mapper = ros.mapper(GRID).ready()
    grids = ros.client.listen(OccupancyGrid, '/mapper/grid', LATCHED)
    Player(ros.client, bags.write(tmp_path / 'bag', 3)).play()
    mapper.frames(3)
    mapper.says('no /mapper/grid: a grid needs costs of the classes, but the legend is empty')
    assert mapper.call('refine')[0]
    assert not grids and mapper.output.count('a grid needs costs') == 1
