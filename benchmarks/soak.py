"""
Two hours of flight into an attached map with bounded memory: does the process grow.

A camera looks down on hilly ground from 30 m and flies circles whose centre drifts, so that each
place is seen in a few laps and then never again. Frames (10 Hz of flight, as fast as they can be
mapped) go through what the node's worker does with each: integrate, render, refine beside, write
checkpoints beside, let go of the farthest blocks. The size of the process is noted once a minute
of flight; a line is fitted to it from the moment on when the first places have been left for good,
and another one to the second half.

"""

import argparse
from dataclasses import replace
import gc
import json
from pathlib import Path
import tempfile
import time

import numpy as np
from persem_ros.core.memory.paging import Pager
from persem_ros.core.warmup import warm_up
from persem_ros.frames import Frame, pinhole
from persem_ros.outputs.map.living import LivingMap
from persem_ros.pipeline import Pipeline
from persem_ros.ros.checkpoints import Checkpoints
from persem_ros.ros.counters import Statistics
from persem_ros.ros.refiner import Refiner
from persem_ros.settings.config import Config, updated
from persem_ros.settings.legend import Legend

RATE, SPEED, HEIGHT = 10, 8.0, 30.0     # Hz, m/s, m
RADIUS, DRIFT = 100.0, 20.0             # of a circle; of its centre in one lap, m
SIZE = 160, 120                         # pixels
SHARE = 0.1                             # of pixels whose label is mistaken
CLASSES = 8
MINUTE = 60 * RATE                      # frames
CHECKPOINT = 10 * RATE                  # frames between checkpoints
REFINE = RATE                           # frames between refinements
SETTINGS = {'memory.voxel_size': 1.0, 'memory.max_voxels': 30_000, 'memory.max_history': 128,
            'memory.stride': 1, 'map.attached': True}


def ground(x, y):
    """Return the height of the ground at some places, metres."""
    return 3 * np.sin(x / 23) + 2 * np.cos(y / 17)


def classes(x, y):
    """Return the class of the ground at some places."""
    return ((x / 9).astype(np.int32) + 3 * (y / 11).astype(np.int32)) % CLASSES + 1


