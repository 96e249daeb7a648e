"""
make bench-long: a survey larger than its memory, against the same without a bound.

Each run is a process of its own, which writes what it measured as JSON (--alone) for the table.

"""

import argparse
import json
from pathlib import Path
import resource
import subprocess
import sys
import tempfile
import time

import numpy as np
from persem_ros.core.frame.observe import Observations
from persem_ros.core.memory.paging import Pager
from persem_ros.core.refine.job import finish
from persem_ros.core.refine.turns import begin_next
from persem_ros.core.refine.whole import blocks_at_once, refine_all
from persem_ros.core.warmup import warm_up
from persem_ros.outputs.map.living import LivingMap
from persem_ros.settings.config import Config, updated
from persem_ros.settings.legend import Legend

SIDE = 128          # columns that a frame sees along either axis
STEP = 16           # columns from one frame to the next
PERIOD = 10         # frames between refinements
CHECKPOINT = 100    # frames between checkpoints
AT_ONCE = 20_000    # voxels that leave memory between two frames
ROWS = (('frames', '{:.0f}'), ('voxels in the file', '{:.0f}'), ('observations', '{:.0f}'),
        ('frames a second, refinements and checkpoints included', '{:.1f}'),
        ('voxels in memory, at most', '{:.0f}'), ('resident while mapping, at most, MB', '{:.0f}'),
        ('of it before the first frame, MB', '{:.0f}'), ('file, MB', '{:.0f}'),
        ('file, bytes an observation', '{:.1f}'))


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


def resident():
    """Return the memory that the process has, MB."""
    return int(Path('/proc/self/statm').read_text().split()[1]) * resource.getpagesize() / 1e6


class Survey:
    """
    One survey into one file.

    Parameters
    ----------
    path : Path
        Of the file.
    bound : int
        memory.max_voxels; 0: none.
    method : str
        refine.method.

    """

    def __init__(self, path, bound, method):
        self.path, self.bound = path, bound
        self.config = updated(Config(), {'refine.method': method})
        self.living = LivingMap(path, self.config, Legend)
        self.pager = Pager(self.living.memory(), self.living)
        self.times, self.most, self.rss = {}, 0, 0.0

    def timed(self, name, function, *arguments):
        """Call a function, which no frame can be mapped beside."""
        begin = time.perf_counter()
        result = function(*arguments)
        self.times.setdefault(name, []).append(1e3 * (time.perf_counter() - begin))
        return result

    def map(self, voxels):      # noqa: A003
        """Fly; return the number of frames."""
        memory, number = self.pager.memory, 0
        for number, seen in enumerate(survey(voxels), 1):
            self.timed('page in', self.pager.need_voxels, seen.voxels)
            self.timed('add', memory.add, seen)
            if number % PERIOD == 0:
                job = self.timed('begin a refinement', begin_next, memory, self.config.refine)
                finish(job, *job.compute())
            if number % CHECKPOINT == 0 or 0 < self.bound < memory.n_voxels and \
                    self.pager.dirty_voxels > self.bound // 2:
                self._checkpoint()
            self.timed('let go', self.pager.let_go,
                       seen.voxels[0] * self.config.memory.voxel_size, self.bound, 0.0, AT_ONCE)
            self.most = max(self.most, memory.n_voxels)
            self.rss = max(self.rss, resident())
        self._checkpoint()
        return number

    def _checkpoint(self):
        """Copy what changed, slice by slice, and write it, which a node does beside."""
        checkpoint = self.pager.checkpoint()
        while not self.timed('copy for a checkpoint', checkpoint.capture.step):
            pass
        checkpoint.write()
        checkpoint.end()

    def refined(self):
        """Refine what is in the file and in memory; return the seconds that it took."""
        begin = time.perf_counter()
        memory = self.pager.memory
        for _ in refine_all(memory, self.config.refine, self.bound,
                            blocks_at_once(memory, self.bound)):
            self.rss = max(self.rss, resident())
        self.pager.save()
        return time.perf_counter() - begin


def measured(voxels, bound, method='persem'):
    """Return {what: number} of one survey."""
    warm_up()
    with tempfile.TemporaryDirectory() as folder:
        path, before = Path(folder, 'map.persem'), resident()
        run, begin = Survey(path, bound, method), time.perf_counter()
        frames = run.map(voxels)
        seconds, size = time.perf_counter() - begin, path.stat().st_size
        n = run.pager.memory.n_observations
        result = dict(zip((name for name, _ in ROWS), (
            frames, run.living.voxels, n, frames / seconds, run.most, run.rss, before, size / 1e6,
            size / n)))
        refining = run.refined()
        run.living.close()
        begin = time.perf_counter()
        LivingMap(path, Config(), Legend).close()
        opening = 1e3 * (time.perf_counter() - begin)
    for name, took in run.times.items():
        result[f'{name}, 99 % and worst, ms'] = [np.percentile(took, 99), max(took)]
    return {**result, 'a full refinement of the file, s': refining,
            'resident with that, at most, MB': run.rss, 'open and close the file, ms': opening}


def table(columns):
    """Return what some runs measured as the lines of a table, {title: {what: number}}."""
    lines = ['| | ' + ' | '.join(columns) + ' |', '|---|' + '---:|' * len(columns)]
    for name in next(iter(columns.values())):
        form = dict(ROWS).get(name, '{:.1f}')
        cells = (', '.join(form.format(x) for x in (v if isinstance(v, list) else [v]))
                 for v in (column[name] for column in columns.values()))
        lines.append(f'| {name} | ' + ' | '.join(cells) + ' |')
    return lines


def main():
    """Run both, or one alone."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--voxels', type=float, default=3e6, help='1e7 takes three times as long')
    parser.add_argument('--bound', type=float,
                        help='memory.max_voxels, 0: none; a tenth of the voxels')
    parser.add_argument('--method', default='persem', help='refine.method')
    parser.add_argument('--alone', action='store_true', help='only the run with this bound')
    args = parser.parse_args()
    bound = args.voxels / 10 if args.bound is None else args.bound
    if args.alone:
        print(json.dumps(measured(args.voxels, int(bound), args.method)))
        return
    columns = {}
    for title, value in ((f'memory.max_voxels {bound:.0f}', bound), ('no bound', 0)):
        done = subprocess.run([sys.executable, __file__, '--alone', '--voxels', str(args.voxels),
                               '--bound', str(value), '--method', args.method],
                              check=True, stdout=subprocess.PIPE)
        columns[title] = json.loads(done.stdout)
    print('\n'.join(table(columns)))


if __name__ == '__main__':
    main()
