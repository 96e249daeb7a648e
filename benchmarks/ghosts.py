"""What memory.clear_after clears: vehicles mapped as if they stood still, and what stands."""

import argparse
from dataclasses import replace
import time

import numpy as np
from persem_ros.core.frame.clear import clear
from persem_ros.core.frame.view import View
from persem_ros.core.memory.blocks import block_numbers
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.warmup import warm_up
from persem_ros.frames import Frame, IGNORED
from persem_ros.pipeline import Pipeline
from persem_ros.settings.config import Config
from persem_ros.simulate import shapes
from persem_ros.simulate.flight import Flight, Plan
from persem_ros.simulate.materials import FENCE, VOID
from persem_ros.simulate.render import Renderer
from persem_ros.simulate.sensor import measured
from persem_ros.simulate.world import make_scene, make_world
import scenes

BRANCHES = 400          # rods of 4 cm, 2 to 4 m long, 2 to 5 m above ground
AWAY = 1e5              # metres: where the traffic is that must not be seen
BAD = 0.5               # seconds of bad localisation
SHIFT, TURN = 2.0, 3.0  # metres and degrees that poses are then wrong by


class Elsewhere:
    """A fleet far away."""

    def __init__(self, fleet):
        self._fleet, self.arrays, self.vertices = fleet, fleet.arrays, fleet.vertices

    def at(self, seconds):
        """Return x, y, yaw of all vehicles."""
        return self._fleet.at(seconds) + np.array([[AWAY], [0], [0]])


def world_of(seed):
    """Return a world with branches that stick out, and points along these, (n, 3)."""
    world, rng = make_world(seed), np.random.default_rng([seed, 9])
    solid, places = shapes.Solid(), []
    for _ in range(BRANCHES):
        x, y = rng.uniform((-90, -110), (70, 60))
        yaw, long = rng.uniform(0, np.pi), rng.uniform(2, 4)
        foot = float(world.terrain.on((x, y))[0][2]) + rng.uniform(2, 5)
        along = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        shapes.box(solid, (x, y, foot), yaw, (long, 0.04, 0.04), 'trunk')
        places.append((x, y, foot + 0.02) + np.linspace(-long / 2, long / 2, 60)[:, None] * along)
    old, thin = world.scene, make_scene(*solid.arrays())
    meshes = [one.caster.mesh for one in (old, thin)]
    faces = [meshes[0].faces, meshes[1].faces + len(meshes[0].vertices)]
    scene = make_scene(
        np.concatenate([m.vertices for m in meshes]), np.concatenate(faces),
        *(np.concatenate([getattr(old, name), getattr(thin, name)])
          for name in ('material', 'tint', 'base')))
    return replace(world, scene=scene), np.concatenate(places)


class Truth:
    """What each voxel holds, by its number: pixels of what moves, of what stands, of fences."""

    def __init__(self):
        self.counts = np.zeros((3, 1 << 22), np.int64)

    def frame(self, memory, seen, moving, labels):
        """Count the pixels of a frame."""
        numbers = memory.find(seen.voxels)
        number = np.where(seen.where >= 0, numbers[seen.where], -1)
        for row, mask in enumerate((moving, ~moving, ~moving & (labels == FENCE))):
            found = number[mask.reshape(-1) & (number >= 0)]
            self.counts[row] += np.bincount(found, minlength=self.counts.shape[1])


