"""Running every kernel once, so that the first real frame need not wait for a compiler."""

from __future__ import annotations

from contextlib import closing, suppress
from dataclasses import replace
import functools
import gc
import os
import subprocess
import sys
import time

import numpy as np
from persem_ros.core.frame.clear import clear
from persem_ros.core.frame.images import measured, points
from persem_ros.core.frame.median import median_depth
from persem_ros.core.frame.observe import EVERY, Observations, observe, Part
from persem_ros.core.frame.place import measured_points, place, placing
from persem_ros.core.frame.render import (
    filled, hide_gone, render, render_map, voxel_image, voxel_image_of)
from persem_ros.core.frame.smoothing import EmaImages
from persem_ros.core.frame.stride import thinned
from persem_ros.core.frame.tally import renumber
from persem_ros.core.geometry.labelling import with_ring
from persem_ros.core.jit import is_complete, keep_memory, mark_complete, threads
from persem_ros.core.memory.blocks import block_numbers
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.changes import Changes
from persem_ros.core.memory.evict import keep_near
from persem_ros.core.memory.frame_pages import pages_of
from persem_ros.core.memory.loading import load
from persem_ros.core.memory.move import moved
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.refine.job import finish
from persem_ros.core.refine.labelled import label
from persem_ros.core.refine.regions import region_image, regions
from persem_ros.core.refine.rules import swept
from persem_ros.core.refine.snapshot import take
from persem_ros.core.refine.turns import begin_next
from persem_ros.core.refine.whole import refine
from persem_ros.frames import Frame, pinhole
from persem_ros.settings.config import Memory, METHODS, Refine

TURN = 5e-4         # s after which a thread that is at Python's work lets another one go on
BESIDE = 'from persem_ros.core.warmup import warm_up_geometry; warm_up_geometry()'


@functools.cache
def warm_up(geometry: bool = True) -> None:
    """
    Compile all kernels of the core, or load them from the cache; once a process.

    The first time takes most of a minute, later ones one to three seconds (core.jit.Compiling
    says so to the user). Compiling is Python's work, which threads cannot share; the kernels of
    the method geometry, more than half of all, are therefore compiled by a process beside (71 s
    became 50 on two threads of one core; 30 without geometry). Besides it tells the C library to
    keep freed memory (keep_memory), and sees to it that Python holds up no frame (_undisturbed).

    Parameters
    ----------
    geometry : bool
        Whether also those of the method geometry.

    """
    keep_memory()
    memory = _mapped()
    with _Beside(geometry and not is_complete('geometry')) as beside:
        _refined(memory)
        if not is_complete():
            mark_complete()
        if geometry:
            _many_classes()
            beside.wait()
            warm_up_geometry()
    _undisturbed()


def _undisturbed() -> None:
    """
    Keep Python's housekeeping from holding up frames.

    A collection of garbage among the 120 000 objects that loading leaves took 130 to 240 ms, for
    which all threads wait; what is frozen is not looked at. A thread that wants the interpreter
    from one beside it waits for TURN in place of 5 ms, which the mapping thread did several times
    a frame.

    """
    gc.freeze()
    sys.setswitchinterval(min(TURN, sys.getswitchinterval()))


def warm_up_geometry() -> None:
    """Compile the kernels of the method geometry."""
    memory = _mapped()
    geometry = replace(Refine(), method='geometry')
    label(memory, 'geometry', geometry)
    refine(memory, geometry)
    memory.add(_seen(memory))
    refine(memory, geometry, full=False)
    memory.add(_seen(memory))
    for _ in range(2):
        job = begin_next(memory, geometry)
        finish(job, *job.compute())
    _in_steps(memory, geometry)
    memory = load(dump(memory))
    refine(memory, geometry, full=False)
    with_ring(memory.m.blocks, take(memory), np.arange(1))
    mark_complete('geometry')


def _many_classes() -> None:
    """Compile what stands in for some of them where classes are more than the dense form takes."""
    memory, geometry = VoxelMemory(0.01), replace(Refine(), method='geometry')
    memory.add(_seen(memory, classes=80))
    refine(memory, geometry)
    _in_steps(memory, geometry)


