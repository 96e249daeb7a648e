"""
A night's map in one command: three sessions in one file, one killed, one closing a loop.

Simulates three flights over one town and the fields around, maps them into one attached file with
memory for a tenth of the first, which is some frames' views, kills the second (SIGKILL) in its
midst and goes on, and moves the third, whose poses drift, by the path that closing its loop gave.
Prints `persem map info` after each step and draws the map from above before and after the move.

All of it are replays; with --node the second and the third flight are flown live, through DDS,
into the node, which goes on with the file while the flight that it was killed in goes on.

"""

import argparse
from contextlib import redirect_stdout
from dataclasses import replace
import io
import json
from pathlib import Path
import signal
import subprocess
import sys
import time

import above
import cv2
import flown
import numpy as np
import persem_ros
from persem_ros import cli
from persem_ros.errors import PersemError
from persem_ros.outputs.map import store
from persem_ros.outputs.recording.writer import RecordingWriter
from persem_ros.simulate.flight import Flight, START
from persem_ros.simulate.path import make_path
from persem_ros.simulate.plan import Plan
from persem_ros.simulate.sensor import PoseErrors, recorded

LEGS = {'leg': 300.0, 'spacing': 45.0, 'lines': 6}     # of the flights: nearly the whole world, m
SURVEY = Plan(width=160, height=120, speed=15.0, field_of_view=50.0, tilt=75.0)
FLIGHTS = {'evening': SURVEY, 'midnight': replace(SURVEY, altitude=70.0),
           'morning': replace(SURVEY, pose_errors=PoseErrors(odometry=0.2))}
VOXEL = 0.4         # m
MAPPED = 20.0       # s after which the second session is killed
FLOWN = 60.0        # the same, where it is flown live
SHARE = 10          # the bound of memory is so much less than the map of the first session


def persem(*words):
    """Run a command in this process; return what it printed."""
    said = io.StringIO()
    with redirect_stdout(said):
        if cli.main([str(word) for word in words]):
            raise PersemError(f'persem {words[0]} failed')
    return said.getvalue()


def apart(*words):
    """Run a command in a process of its own, whose peak of memory is its own, too."""
    subprocess.run([sys.executable, '-m', 'persem_ros', *map(str, words)], check=True,
                   stdout=subprocess.DEVNULL)


def simulated(folder, frames):
    """Return the recordings of three flights, made where they are missing."""
    for name, plan in FLIGHTS.items():
        if not (folder / name).exists():
            plan = replace(plan, frames=frames)
            flight = Flight(plan)
            flight.path = make_path(
                np.random.default_rng(0), (flight.pose_stamps[-1] - START) / 1e9 + 1.0,
                plan.altitude, plan.speed, middle=0.0, **LEGS)
            flight.poses = recorded([flight.body(stamp) for stamp in flight.pose_stamps],
                                    plan.pose_errors, np.random.default_rng(1))
            with RecordingWriter(folder / name) as writer:
                flight.record(writer)
    return [folder / name for name in FLIGHTS]


def set_to(path, bound, settings):
    """Return the settings of a session in the map file, NAME=VALUE; '': without one."""
    attached = (f'map.path={path}', 'map.attached=true') if path else ()
    return (*attached, f'memory.max_voxels={bound}', 'memory.dynamic_labels=[10]', *settings)


def replayed(recording, out, path, bound, settings=()):
    """Return the words of the replay that adds a recording to the map file."""
    return ['replay', recording, '--out', out, '--methods', 'majority',
            *(word for value in set_to(path, bound, settings) for word in ('--set', value))]


