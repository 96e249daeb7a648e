"""make bench-long: a survey larger than its memory, against the same without a bound."""

import argparse
from pathlib import Path
import tempfile
import time

import numpy as np
from persem_ros.core.frame.observe import Observations
from persem_ros.core.memory.paging import Pager
from persem_ros.core.refine.job import begin_next, finish, refine_all
from persem_ros.core.warmup import warm_up
from persem_ros.outputs.map.living import LivingMap
from persem_ros.settings.config import Config, updated
from persem_ros.settings.legend import Legend

SIDE = 128          # columns that a frame sees along either axis
STEP = 16           # columns from one frame to the next
PERIOD = 10         # frames between refinements
CHECKPOINT = 100    # frames between checkpoints


def survey(voxels):
    """Yield the Observations of frames in rows, back and forth, two voxels a column."""
    rng, columns = np.random.default_rng(1), int((voxels / 2) ** 0.5)
    x, y, z = (a.reshape(-1) for a in np.meshgrid(
        np.arange(SIDE), np.arange(SIDE), np.arange(2), indexing='ij'))
    patch, stamp = np.stack([x, y, z], axis=1).astype(np.int32), 0
    for turn, row in enumerate(range(0, columns, SIDE // 2)):
        way = range(0, columns, STEP)
        for at in way[::-1] if turn % 2 else way:
            labels = ((patch[:, 0] + at) // 32 + (patch[:, 1] + row) // 32) % 16
            noisy = rng.random(len(patch)) < 0.1
            labels[noisy] = rng.integers(0, 16, noisy.sum())
            stamp += 100_000_000
            yield Observations(patch + np.array([at, row, 0], np.int32), labels.astype(np.uint16),
                               np.ones(len(patch), np.float32), np.empty(0, np.int32),
                               np.arange(16, dtype=np.uint16), stamp, np.eye(4), '')


def rss():
    """Return the memory that the process has, MB."""
    pages = int(Path('/proc/self/statm').read_text().split()[1])
    return pages * 4096 / 1e6


def main():
    """Map the survey and print what it took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--voxels', type=float, default=1e7)
    parser.add_argument('--bound', type=float, default=1e6, help='memory.max_voxels; 0: none')
    parser.add_argument('--method', default='persem', help='refine.method')
    args = parser.parse_args()
    warm_up()
    bound, times = int(args.bound), {}
    config = updated(Config(), {'refine.method': args.method})

    def timed(name, function, *arguments):
        begin = time.perf_counter()
        result = function(*arguments)
        times.setdefault(name, []).append(1e3 * (time.perf_counter() - begin))
        return result
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, 'map.persem')
        living = LivingMap(path, config, Legend)
        pager = Pager(living.memory(), living)
        memory, begin, most = pager.memory, time.perf_counter(), 0
        for k, seen in enumerate(survey(args.voxels)):
            timed('page in', pager.need_voxels, seen.voxels)
            timed('add', memory.add, seen)
            if k % PERIOD == 0:
                job = timed('begin a refinement', begin_next, memory, config.refine)
                finish(job, *job.compute())
            if k % CHECKPOINT == 0 or 0 < bound < memory.n_voxels and \
                    pager.dirty_voxels > bound // 2:
                pager.save()
            timed('let go', pager.let_go, seen.voxels[0] * config.memory.voxel_size, bound, 0.0,
                  20_000)
            most = max(most, memory.n_voxels)
        pager.save()
        seconds = time.perf_counter() - begin
        print(f'{k + 1} frames of {len(seen.labels)} observations, {living.voxels} voxels, bound '
              f'{bound}: {(k + 1) / seconds:.1f} frames/s with checkpoints; at most {most} voxels '
              f'in memory, RSS {rss():.0f} MB')
        print(f'    file {path.stat().st_size / memory.n_observations:.1f} bytes an observation')
        for name, took in times.items():
            print(f'    {name}: median {np.median(took):.1f} ms, 99 % '
                  f'{np.percentile(took, 99):.1f} ms, worst {max(took):.1f} ms')
        begin = time.perf_counter()
        visited = sum(refine_all(memory, config.refine, bound))
        print(f'    full refinement of the file: {visited} voxels in '
              f'{time.perf_counter() - begin:.1f} s')
        pager.save()
        living.close()
        begin = time.perf_counter()
        LivingMap(path, config, Legend).close()
        print(f'    open and close: {1e3 * (time.perf_counter() - begin):.0f} ms')


if __name__ == '__main__':
    main()
