"""A map that moves when a loop is closed, against the drifted one and one mapped anew."""

import argparse
from dataclasses import replace
import time

import numpy as np
from persem_ros.core.frame.images import on_depth
from persem_ros.core.frame.observe import Observations
from persem_ros.core.frame.render import render_map
from persem_ros.core.jit import set_threads
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.loading import load
from persem_ros.core.memory.move import corrected, correction_of, moved
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.refine.whole import refine
from persem_ros.core.trajectory import Correction, Trajectory
from persem_ros.core.transforms import quaternions, rotations, slerps
from persem_ros.core.warmup import warm_up
from persem_ros.inputs.decode.serialized import Decoder
from persem_ros.outputs.recording.messages import MessageFactory
from persem_ros.pipeline import Pipeline
from persem_ros.settings.config import Config, updated
from persem_ros.simulate.flight import Flight
from persem_ros.simulate.plan import Plan
from persem_ros.simulate.sensor import PoseErrors
from rosbags.typesys import get_typestore, Stores

STEPS = 10
TICK = 0.01         # s between two looks of the mapping thread
WIDE, MANY = 200, 40_000        # of the made-up map of 5 million observations: a frame's voxels


def flown(count, size, seed):
    """Return the flight and its frames, as recorded."""
    flight = Flight(Plan(frames=count, width=size, height=size * 3 // 4, speed=2800 / count,
                         seed=seed, pose_errors=PoseErrors(odometry=1.0)))
    return flight, [replace(frame, color=None) for frame in flight.frames()]


def path_of(flight, share=1.0):
    """Return the path that closing the loop gives, or a share of the way there."""
    stamps = flight.keyframes
    true = np.stack([flight.body(stamp) for stamp in stamps])
    T = np.stack([flight.recorded_camera(stamp) @ np.linalg.inv(flight.T_body_camera)
                  for stamp in stamps])
    T[:, :3, 3] += share * (true - T)[:, :3, 3]
    T[:, :3, :3] = rotations(slerps(quaternions(T[:, :3, :3]), quaternions(true[:, :3, :3]),
                                    np.full((len(T), 1), share)))
    return Trajectory(np.array(stamps), T, 'the path')


def correct(saved, path):
    """Return a dump moved by a path."""
    K = correction_of(saved.frames, 0, path)
    return moved(saved, corrected(saved.frames, 0, K), saved.frames.session == 0)


def mapped(config, frames, mount):
    """Return the memory of some frames, whose poses are of a body."""
    pipeline = Pipeline(config)
    for frame in frames:
        pipeline.add(replace(frame, T_body_camera=mount))
    return pipeline.memory


def measured(config, memory, frames):
    """Return pixel accuracy and the share of pixels without a voxel, per cent."""
    pipeline, right, lost, valid = Pipeline(config, memory), 0, 0, 0
    for frame in frames:
        voxels = pipeline.voxel_image(frame)
        truth, given = (on_depth(frame, image) for image in (frame.truth, frame.labels))
        good = np.isfinite(frame.depth) & (truth >= 0) & (given >= 0)
        labels = render_map(memory, voxels)
        right += np.count_nonzero(good & (voxels >= 0) & (labels == truth))
        lost += np.count_nonzero(good & (voxels < 0))
        valid += np.count_nonzero(good)
    return 100 * right / valid, 100 * lost / valid


def alike(memory, exact):
    """Return the share of the exact map's voxels that are there, and of these with its label."""
    a, b = memory.voxels(), exact.voxels()
    found = memory.find(b['voxel'])
    label = dict(zip(a['number'].tolist(), a['label'].tolist()))
    there = found >= 0
    same = [label[n] == c for n, c in zip(found[there].tolist(), b['label'][there].tolist())]
    return 100 * there.mean(), 100 * np.mean(same)


def accuracy(count, size, seed):
    """Print what each map shows of the flight."""
    config = updated(Config(), {})
    flight, frames = flown(count, size, seed)
    path, mount = path_of(flight), flight.T_body_camera
    recorded = np.stack([flight.recorded_camera(s) @ np.linalg.inv(mount) for s in path.stamps])
    K = Correction(path.stamps, path.poses, recorded)
    right = [replace(f, T_map_camera=K.pose(f.T_map_camera, f.stamp)) for f in frames]
    away = [np.linalg.norm(a.T_map_camera[:3, 3] - b.T_map_camera[:3, 3])
            for a, b in zip(frames, right)]
    drifted, exact = mapped(config, frames, mount), mapped(config, right, mount)
    saved = dump(drifted)
    print(f'seed {seed}: {count} frames of {size} x {size * 3 // 4}, '
          f'{count * flight.plan.speed / flight.plan.rate:.0f} m of flight, poses off by '
          f'{np.mean(away):.1f} m on the mean, {max(away):.1f} m at most; '
          f'{len(saved.history_frame)} observations\n')
    begin = time.perf_counter()
    once = correct(saved, path)
    took = time.perf_counter() - begin
    middle = correct(replace(saved, history_offset=np.full_like(saved.history_offset, 128)), path)
    slowly = saved
    for k in range(1, STEPS + 1):
        slowly = correct(slowly, path_of(flight, k / STEPS))
    maps = {'drifted, seen from its own poses': (drifted, frames),
            'drifted, seen from the right poses': (drifted, right),
            'mapped anew by corrected poses (exact)': (exact, right),
            'moved': (load(once), right),
            'moved, without the offsets': (load(middle), right),
            f'moved in {STEPS} small corrections': (load(slowly), right)}
    print('| map | voxels | observations | PA % | no voxel % | of the exact voxels there % | '
          'with its label % |\n|---|---:|---:|---:|---:|---:|---:|')
    for name, (memory, seen) in maps.items():
        refine(memory, config.refine)
    for name, (memory, seen) in maps.items():
        figures = *measured(config, memory, seen), *alike(memory, exact)
        print(f'| {name} | {memory.n_voxels} | {memory.n_observations} | '
              + ' | '.join(f'{x:.2f}' for x in figures) + ' |', flush=True)
    print(f'\nmoved in {took:.2f} s')


