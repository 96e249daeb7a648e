"""
A map file as NumPy columns: which places are uncertain, what was seen there, and why.

Give it a map file: python examples/look_into_a_map.py demo/result/map.persem; without one it makes
a small map itself. In a notebook, m.table() is the same as a pandas table.

"""

from pathlib import Path
import runpy
import sys
from tempfile import TemporaryDirectory

import numpy as np
import persem_ros
from persem_ros.outputs.map.store import save


def small_map(folder):
    """Map the wall of quickstart.py, which lies beside this file; return the map file."""
    made = runpy.run_path(str(Path(__file__).with_name('quickstart.py')))
    save(folder / 'map.persem', made['pipeline'].memory, made['pipeline'].config)
    return folder / 'map.persem'


with TemporaryDirectory() as folder:
    m = persem_ros.open_map(sys.argv[1] if len(sys.argv) > 1 else small_map(Path(folder)))
    print(m)
    for label, voxels in m.counts().items():
        print(f'{m.legend.name(label):>12} {voxels:>8} voxels')

    columns = m.columns(min_observations=3)         # NumPy arrays, a row a voxel
    ids, shares = m.probabilities(min_observations=3)       # the same rows, a column a class
    entropy = -(shares * np.log(shares.clip(1e-9))).sum(axis=1)
    worst = int(np.argmax(entropy))
    x, y, z = columns['xyz'][worst]
    print(f'\nmost uncertain: {x:.2f} {y:.2f} {z:.2f} m, entropy {entropy[worst]:.2f} nat')

    history = m.history(x, y, z)                    # what was seen there, oldest first
    for label, stamp, eye in zip(history['label'], history['stamp'], history['position']):
        print(f'  {stamp / 1e9:.1f} s, from {np.round(eye, 1)}: {m.legend.name(label)}')
    explanation = m.explain(x, y, z)                # why it has its label: as persem map query
    print(f'\n{explanation}')

    low, high = columns['xyz'].min(axis=0) - 1, columns['xyz'].mean(axis=0) + 1
    corner = m.columns(box=(*low, *high))           # only a part; chunks() for maps beyond memory
    print(f'\n{len(corner["label"])} of {len(m)} voxels in the lower corner')
