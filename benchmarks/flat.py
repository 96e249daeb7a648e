"""What the mapping thread does beside frames, in maps of any size (spec section 9, *Flat*)."""

import argparse
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
import time

import numpy as np
from persem_ros.core import jit
from persem_ros.core.memory.capture import Capture
from persem_ros.core.memory.changes import Changes
from persem_ros.core.refine.job import finish
from persem_ros.core.refine.rules import swept
from persem_ros.core.refine.snapshot import settle
from persem_ros.core.refine.turns import begin_next
from persem_ros.outputs.grid.layers import Layers
from persem_ros.outputs.grid.rule import rule_of
from persem_ros.outputs.map.mirror import Mirror
from persem_ros.pipeline import Pipeline
from persem_ros.ros.priority import stand_back
from persem_ros.settings.config import Map
from persem_ros.settings.legend import Legend
import scenes

SIZES = 10 ** 5, 10 ** 6, 10 ** 7
SLICE = 100_000     # voxels that the grid takes in at once
NEARBY = 2000       # voxels from the map's origin to the ground of the grid's benchmark
COSTS = Legend.from_yaml('classes:\n' + ''.join(
    f'- {{id: {c}, name: c{c}, cost: {c}}}\n' for c in range(scenes.CLASSES)))
NEW = np.array([scenes.CLASSES], np.uint16)     # a class that no frame has
PUBLISH = 5         # frames between two publications


class Away:
    """
    How long the mapping thread was away from frames, by what for.

    Calls during which a hypervisor gave the processor to somebody else are counted apart: they
    took up to 80 ms, and nothing of the mapper's was in it.

    """

    def __init__(self, clock):
        """Start with nothing; clock() gives seconds."""
        self.seconds, self.disturbed, self._clock = {}, 0, clock

    def time(self, name, function, *arguments):
        """Call a function and note how long it took."""
        before, begin = stolen(), self._clock()
        result = function(*arguments)
        took, counted = self._clock() - begin, self.seconds.setdefault(name, [])
        if stolen() == before:
            counted.append(took)
        else:
            self.disturbed += 1
        return result

    def worst(self):
        """Return the longest of all but frames, ms."""
        return 1e3 * max(max(s, default=0.0)
                         for name, s in self.seconds.items() if name != 'frame')

    def p99(self):
        """Return the 99th percentile of all but frames, ms."""
        return 1e3 * np.percentile(np.concatenate(
            [s for name, s in self.seconds.items() if name != 'frame']), 99)


def stolen():
    """Return for how long a hypervisor has had this machine's processors elsewhere, in ticks."""
    try:
        return int(Path('/proc/stat').read_text().split(maxsplit=9)[8])
    except (OSError, IndexError):
        return 0


def flight(config, size, frames, clock, rounds=3):
    """Map frames in a map of *size* voxels as a node does, with everybody listening."""
    pipeline, away = Pipeline(config), Away(clock)
    memory, changes = pipeline.memory, Changes()
    scenes.fill(memory, size)
    settle(memory)              # as if all had been refined
    if config.refine.method == 'geometry':      # parameters and relief are there before a flight
        for name in 'the first', '~/refine', 'a new class':
            everywhere(pipeline, name, frames, clock)
    mirror, job, capture = Mirror(memory.voxel_size, Legend()), None, None
    with ThreadPoolExecutor(3, 'beside', stand_back) as beside:     # as all of a node's do
        published = saved = None
        for k in range(rounds * len(frames)):
            frame = frames[k % len(frames)]
            away.time('frame', pipeline.add, frame)
            away.time('render', pipeline.render, frame)
            if job is None:
                job = away.time('begin a refinement', begin_next, memory, config.refine)
                result = beside.submit(job.compute)
            elif result.done():
                away.time('finish a refinement', finish, job, *result.result())
                job = None
            if k % PUBLISH == 0 and (published is None or published.done()):
                centre = frame.T_map_camera[:3, 3]
                changed = away.time('copy what changed', changes.take, memory, centre)
                published = beside.submit(_publish, mirror, changed, centre)
            if capture is None and (saved is None or saved.done()):
                capture = away.time('begin a save', Capture, memory)
            elif capture is not None and away.time('copy for a save', capture.step):
                saved, capture = beside.submit(capture.dump), None
        if job is not None:
            finish(job, *result.result())
    return away


