"""
Draw docs/figures/place.svg: a place, its votes, its shape and what comes of them.

python docs/place.py [SEED]: flies over a simulated town and takes the voxel whose label the method
geometry changes against the largest majority, among those with many looks.

"""

from dataclasses import replace
from pathlib import Path
import sys

import matplotlib
import numpy as np
from persem_ros.core.geometry.account import account
from persem_ros.core.refine.snapshot import take
from persem_ros.core.refine.whole import refine
from persem_ros.pipeline import Pipeline
from persem_ros.settings.config import Config
from persem_ros.simulate.flight import Flight, Plan

matplotlib.use('Agg')
from matplotlib import pyplot  # noqa: E402, I100

TILTS, ROUGH = ('upright', 'sloping', 'level', 'no normal'), ('smooth', 'rough', 'scattered')
LOOKS = 12          # a place has been seen at least so often
AROUND = 12         # voxels on each side of it in the picture


def main():
    """Fly, choose, draw."""
    seed = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    plan = Plan(frames=60, width=320, height=240, rate=2.5, seed=seed)
    flight, config = Flight(plan, workers=1), Config()
    pipeline, settings = Pipeline(config), replace(config.refine, method='geometry')
    for frame in flight.frames():
        pipeline.add(frame)
    memory, legend = pipeline.memory, flight.legend
    refine(memory, settings)
    columns = memory.voxels()
    chosen = np.flatnonzero((columns['source'] == 4) & (columns['observations'] >= LOOKS)
                            & (columns['confidence'] > 0.95))
    own = [memory.evidence(columns['voxel'][row]) for row in chosen]
    share = [e[columns['majority'][row]] / sum(e.values()) for row, e in zip(chosen, own)]
    row = chosen[int(np.argmax(share))]
    found = account(memory, take(memory), int(columns['number'][row]), settings, memory.geometry)
    figure = draw(columns, row, found, legend, memory.voxel_size)
    out = Path(__file__).parent / 'figures' / 'place.svg'
    figure.savefig(out, metadata={'Date': None})
    print(f'{out}: voxel {columns["voxel"][row].tolist()}, seed {seed}')


def draw(columns, row, found, legend, size):
    """Return the figure of a voxel: its surroundings, and what account() found of it."""
    pyplot.rcParams.update({'svg.hashsalt': 'place', 'font.size': 9})
    figure, axes = pyplot.subplots(1, 6, figsize=(13, 3), constrained_layout=True,
                                   gridspec_kw={'width_ratios': [1.2, 1, 1, 1, 1, 1]})
    place = columns['voxel'][row]
    near = np.flatnonzero((np.abs(columns['voxel'] - place)[:, :2] <= AROUND).all(axis=1))
    near = near[np.argsort(columns['voxel'][near, 2], kind='stable')]       # the highest last
    at = (columns['voxel'][near] - place)[:, :2] + AROUND
    seen = np.ones((2 * AROUND + 1, 2 * AROUND + 1, 3))
    for (i, j), c in zip(at.tolist(), columns['majority'][near].tolist()):
        seen[j, i] = np.array(legend.color(c)) / 255
    edge = (AROUND + 0.5) * size
    axes[0].imshow(seen, origin='lower', extent=(-edge, edge, -edge, edge))
    axes[0].scatter([0], [0], s=60, marker='s', facecolors='none', edgecolors='r', linewidths=2)
    axes[0].set(xlabel='m', title='a place from above,\nby majority')
    classes = sorted(found['posterior'])
    for ax, name, title in zip(axes[1:], ('votes', 'shape', 'cell', 'neighbours', 'posterior'), (
            f'votes: {found["looks"]:.1f} directions\nworth {found["independent"]:.1f} looks',
            f'{found["height"] * size:g} m up, {TILTS[found["tilt"]]},\n'
            f'{ROUGH[found["roughness"]]}: called', 'its kind in its area:\ncalled',
            'its neighbours\nsay', 'hence')):
        values = [found[name].get(c, 0.0) for c in classes]
        ax.barh(range(len(classes)), values,
                color=[np.array(legend.color(c)) / 255 for c in classes], edgecolor='0.4')
        ax.set(xlim=(0, 1), title=title, yticks=range(len(classes)), yticklabels=[])
        ax.invert_yaxis()
    axes[1].set_yticklabels([legend.name(c) for c in classes])
    return figure


if __name__ == '__main__':
    main()