def flown(plan, config, bad=False):
    """Map a flight; return what became of its voxels as a dict of counts."""
    world, rods = world_of(plan.seed)
    flight = Flight(plan, workers=1, world=world)
    still = Renderer(replace(world, fleet=Elsewhere(world.fleet)), flight.camera)
    pipeline, truth = Pipeline(config), Truth()
    memory = pipeline.memory
    # The same observations, looked through by exact depth and poses; and without any margin.
    exact, free = (VoxelMemory(memory.voxel_size) for _ in range(2))
    bare = replace(config.memory, clear_margin=0.0, clear_slope=0.0)
    middle = flight.stamps[len(flight.stamps) // 2]
    before = set()
    for index, stamp in enumerate(flight.stamps):
        rng = np.random.default_rng([plan.seed, 5, index])
        true_pose = flight.body(stamp) @ flight.T_body_camera
        view = flight.view(index)
        behind = still.render(true_pose, 0.0).depth
        labels = np.where(view.labels == VOID, IGNORED, view.labels.astype(np.int32))
        depth = measured(view, plan.depth_errors, rng).astype(np.float64)
        pose = flight.recorded_camera(stamp)
        if bad and 0 <= stamp - middle < BAD * 1e9:
            pose = pose.copy()
            pose[:3, :3] = pose[:3, :3] @ turned(np.radians(TURN))
            pose[:3, 3] += SHIFT / np.sqrt(3)
            if not before:
                before = set(np.flatnonzero(memory.m.voxels['gone'][:memory.n_numbers]))
        frame = Frame(stamp, labels, depth, flight.camera, pose)
        seen = pipeline.add(frame)
        true = np.where(np.isfinite(view.depth), view.depth, np.nan)
        for other, settings in ((exact, config.memory), (free, bare)):
            other.add(seen)
            clear(other, replace(frame, depth=true, T_map_camera=true_pose), settings)
        if not (bad and 0 <= stamp - middle < BAD * 1e9):
            truth.frame(memory, seen, view.depth < behind - 0.05, view.labels)
    n = memory.n_numbers
    moved, stood, fence = truth.counts[:, :n]
    gone, gone_exact, gone_free = (one.m.voxels['gone'][:n] > 0 for one in (memory, exact, free))
    number = memory.find(np.unique(np.floor(rods / memory.voxel_size).astype(np.int32), axis=0))
    rod = np.zeros(n, bool)
    rod[number[number >= 0]] = True
    rod &= stood > 0
    ghost, standing = (moved > 0) & (stood == 0), stood > 0
    thin = (fence > 0) & (fence >= 0.5 * stood)
    return {'ghosts': ghost.sum(), 'free': (ghost & gone_free).sum(),
            'free cleared': (ghost & gone_free & gone).sum(),
            'exact': (ghost & gone_exact).sum(),
            'exact cleared': (ghost & gone_exact & gone).sum(),
            'standing': standing.sum(), 'standing cleared': (standing & gone).sum(),
            'fences': thin.sum(), 'fences cleared': (thin & gone).sum(),
            'branches': rod.sum(), 'branches cleared': (rod & gone).sum()}


def turned(angle):
    """Return a rotation about an image's vertical, (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def cost(config, frames, repeats=5):
    """Return voxels touched, in view and ms a frame, median and worst, of frames."""
    pipeline = Pipeline(replace(config, memory=replace(config.memory, clear_after=0)))
    for frame in frames:
        pipeline.add(frame)
    times, memory, viewed = [], pipeline.memory, []
    for frame in frames:
        numbers = block_numbers(memory, View(frame, memory, config.memory.clear_range).blocks())
        viewed.append(memory.m.blocks['count'][numbers[numbers >= 0]].sum())
    touched = np.mean([len(pipeline.observe(frame).labels) for frame in frames])
    for k in range(repeats):
        for frame in frames:
            later = replace(frame, stamp=frame.stamp + k * 10 ** 12)
            begin = time.perf_counter()
            clear(memory, later, config.memory)
            times.append(1e3 * (time.perf_counter() - begin))
    return touched, np.mean(viewed), np.median(times), max(times[1:])


def main():
    """Fly, clear, count; print a line for each flight and their sum."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seeds', type=int, nargs='*', default=[1, 2])
    parser.add_argument('--frames', type=int, default=300)
    parser.add_argument('--rate', type=float, default=5.0)
    parser.add_argument('--height', type=float, default=40.0)
    parser.add_argument('--tilt', type=float, default=35.0)
    parser.add_argument('--voxel-size', type=float, default=0.25)
    parser.add_argument('--after', type=int, default=3, help='memory.clear_after')
    parser.add_argument('--margin', type=float, default=1.5, help='memory.clear_margin')
    parser.add_argument('--slope', type=float, default=0.02, help='memory.clear_slope')
    parser.add_argument('--range', type=float, default=120.0, help='memory.clear_range')
    parser.add_argument('--no-cost', action='store_true')
    parser.add_argument('--only-cost', action='store_true')
    args = parser.parse_args()
    warm_up()
    config = Config()
    config = replace(config, memory=replace(
        config.memory, voxel_size=args.voxel_size, clear_after=args.after,
        clear_margin=args.margin, clear_slope=args.slope, clear_range=args.range))
    if not args.no_cost:
        frames = list(scenes.frames(scenes.flight(20, 5.0)))
        for far in (60.0, 80.0, 100.0, 200.0):
            coarse = replace(config, memory=replace(config.memory, voxel_size=0.5,
                                                    clear_range=far))
            touched, size, middle, worst = cost(coarse, frames)
            print(f'cost: {touched:.0f} voxels touched a frame, {size:.0f} in view within '
                  f'{far:g} m: {middle:.2f} ms a frame, at most {worst:.2f} ms')
    for bad in () if args.only_cost else (False, True):
        total = {}
        for seed in args.seeds:
            plan = Plan(seed=seed, frames=args.frames, rate=args.rate, altitude=args.height,
                        tilt=args.tilt)
            for name, count in flown(plan, config, bad).items():
                total[name] = total.get(name, 0) + int(count)
        print(f'\n{"with" if bad else "without"} half a second of bad localisation; '
              f'{len(args.seeds)} flights of {args.frames} frames, {args.height:g} m high, '
              f'camera {args.tilt:g} degrees down; voxels of {args.voxel_size:g} m, clear_after '
              f'{args.after}, margin {args.margin:g}, slope {args.slope:g}')
        print(f'    ghost voxels {total["ghosts"]}; looked through often enough by exact depth '
              f'and poses: {total["exact"]}, without any margin: {total["free"]}')
        for name, of in (('exact cleared', 'exact'), ('free cleared', 'free'),
                         ('standing cleared', 'standing'), ('fences cleared', 'fences'),
                         ('branches cleared', 'branches')):
            share = 100 * total[name] / max(1, total[of])
            print(f'    {name:<18}{total[name]:>8} of {total[of]:>8}   {share:6.2f} %')


if __name__ == '__main__':
    main()