def killed(words, out, after):
    """Kill a replay some seconds after it has begun to map; return its exit status."""
    process = subprocess.Popen([sys.executable, '-m', 'persem_ros', *map(str, words)],
                               stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and not list(out.glob('.persem-run.*')):
        time.sleep(0.01)
    time.sleep(after)
    process.send_signal(signal.SIGKILL)
    return process.wait()


def counted(recording, out, settings, replay):
    """Return how many voxels a recording has, mapped by itself, and its labels by voxel."""
    replay(*replayed(recording, out, '', 0, settings))
    return labels_of(out / 'map.persem')


def labels_of(path):
    """Return the bytes of voxels and labels of a map file, and how many there are."""
    columns = persem_ros.open_map(path).columns()
    return columns['voxel'].tobytes() + columns['label'].tobytes(), len(columns['label'])


class Replays:
    """
    Sessions by `persem replay`: whole or not at all.

    Parameters
    ----------
    replay : callable
        replay(*words) runs a command.
    after : float
        Seconds from its beginning to the end of the replay that is killed.

    """

    def __init__(self, replay, after):
        self._replay, self._after = replay, after

    def session(self, recording, folder, path, bound, settings):
        """Add a recording; print what it took."""
        self._replay(*replayed(recording, folder, path, bound, settings), '--force')
        timing = json.loads((folder / 'timing.json').read_text('utf-8'))
        print(f'{folder.name}: {timing["frames"]} frames, {timing["total_s"]:.0f} s, peak '
              f'{timing["memory"]["peak_rss_bytes"] / 1e6:.0f} MB')

    def killed(self, recording, folder, path, bound, settings, step):
        """Add a recording in two attempts, the first of which is killed, then call step()."""
        status = killed(replayed(recording, folder, path, bound, settings), folder, self._after)
        print(f'the second session ended with status {status}')
        step()
        self.session(recording, folder, path, bound, settings)


class Flights(Replays):
    """
    Sessions that the node maps live; what it had not written when it was killed is lost.

    Parameters
    ----------
    after : float
        Seconds from its first answer to the end of the node that is killed.
    rate : float
        Seconds of the flight a second.

    """

    def __init__(self, after, rate):
        self._after, self._rate = after, rate

    def session(self, recording, folder, path, bound, settings, **kill):
        """Fly a recording; print what it took."""
        begin = time.monotonic()
        used = flown.flown(recording, set_to(path, bound, settings), folder, self._rate, **kill)
        print(f'{folder.name}: flown in {time.monotonic() - begin:.0f} s, peak {used:.0f} MB')

    def killed(self, recording, folder, path, bound, settings, step):
        """Fly a recording; the node is killed in the midst, step() called, the node restarted."""
        def ended(status, answered):
            written = store.head(path).stored.saved.frames.stamp[-1]
            print(f'the node ended with status {status}; it had answered frames up to '
                  f'{(answered - START) / 1e9:.1f} s of the flight, the file has them up to '
                  f'{(written - START) / 1e9:.1f} s: '
                  f'{(answered - written) / 1e9:.1f} s of the flight are lost')
            step()
        self.session(recording, folder, path, bound, settings, after=self._after, killed=ended)


def night(recordings, trajectory, out, settings=(), replay=persem, by=None, after=0.2):
    """
    Map three recordings as a night goes; return what `persem map info` says at each step.

    replay(*words) runs a command; *by* are the Replays or Flights of all sessions but the first;
    *after* seconds the second session is killed, where it is replayed.

    """
    out.mkdir(parents=True, exist_ok=True)
    path, steps, replays = out / 'night.persem', {}, Replays(replay, after)
    by = by or replays

    def step(title):
        steps[title] = persem('map', 'info', path)
        print(f'--- {title}\n{steps[title]}', flush=True)

    alone, n = counted(recordings[0], out / 'alone', settings, replay)
    bound = n // SHARE
    print(f'the first session has {n} voxels: memory.max_voxels is {bound} for all of them')
    replays.session(recordings[0], out / 'first', path, bound, settings)
    same = 'the same' if labels_of(path) == (alone, n) else 'OTHER'
    print(f'{same} voxels and labels as without a bound')
    step('after the first session')
    by.killed(recordings[1], out / 'second', path, bound, settings,
              lambda: step('after the kill'))
    step('after the second session')
    by.session(recordings[2], out / 'third', path, bound, settings)
    step('after the third session')
    before, third = above.of(path), store.head(path).stored.saved.session
    print(persem('map', 'move', path, '--trajectory', trajectory, '--session', third))
    step('after its loop was closed')
    after = above.of(path)
    cv2.imwrite(str(out / 'night.png'),
                above.drawn({'before the loop was closed': before, 'after': after}, after[2:]))
    return steps


def main():
    """Simulate, or take recordings; map the night."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('out', type=Path, help='folder of night.persem and night.png')
    parser.add_argument('--frames', type=int, default=700, help='of each simulated flight')
    parser.add_argument('--node', action='store_true',
                        help='fly the second and the third live, into the node (make night-live)')
    parser.add_argument('--rate', type=float, default=1.0, help='of the live flights')
    parser.add_argument('--after', type=float, help='seconds after which the second is killed')
    args = parser.parse_args()
    if args.node:
        flown.check()
    args.out.mkdir(parents=True, exist_ok=True)
    recordings = simulated(args.out, args.frames)
    by = Flights(args.after or FLOWN, args.rate) if args.node else None
    night(recordings, recordings[2], args.out, (f'memory.voxel_size={VOXEL}',), apart, by,
          args.after or MAPPED)


if __name__ == '__main__':
    try:
        main()
    except PersemError as error:
        sys.exit(f'night.py: {error}')
