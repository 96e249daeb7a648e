"""
A night's map in one command: three sessions in one file, one killed, one closing a loop.

Simulates three flights over one town and the fields around, maps them into one attached file,
from the second on with memory for a tenth of the first, which is some frames' views, kills the
second replay (SIGKILL) and starts it again, and moves the third session, whose poses drift, by
the path that closing its loop gave. Prints `persem map info` after each step and draws the map
from above before and after the move.

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

import cv2
import numpy as np
import persem_ros
from persem_ros import cli
from persem_ros.errors import PersemError
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
CELLS = 600         # of a picture, along its longer side
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


def replayed(recording, out, path, bound, settings=()):
    """Return the words of the replay that adds a recording to the map file."""
    values = (f'map.path={path}', 'map.attached=true', f'memory.max_voxels={bound}',
              'memory.dynamic_labels=[10]', *settings)
    return ['replay', recording, '--out', out, '--methods', 'majority',
            *(word for value in values for word in ('--set', value))]


def killed(words, out, after):
    """Kill a replay some seconds after it has begun to map; return its exit status."""
    process = subprocess.Popen([sys.executable, '-m', 'persem_ros', *map(str, words)],
                               stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and not list(out.glob('.persem-run.*')):
        time.sleep(0.01)
    time.sleep(after)
    process.send_signal(signal.SIGKILL)
    return process.wait()


def from_above(path):
    """Return a picture of a map file: of each column of voxels the topmost; and its corners."""
    found = persem_ros.open_map(path)
    columns, colors = found.columns(), found.legend.colors
    at = columns['voxel'].astype(np.int64)
    low, high = (np.quantile(at[:, :2], q, axis=0, method='nearest') for q in (0.001, 0.999))
    return at, colors(columns['label']), low, high


def drawn(maps, corners):
    """Return pictures of maps side by side, between the same corners, (H, W, 3) uint8."""
    low, high = corners
    scale = int(-(-(high - low + 1).max() // CELLS))
    width, height = ((high - low) // scale + 1).tolist()
    pictures = []
    for title, (at, rgb, *_) in maps.items():
        picture = np.full((height, width, 3), 255, np.uint8)
        inside = np.flatnonzero(((at[:, :2] >= low) & (at[:, :2] <= high)).all(axis=1))
        inside = inside[np.argsort(at[inside, 2], kind='stable')]       # the topmost comes last
        cell = (at[inside, :2] - low) // scale
        picture[height - 1 - cell[:, 1], cell[:, 0]] = rgb[inside][:, ::-1]
        strip = np.full((24, width, 3), 255, np.uint8)
        cv2.putText(strip, title, (4, 17), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1,
                    cv2.LINE_AA)
        pictures.append(np.concatenate([strip, picture]))
    gap = np.full((height + 24, 8, 3), 255, np.uint8)
    return np.concatenate([pictures[0], *(part for one in pictures[1:] for part in (gap, one))],
                          axis=1)


def night(recordings, trajectory, out, settings=(), replay=persem, after=0.2):
    """
    Map three recordings as a night goes; return what `persem map info` says at each step.

    replay(*words) runs a command; *after* seconds the second session is killed.

    """
    out.mkdir(parents=True, exist_ok=True)
    path, steps, bound = out / 'night.persem', {}, 0

    def step(title):
        steps[title] = persem('map', 'info', path)
        print(f'--- {title}\n{steps[title]}')

    def rss(name):
        timing = json.loads((out / name / 'timing.json').read_text('utf-8'))
        print(f'{name}: {timing["frames"]} frames, {timing["total_s"]:.0f} s, peak '
              f'{timing["memory"]["peak_rss_bytes"] / 1e6:.0f} MB')

    replay(*replayed(recordings[0], out / 'first', path, bound, settings))
    rss('first')
    step('after the first session')
    bound = len(persem_ros.open_map(path)) // SHARE
    print(f'from now on memory.max_voxels is {bound}')
    words = replayed(recordings[1], out / 'second', path, bound, settings)
    status = killed(words, out / 'second', after)
    print(f'the second session ended with status {status}')
    step('after the kill')
    replay(*words, '--force')
    rss('second')
    step('after the second session, again')
    replay(*replayed(recordings[2], out / 'third', path, bound, settings))
    rss('third')
    step('after the third session')
    before = from_above(path)
    print(persem('map', 'move', path, '--trajectory', trajectory, '--session', '2'))
    step('after its loop was closed')
    after = from_above(path)
    cv2.imwrite(str(out / 'night.png'),
                drawn({'before the loop was closed': before, 'after': after}, after[2:]))
    return steps


def main():
    """Simulate, or take recordings; map the night."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('out', type=Path, help='folder of night.persem and night.png')
    parser.add_argument('--frames', type=int, default=700, help='of each simulated flight')
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    recordings = simulated(args.out, args.frames)
    night(recordings, recordings[2], args.out, (f'memory.voxel_size={VOXEL}',), apart, MAPPED)


if __name__ == '__main__':
    main()