class Flight:
    """
    Frames along a circle that drifts.

    Parameters
    ----------
    size : tuple of 2 int
        Width and height of the images.

    """

    def __init__(self, size=SIZE):
        width, height = size
        self.camera = pinhole(width, height, 0.9 * width, 0.9 * width, (width - 1) / 2,
                              (height - 1) / 2)
        self._rays = self.camera.rays.reshape(height, width, 2).astype(np.float32)
        self._rng = np.random.default_rng(5)

    def frame(self, number):
        """Return a Frame."""
        T = pose(number).astype(np.float32)
        depth = np.full(self._rays.shape[:2], np.float32(HEIGHT))
        for _ in range(2):              # of a ray that meets gentle hills from above
            x, y = self._where(T, depth)
            depth = T[2, 3] - ground(x, y)
        labels = classes(*self._where(T, depth))
        wrong = self._rng.random(labels.shape, np.float32) < SHARE
        labels[wrong] = self._rng.integers(1, CLASSES + 1, np.count_nonzero(wrong))
        return Frame(10 ** 18 + number * (10 ** 9 // RATE), labels, depth, self.camera,
                     pose(number))

    def _where(self, T, depth):
        """Return where the pixels' rays are at these depths."""
        u, v = self._rays[..., 0] * depth, self._rays[..., 1] * depth
        return (T[axis, 0] * u + T[axis, 1] * v + T[axis, 3] for axis in (0, 1))


def pose(number):
    """Return T_map_camera of a frame: down, the image's top forward."""
    along = SPEED * number / RATE
    angle = along / RADIUS
    forward = np.array([-np.sin(angle), np.cos(angle), 0.0])
    T = np.eye(4)
    T[:3, 1], T[:3, 2] = -forward, (0.0, 0.0, -1.0)
    T[:3, 0] = np.cross(T[:3, 1], T[:3, 2])
    T[:3, 3] = (RADIUS * np.cos(angle) + DRIFT * angle / (2 * np.pi), RADIUS * np.sin(angle),
                HEIGHT)
    return T


def lost_from_sight():
    """Return the minutes after which the first places are out of reach for good."""
    lap = 2 * np.pi * RADIUS / SPEED
    return (2 * RADIUS + 2 * HEIGHT) / DRIFT * lap / 60


def resident():
    """Return the memory that the process has, bytes."""
    return int(Path('/proc/self/statm').read_text().split()[1]) * 4096


class Soak:
    """
    A node's work without its messages.

    Parameters
    ----------
    path : Path
        The map's file, which is made.
    settings : dict
        In place of some of SETTINGS.

    """

    def __init__(self, path, settings=()):
        config = updated(Config(), {**SETTINGS, 'map.path': str(path), **dict(settings)})
        # REFINE counts frames; a clock would leave out refinements where frames come quickly.
        self.config = replace(config, refine=replace(config.refine, period=0.0))
        self.path, self.living = path, LivingMap(path, self.config, Legend)
        self.pager = Pager(self.living.memory(), self.living)
        self.pipeline = Pipeline(self.config, self.pager.memory)
        self.statistics = Statistics()
        self.refiner = Refiner(self.statistics, lambda: None)
        self.checkpoints = Checkpoints(lambda: None)
        self.samples, self.rendered, self.worst, self.waited = [], 0, 0.0, 0.0

    def fly(self, frames, flight, every=MINUTE, told=print):
        """Map so many frames; note the size of the process now and then."""
        for number in range(frames):
            frame = flight.frame(number)
            begin = time.monotonic()
            self._step(frame, number)
            self.worst = max(self.worst, time.monotonic() - begin)
            self._keep_up(number)
            if (number + 1) % every == 0:
                self.samples.append(self._sample(number + 1))
                told(self.samples[-1])
        self._end()

    def _step(self, frame, number):
        """Do what persem_ros.ros.worker does with a frame."""
        memory, bounds = self.pager.memory, self.config.memory
        observations = self.pipeline.add(frame)
        image = self.pipeline.render(frame, observations)
        self.rendered += image.shape == frame.labels.shape
        self.refiner.finish(memory)
        if not self.refiner.busy:
            self.pager.let_go(frame.T_map_camera[:3, 3], bounds.max_voxels, 0.0, 20_000)
        if (number + 1) % CHECKPOINT == 0:
            self.checkpoints.ask()
        self.checkpoints.step(self.pager, 3600.0, bounds.max_voxels)
        if (number + 1) % REFINE == 0:
            self.refiner.begin(memory, self.config.refine)

    def _keep_up(self, number):
        """Wait where frames came faster in here than refinements and the disk can follow."""
        begin, memory = time.monotonic(), self.pager.memory
        while memory.n_voxels > 1.2 * self.config.memory.max_voxels > 0 and \
                not self.checkpoints.failing and time.monotonic() - begin < 30:
            self.refiner.finish(memory)
            self.checkpoints.step(self.pager, 0.0, self.config.memory.max_voxels)
            if not self.refiner.busy:
                self.pager.let_go(pose(number)[:3, 3], self.config.memory.max_voxels)
            time.sleep(0.002)
        self.waited += time.monotonic() - begin

    def _sample(self, frames):
        """Return what there is after so many frames."""
        memory = self.pager.memory
        return {'minute': frames / MINUTE, 'rss': resident(), 'held': memory.n_voxels,
                'map': sum(memory.nbytes().values()), 'frame table': memory.frames.nbytes(),
                'voxels': self.living.voxels,
                'file': self.path.stat().st_size, 'observations': memory.n_observations}

    def _end(self):
        """Bring the file up to date and close it."""
        self.refiner.close()
        self.refiner.finish(self.pager.memory)
        self.checkpoints.close()
        self.pager.save()
        self.living.close()


def fitted(samples, since, name='rss'):
    """Return the slope of a column and its standard error, kB per minute of flight."""
    at = np.array([[s['minute'], s[name] / 1e3] for s in samples if s['minute'] >= since])
    x, y = (at - at.mean(axis=0)).T
    slope = (x @ y) / (x @ x)
    error = np.sqrt(((y - slope * x) ** 2).sum() / max(1, len(at) - 2) / (x @ x))
    return slope, error


def draw(samples, since, out):
    """Draw the size of the process, of the map in it and of the file over the flight."""
    import matplotlib
    matplotlib.use('Agg')
    from matplotlib import pyplot as plt
    plt.rcParams['svg.hashsalt'] = 'persem'
    minutes = [s['minute'] for s in samples]
    out.parent.mkdir(parents=True, exist_ok=True)
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout='constrained')
    slope, error = fitted(samples, since)
    left.plot(minutes, [s['rss'] / 1e6 for s in samples], label='the process')
    left.plot(minutes, [s['map'] / 1e6 for s in samples], label='of it the map')
    left.axvline(since, color='0.7', lw=0.8)
    left.set(xlabel='minutes of flight', ylabel='memory, MB', ylim=(0, None),
             title=f'from minute {since:.0f} on {slope:+.0f} ± {error:.0f} kB/min')
    left.legend(frameon=False, loc='center right')
    right.plot(minutes, [s['voxels'] / 1e3 for s in samples], label='in the file')
    right.plot(minutes, [s['held'] / 1e3 for s in samples], label='in memory')
    right.set(xlabel='minutes of flight', ylabel='thousand voxels', ylim=(0, None),
              title=f'{samples[-1]["observations"] / 1e6:.0f} M observations, '
                    f'file {samples[-1]["file"] / 1e9:.2f} GB')
    right.legend(frameon=False, loc='upper left')
    figure.savefig(out, metadata={'Date': None} if str(out).endswith('.svg') else None)
    plt.close(figure)


