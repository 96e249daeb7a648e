"""Settings of what goes out: the map and its file, grids for vehicles."""

from __future__ import annotations

from dataclasses import dataclass

from persem_ros.settings.setting import setting


@dataclass(frozen=True)
class Map:
    """The map as a whole."""

    path: str = setting('', 'map file to load and save (.persem); empty: none')
    load: bool = setting(False, 'load map.path at the start (node; a replay always does)',
                         live=False)
    save: bool = setting(False, 'save to map.path at the end (node)')
    attached: bool = setting(
        False, 'map.path is the living map, memory holds a part of it; implies load and save, '
        'and nothing is ever forgotten', live=False)
    checkpoint: float = setting(10.0, 'time between two checkpoints of an attached map (node)',
                                's', 0.1, 3600.0)
    rate: float = setting(0.5, 'how often ~/map is published where it changed (node); 0: never',
                          'Hz', 0.0, 50.0)
    max_voxels: int = setting(0, 'voxels in ~/map (node: 2 000 000); 0: all', 'voxels', 0,
                              1 << 32)
    show: str = setting(
        'nearest', 'which voxels ~/map shows where map.max_voxels does not do: the nearest or the '
        'most observed ones (node)', choices=('nearest', 'observed'))
    min_observations: int = setting(1, 'voxels with fewer are left out of ~/map (node)',
                                    'observations', 1, 1 << 20)
    crop: float = setting(
        0.0, 'voxels farther from the camera are left out of ~/map (node); 0: none', 'm', 0.0, 1e6)
    on_time_jump: str = setting(
        'keep', 'what becomes of the map when time goes back, as in a recording that loops (node)',
        choices=('keep', 'reset'))
    origin: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0),
        'point of the map frame that is subtracted from all positions (UTM coordinates)', 'm',
        live=False)
    crs: str = setting(
        '', 'coordinate reference system of exported files, EPSG:25832; empty: none; persem map '
        'georeference enters it into a map file')
    georeference: tuple[float, float, float, float] = setting(
        (0.0, 0.0, 0.0, 0.0),
        'where the map frame lies in map.crs: east, north and up of its origin (m), and its turn '
        'counter-clockwise (degrees)')


@dataclass(frozen=True)
class Grid:
    """The map as a cost map for vehicles on the ground."""

    resolution: float = setting(
        0.0, 'edge of a cell of the grid; 0: that of a voxel, finer is not possible', 'm', 0.0,
        1e3)
    step: float = setting(
        0.3, 'what is higher above the ground than this, and lower than grid.height, is an '
        'obstacle whatever its class', 'm', 0.0, 1e3)
    height: float = setting(2.0, 'what is higher above the ground than this is no obstacle', 'm',
                            0.0, 1e4)
    window: int = setting(20, 'columns around one whose lowest voxels make its ground', 'voxels',
                          0, 1000)
    min_observations: int = setting(2, 'voxels with fewer are left out of the grid',
                                    'observations', 1, 1 << 20)
    tie: str = setting(
        'highest', 'the cost of a cell whose columns of voxels differ in theirs',
        choices=('highest', 'lowest', 'unknown'))
    labels: str = setting('top', 'class of a cell in the grid of classes: that of the top-most '
                          'voxel or of the ground', choices=('top', 'ground'))
    rate: float = setting(1.0, 'how often ~/grid is published where it changed (node); 0: never',
                          'Hz', 0.0, 50.0)