def _in_steps(memory: VoxelMemory, settings: Refine) -> None:
    """Refine all of a map afresh, as ~/refine does with a large one."""
    settings = replace(settings, sweep=memory.n_voxels // 2)
    fresh = True
    while fresh or not swept(memory, settings):
        job = begin_next(memory, settings, fresh)
        finish(job, *job.compute())
        fresh = False


def _mapped() -> VoxelMemory:
    """Return a memory of twenty frames; its voxels are small, so that tables grow, too."""
    memory = VoxelMemory(0.01, max_history=8)
    for k in range(20):
        memory.add(_seen(memory, k))
    return memory


def _frame(k: int = 0, classes: int = 3) -> Frame:
    """Return the k-th frame."""
    camera = pinhole(160, 120, 100.0, 100.0, 80.0, 60.0)
    labels = (np.arange(120 * 160, dtype=np.int32) % classes).reshape(120, 160)
    return Frame(k, np.roll(labels, k), np.full((120, 160), 3.0), camera)


def _seen(memory: VoxelMemory, k: int = 20, classes: int = 3) -> Observations:
    """Return the observations of the k-th frame."""
    frame = _frame(k, classes)
    seen_points, ids = points(frame, Memory())
    return observe(seen_points, ids, frame.T_map_camera, memory.voxel_size, stamp=k)


def _in_parts(frame: Frame, size: float) -> None:
    """Observe a frame in two parts, whatever the number of threads."""
    seen_points, ids = points(frame, Memory())
    where = np.empty(len(ids), np.int32)
    counted = (*measured_points(seen_points), *placing(frame.T_map_camera, size, (0.0, 0.0, 0.0)),
               size, ids, EVERY, np.empty(0, np.uint32), where)
    renumber(9, len(ids), Part(0, 9, *counted).add(Part(9, len(ids), *counted)), where)


def _refined(memory: VoxelMemory) -> None:
    """Do with *memory* all that is done with one, but for the method geometry."""
    frame = _frame()
    _in_parts(frame, memory.voxel_size)
    thinned(frame, Memory(stride=0))
    median_depth(frame.depth, 0.0, 1.0)     # what a stride mostly does without
    for method in METHODS:
        if method != 'geometry':
            label(memory, method, Refine())
    refine(memory, Refine())
    seen = _seen(memory)
    memory.add(seen)
    refine(memory, Refine(), full=False)
    job = begin_next(memory, Refine(), fresh=True)
    finish(job, *job.compute())
    pages_of(dump(memory))
    memory = load(moved(dump(memory), memory.frames.best + 1e-3, memory.frames.t >= 0))
    first = memory.voxels()['voxel'][0]
    memory.evidence(first)
    codes = regions(memory)[0]
    labelled = label(memory, 'majority', Refine())[0]
    shape = frame.depth.shape
    render(voxel_image(memory, seen, shape), labelled)
    hide_gone(0, 0, memory.m.voxels, voxel_image(memory, seen, shape).reshape(-1))
    region_image(codes, voxel_image(memory, seen, shape))
    render_map(memory, voxel_image(memory, seen, shape), source=True)
    with closing(Changes()) as viewer:      # else the two hold each other, frozen: 28 MB
        viewer.take(memory)
    block_numbers(memory, np.zeros((1, 3), np.int32))
    pixels = place(measured(frame, Memory()), frame.T_map_camera, memory.voxel_size, memory.origin)
    filled(render(voxel_image_of(memory, *pixels, shape), labelled), frame.labels, Memory())
    EmaImages(0.5).update(frame.labels)
    for far in (30.0, 0.2):         # all blocks in memory, and those of a box
        clear(memory, frame, Memory(clear_after=1, clear_range=far))
    keep_near(memory, (0.0, 0.0, 0.0), max_voxels=memory.n_voxels // 2)


class _Beside:
    """A process that compiles the kernels of geometry meanwhile, where a core is free for it."""

    def __init__(self, wanted: bool) -> None:
        """Start it if *wanted*."""
        self._process = None
        if wanted and threads() > 1 and sys.executable:
            with suppress(OSError):
                self._process = subprocess.Popen(
                    [sys.executable, '-c', BESIDE], stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                    start_new_session=True,     # Ctrl-C is for us, and we end it
                    env={**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, sys.path))})

    def __enter__(self) -> _Beside:
        """Return it."""
        return self

    def wait(self) -> None:
        """Wait for its end; what it did not do is compiled here."""
        while self._process and self._process.poll() is None:
            time.sleep(0.02)        # an interrupt comes between two of these

    def __exit__(self, *_: object) -> None:
        """End it where it is no longer wanted."""
        if self._process and self._process.poll() is None:
            self._process.kill()
            self._process.wait()


if __name__ == '__main__':
    warm_up()