def main():
    """Fly, fit, draw."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--minutes', type=float, default=120.0, help='of flight')
    parser.add_argument('--figure', type=Path, help='a picture, .svg or .png (matplotlib)')
    parser.add_argument('--samples', type=Path, help='what was noted, as JSON')
    parser.add_argument('--folder', type=Path, help='of the map while it is made')
    args = parser.parse_args()
    warm_up()
    gc.collect()
    frames, half = round(args.minutes * MINUTE), args.minutes / 2
    since = min(lost_from_sight(), half)
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(dir=args.folder) as folder:
        soak = Soak(Path(folder, 'map.persem'))
        soak.fly(frames, Flight(), told=lambda s: print(json.dumps(s), flush=True))
        table = len(soak.pager.memory.frames)
        size = soak.path.stat().st_size
    seconds = time.monotonic() - begin
    if args.samples:
        args.samples.write_text(json.dumps(soak.samples))
    print(f'{frames} frames in {seconds:.0f} s ({frames / seconds:.1f}/s), {frames - table} lost, '
          f'{soak.rendered} rendered, {soak.statistics.refinements} refinements; the longest step '
          f'{1e3 * soak.worst:.0f} ms, waited {soak.waited:.0f} s for the disk')
    for name in ('rss', 'map', 'frame table'):
        (slope, error), (late, its) = (fitted(soak.samples, at, name) for at in (since, half))
        print(f'{name} from minute {since:.0f} on: {slope:+.1f} ± {error:.1f} kB a minute of '
              f'flight, from minute {half:.0f} on {late:+.1f} ± {its:.1f}, '
              f'{soak.samples[-1][name] / 1e6:.1f} MB at the end')
    print(f'{soak.samples[-1]["voxels"]} voxels, {soak.samples[-1]["observations"]} observations, '
          f'{size / soak.samples[-1]["observations"]:.1f} bytes of file each')
    if args.figure:
        draw(soak.samples, half, args.figure)


if __name__ == '__main__':
    main()
