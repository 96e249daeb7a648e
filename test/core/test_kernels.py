"""Kernels: compiled once, for one kind of arrays, and cached."""

from contextlib import suppress
import gc
import subprocess
import sys
import weakref

from persem_ros.core import jit
from persem_ros.core.warmup import TURN, warm_up

# Those that only kernels call.
INSIDE = {'more_cubes', 'wider', 'log_theta', 'find_shapes'}

SCRIPT = """
import numpy as np
from persem_ros.core import jit
from persem_ros.core.warmup import warm_up

warm_up()
before = jit.signatures()

from dataclasses import replace
from persem_ros.settings.config import METHODS, Memory, Refine
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.evict import keep_near
from persem_ros.core.frame.clear import clear
from persem_ros.core.frame.images import points
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.frame.median import median_depth
from persem_ros.core.frame.observe import observe
from persem_ros.core.frame.place import measured_points, place
from persem_ros.core.refine.job import abandon, finish
from persem_ros.core.refine.labelled import label
from persem_ros.core.refine.turns import begin, begin_next
from persem_ros.core.refine.whole import refine
from persem_ros.core.refine.regions import regions
from persem_ros.core.frame.render import filled, render, voxel_image, voxel_image_of
from persem_ros.core.frame.smoothing import EmaImages
from persem_ros.core.frame.stride import thinned
from persem_ros.core.memory.loading import load
from persem_ros.frames import Frame, pinhole

rng = np.random.default_rng(0)
memory = VoxelMemory(0.3, origin=(1, 2, 3), max_history=9)
smooth = EmaImages(0.5)

def frozen(a):
    a.setflags(write=False)
    return a

def kinds(shape):
    labels = rng.integers(-1, 9, shape).astype(np.int32)
    depth = rng.uniform(0, 5, shape)
    yield labels, depth
    yield frozen(labels.copy()), frozen(depth.copy())
    yield np.asfortranarray(labels), depth.astype(np.float32)
    yield labels.astype(np.int64), depth.astype('>f8')
    yield np.abs(labels).astype(np.uint8), np.repeat(depth, 2, 1)[:, ::2]
    yield labels[::2, ::2], depth

stamp = 0
for shape in ((4, 6), (240, 320), (2, 2)):
    for labels, depth in kinds(shape):
        h, w = depth.shape
        stamp += 1
        frame = Frame(stamp, labels, depth, pinhole(w, h, 50, 50, w / 2, h / 2))
        thinned(frame, Memory(stride=0))
        median_depth(depth, 0.0, 1.0)
        clear(memory, frame, Memory(clear_after=1))
        placed, ids = points(frame, Memory())
        seen = observe(placed, ids, frame.T_map_camera.astype(np.float32), 0.3, stamp=stamp)
        memory.add(seen)
        shown = voxel_image(memory, seen, depth.shape)
        voxel_image_of(
            memory, *place(measured_points(placed), frame.T_map_camera, memory.voxel_size),
            depth.shape)
        for method in METHODS:
            found, _ = label(memory, method, Refine())
            filled(render(shown, frozen(found)), labels, Memory())
        smooth.update(labels)
        refine(memory, replace(Refine(), method=METHODS[stamp % 10]), full=stamp % 3 == 0)
    if stamp % 6 == 0:
        geometry = replace(Refine(), method='geometry', sweep=1 + memory.n_voxels // 3)
        for k in range(9):
            job = begin_next(memory, geometry, k == 0)
            finish(job, *job.compute())
abandon(begin(memory, Refine()))
observe([], [], np.eye(4), 1)
observe([[1, 2, 3]], [4], np.eye(4).tolist(), 1, 1, (0, 0, 0))
memory = load(dump(memory))
regions(memory, 6)
memory.history(memory.voxels()['voxel'][0])
memory.evidence([int(i) for i in memory.voxels()['voxel'][0]])
memory.find([[0, 0, 0]])
memory.volatility()
assert keep_near(memory, [1, 2, 3], 1.0, 10) > 0
refine(memory, Refine(), full=False)

after = jit.signatures()
for name in sorted(after):
    print(name, before.get(name, 0), after[name])
"""


def test_nothing_compiles_after_warm_up():
    out = subprocess.run([sys.executable, '-c', SCRIPT], check=True, capture_output=True,
                         text=True).stdout
    counts = {name: (int(before), int(after)) for name, before, after in
              (line.split() for line in out.splitlines())}
    # A kernel that only kernels call has no version of its own once its callers are cached.
    assert {name.split('.')[-1] for name, (before, _) in counts.items() if not before} <= INSIDE
    assert sum(before for before, _ in counts.values()) > 20
    assert {name: c for name, c in counts.items() if c not in ((1, 1), (0, 0))} == {}


def test_no_collection_of_garbage_looks_at_what_kernels_left_in_memory():
    warm_up(False)
    assert gc.get_freeze_count() > 50_000       # more than 100 000 objects: an eighth of a second
    assert sys.getswitchinterval() <= TURN


def test_what_interrupted_compiling_leaves_is_not_taken_apart():
    class Module:
        pass

    def interrupted():
        module = Module()
        found.append(weakref.ref(module))
        raise KeyboardInterrupt

    found = []
    with suppress(KeyboardInterrupt), jit.Compiling():
        interrupted()
    gc.collect()
    assert found[0]() is not None