def everywhere(pipeline, name, frames, clock):
    """Fit parameters to the whole map and label all of it by them, a frame after each step."""
    memory, settings, away = pipeline.memory, pipeline.config.refine, Away(clock)
    if name == 'a new class':
        memory.add(replace(pipeline.observe(frames[0]), labels=NEW, voxels=np.zeros(
            (1, 3), np.int32), confidences=np.ones(1, np.float32), offsets=None))
    begun = time.perf_counter()
    while 'begin' not in away.seconds or not swept(memory, settings):
        fresh = name == '~/refine' and 'begin' not in away.seconds
        job = away.time('begin', begin_next, memory, settings, fresh)
        result = job.compute()
        away.time('finish', finish, job, *result)
        away.time('frame', pipeline.add, frames[len(away.seconds['begin']) % len(frames)])
    print(f'{memory.n_voxels:>9} voxels, {name}: {time.perf_counter() - begun:.1f} s')
    for part in 'begin', 'finish':
        print(told(part, away.seconds[part]))


def grid(config, size, frames, clock):
    """Follow a flight with ~/grid beside *size* voxels of ground; return what took how long."""
    config = replace(config, grid=replace(config.grid, min_observations=1))
    pipeline, away, changes = Pipeline(config), Away(clock), Changes()
    memory = pipeline.memory
    scenes.fill(memory, size, NEARBY)
    layers = Layers(rule_of(config, COSTS, memory.voxel_size), memory.voxel_size,
                    config.grid.resolution, config.grid.tie)
    while len((changed := changes.take(memory, most=SLICE)).index):
        layers.update(changed)
    for frame in frames:
        pipeline.add(frame)
        changed = away.time('copy what changed', changes.take, memory,
                            frame.T_map_camera[:3, 3], SLICE)
        away.time('update the grid', layers.update, changed)
    return away


def _publish(mirror, changed, centre):
    """Do what happens beside the mapping."""
    mirror.update(changed)
    mirror.difference(centre, 100_000)
    if mirror.complete:
        mirror.shown(centre, Map(max_voxels=2_000_000))


def main():
    """Measure all sizes and print each part."""
    from persem_ros.core.warmup import warm_up
    from persem_ros.settings.config import Config, updated
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--cpu', action='store_true',
                        help="the thread's processor time, for a machine that others use, too")
    parser.add_argument('--method', default='persem', help='refine.method')
    parser.add_argument('--most', type=float, default=SIZES[-1], help='voxels, at most')
    args = parser.parse_args()
    sizes = [size for size in SIZES if size <= args.most]
    config = updated(Config(), {'refine.method': args.method})
    clock = time.perf_counter
    if args.cpu:
        clock = time.thread_time
        jit.set_threads(1)
    warm_up()
    frames = list(scenes.frames(scenes.flight(frames=20, rate=3.0)))
    for size in sizes:
        away = flight(config, size, frames, clock)
        print(f'{size:>9} voxels: away {away.worst():.1f} ms at worst, p99 {away.p99():.1f} ms, '
              f'{away.disturbed} calls not counted')
        for name, seconds in away.seconds.items():
            print(told(name, seconds))
    for size in sizes:
        print(f'{size:>9} voxels, ~/grid:')
        for name, seconds in grid(Config(), size, frames, clock).seconds.items():
            print(told(name, seconds))


def told(name, seconds):
    """Return a line about one part."""
    seconds = seconds or [np.nan]
    return (f'    {name:<20} median {1e3 * np.median(seconds):6.2f} ms, worst '
            f'{1e3 * max(seconds):6.2f} ms ({len(seconds)})')


if __name__ == '__main__':
    main()