def strip(k, rng):
    """Return the k-th frame of a survey of 40 000 voxels a frame, four in five seen before."""
    n = np.arange(MANY)
    x = n // WIDE + k % 125 * 40
    voxels = np.stack([x, n % WIDE, np.rint(5 * np.sin(x / 9)).astype(int)], axis=1)
    return Observations(
        voxels.astype(np.int32), (n % 9).astype(np.uint16), np.full(MANY, 0.9, np.float32),
        np.empty(0, np.int32), np.arange(9, dtype=np.uint16), 10 ** 8 * k, np.eye(4), '',
        rng.integers(0, 256, (MANY, 3)).astype(np.uint8))


def stall(count, rate):
    """Print how long the mapping thread of a node is away from frames while a map moves."""
    from persem_ros.ros.mover import Mover
    config = updated(Config(), {'topics.trajectory': 'path', 'trajectory.period': 0.1})
    memory, rng, k = VoxelMemory(config.memory.voxel_size), np.random.default_rng(0), 0
    while memory.n_observations < count:
        memory.add(strip(k, rng))
        k += 1
    first = k
    store = get_typestore(Stores.ROS2_JAZZY)
    T = np.eye(4)
    poses = []
    for j in range(0, first, 10):
        T = T.copy()
        T[0, 3], T[1, 3] = 0.01 * j, 0.02 * j
        poses.append((10 ** 8 * j, T))
    path = MessageFactory(store.types).path(0, 'map', poses)
    mover = Mover(Decoder(), lambda: None)
    mover.take(bytes(store.serialize_cdr(path, 'nav_msgs/msg/Path')))
    seen = [strip(first + i, rng) for i in range(200)]
    before = []
    for i in range(20):
        before.append(_added(memory, seen[i]))
        time.sleep(max(0.0, 1 / rate - before[-1]))
    frames, away, new, i, begin = [], [], None, 20, time.perf_counter()
    while new is None and i < len(seen):
        due = time.perf_counter() + 1 / rate
        frames.append(_added(memory, seen[i]))
        mover.note(seen[i])
        i += 1
        while new is None and time.perf_counter() < due:      # a node wakes for every message
            at = time.perf_counter()
            new = mover.step(memory, config)
            away.append(time.perf_counter() - at)
            time.sleep(TICK)
    took = time.perf_counter() - begin
    mover.close()
    assert new is not None and len(new.frames) == len(memory.frames)
    print(f'{memory.n_observations - MANY * i} observations, {memory.n_voxels} voxels, frames of '
          f'{MANY} voxels at {rate:g} Hz\n'
          f'moved in {took:.2f} s beside the mapping; the mapping thread was away for '
          f'{1e3 * max(away):.1f} ms at worst, {1e3 * sum(away):.0f} ms in all\n'
          f'a frame: {1e3 * np.median(before):.1f} ms before (worst {1e3 * max(before):.1f}), '
          f'{1e3 * np.median(frames):.1f} ms meanwhile (worst {1e3 * max(frames):.1f}); '
          f'{i - 20} frames came meanwhile, none was lost')


def _added(memory, seen):
    """Add a frame and return how long that took."""
    begin = time.perf_counter()
    memory.add(seen)
    return time.perf_counter() - begin


def main():
    """Measure what the options ask for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--frames', type=int, default=240)
    parser.add_argument('--size', type=int, default=320, help='width of the images, pixels')
    parser.add_argument('--seeds', type=int, nargs='*', default=[0])
    parser.add_argument('--observations', type=int, default=5_000_000,
                        help='of the map whose move is timed; 0: none')
    parser.add_argument('--rate', type=float, default=10.0, help='frames per second meanwhile')
    args = parser.parse_args()
    warm_up(False)
    for seed in args.seeds:
        accuracy(args.frames, args.size, seed)
    if args.observations:
        set_threads(1)
        stall(args.observations, args.rate)


if __name__ == '__main__':
    main()
