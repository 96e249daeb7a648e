"""Running every kernel once, so that the first real frame need not wait for a compiler."""

from __future__ import annotations

from dataclasses import replace
import functools

import numpy as np
from persem_ros.core.frame.images import placed, points
from persem_ros.core.frame.observe import observe
from persem_ros.core.frame.render import render, render_map, voxel_image, voxel_image_of
from persem_ros.core.frame.smoothing import EmaImages
from persem_ros.core.frame.stride import thinned
from persem_ros.core.jit import keep_memory, mark_complete
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.changes import Changes
from persem_ros.core.memory.dump import load
from persem_ros.core.memory.evict import keep_near
from persem_ros.core.memory.move import moved
from persem_ros.core.memory.paging import block_numbers
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.refine.job import begin_next, finish, label, refine
from persem_ros.core.refine.regions import regions
from persem_ros.frames import Frame, pinhole
from persem_ros.settings.config import Memory, METHODS, Refine


@functools.cache
def warm_up() -> None:
    """
    Compile all kernels of the core, or load them from the cache; once a process.

    The first time takes about a minute, later ones well below a second (core.jit.Announcement
    says so to the user). Besides it tells the C library to keep freed memory (keep_memory).

    """
    keep_memory()
    memory = VoxelMemory(0.01, max_history=8)       # small voxels: tables grow, too
    camera = pinhole(160, 120, 100.0, 100.0, 80.0, 60.0)
    labels = (np.arange(120 * 160, dtype=np.int32) % 3).reshape(120, 160)
    depth = np.full((120, 160), 3.0)
    for k in range(20):
        frame = Frame(k, np.roll(labels, k), depth, camera)
        seen_points, ids = points(frame, Memory())
        seen = observe(seen_points, ids, frame.T_map_camera, memory.voxel_size, stamp=k)
        memory.add(seen)
    thinned(frame, Memory(stride=0))
    for method in METHODS:
        label(memory, method, Refine())
    refine(memory, Refine())
    memory.add(seen)
    refine(memory, Refine(), full=False)
    geometry = replace(Refine(), method='geometry')
    refine(memory, geometry)
    memory.add(seen)
    for _ in range(2):
        job = begin_next(memory, geometry)
        finish(job, *job.compute())
    memory = load(dump(memory))
    refine(memory, geometry, full=False)
    many = VoxelMemory(memory.voxel_size)           # more classes than the dense form takes
    many.add(observe(seen_points, (np.arange(len(seen_points)) % 80).astype(ids.dtype),
                     frame.T_map_camera, memory.voxel_size))
    refine(many, geometry)
    job = begin_next(memory, Refine(), fresh=True)
    finish(job, *job.compute())
    memory = load(moved(dump(memory), memory.frames.best + 1e-3, memory.frames.t >= 0))
    first = memory.voxels()['voxel'][0]
    memory.evidence(first)
    regions(memory)
    labelled = label(memory, 'majority', Refine())[0]
    render(voxel_image(memory, seen, depth.shape), labelled)
    render_map(memory, voxel_image(memory, seen, depth.shape), source=True)
    Changes().take(memory)
    block_numbers(memory, np.zeros((1, 3), np.int32))
    pixels = placed(frame, Memory(), memory.voxel_size, memory.origin)
    render(voxel_image_of(memory, *pixels, depth.shape), labelled)
    EmaImages(0.5).update(labels)
    keep_near(memory, (0.0, 0.0, 0.0), max_voxels=memory.n_voxels // 2)
    mark_complete()
