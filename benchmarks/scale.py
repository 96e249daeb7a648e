"""What persem build costs by recording, tile and observation, and what that makes of a city."""

import argparse
from pathlib import Path
import tempfile
import time

from persem_ros import cli, workers
from persem_ros.core.warmup import warm_up
from persem_ros.mosaic.run import build
from persem_ros.replay import replay
from persem_ros.settings.config import Config, updated

STAGES = 'look', 'observe', 'index', 'join', 'volatility', 'fit', 'refine', 'assemble'
PARALLEL = 'observe', 'join', 'fit', 'refine'
# A city: flights of an hour at 10 Hz over 100 km^2.
FLIGHTS, FRAMES, AREA = 1000, 36_000, 100e6
WORKERS = 1, 16, 256


def flights(folder, number, frames):
    """Return recordings of simulated flights, made where they are missing."""
    found = []
    for seed in range(number):
        path = folder / f'flight{seed}-{frames}'
        if not path.exists():
            cli.main(['simulate', str(path), '--frames', str(frames), '--seed', str(seed)])
        found.append(path)
    return found


def timed(function, *arguments, **options):
    """Return the seconds that a call takes, and what it returns."""
    began = time.perf_counter()
    result = function(*arguments, **options)
    return time.perf_counter() - began, result


def show(result, seconds, path):
    """Print what the stages of a build took; return seconds a unit: {stage: (cost, of what)}."""
    frames, voxels, seen = (result['frames']['used'], result['voxels'], result['observations'])
    tiles, sessions = result['tiles'], result['sessions']
    size = path.stat().st_size
    print(f'{sessions} recordings, {frames} frames, {tiles} tiles, {voxels} voxels, {seen} '
          f'observations ({seen / frames:.0f} a frame), {size / 1e6:.1f} MB '
          f'({size / seen:.1f} bytes an observation); {seconds:.1f} s')
    units = {'look': (sessions, 'recording'), 'observe': (frames, 'frame'),
             'index': (frames, 'frame'), 'join': (seen, 'observation'),
             'volatility': (tiles, 'tile'), 'fit': (seen, 'observation'),
             'refine': (seen, 'observation'), 'assemble': (seen, 'observation')}
    costs = {}
    for stage in (stage for stage in STAGES if stage in result['stages']):
        number, unit = units[stage]
        spent = result['stages'][stage]
        costs[stage] = spent / number, unit
        each = result['seconds'].get({'observe': 'recordings'}.get(stage, stage))
        by_task = '' if each is None else \
            f'; {sum(each) / len(each):.3f} s a {"recording" if stage == "observe" else "tile"}'
        print(f'  {stage:<11}{spent:8.2f} s {spent / number * 1e6:12.2f} us a {unit}{by_task}')
    for kind in ('looks', 'rounds'):    # tasks of fit
        if each := result['seconds'].get(kind):
            print(f'    {kind:<9}{sum(each):8.2f} s; {sum(each) / len(each):.3f} s a task')
    return costs


def city(costs, result, path, area):
    """Print what FLIGHTS would take by these costs, on some numbers of workers."""
    frames = FLIGHTS * FRAMES
    seen = frames * result['observations'] / result['frames']['used']
    number = {'recording': FLIGHTS, 'frame': frames, 'observation': seen, 'tile': AREA / 64 ** 2}
    print(f'{FLIGHTS} flights of {FRAMES} frames over {AREA / 1e6:.0f} km2: {seen:.2g} '
          f'observations, {seen * path.stat().st_size / result["observations"] / 1e12:.1f} TB, '
          f'{AREA * result["voxels"] / area:.2g} voxels; hours:')
    print(f'  {"workers":<11}' + ''.join(f'{n:>10}' for n in WORKERS))
    for stage, (cost, unit) in costs.items():
        hours = [cost * number[unit] / (n if stage in PARALLEL else 1) / 3600 for n in WORKERS]
        print(f'  {stage:<11}' + ''.join(f'{h:10.1f}' for h in hours))
    total = [sum(c * number[u] / (n if s in PARALLEL else 1) for s, (c, u) in costs.items()) / 3600
             for n in WORKERS]
    print(f'  {"in all":<11}' + ''.join(f'{h:10.1f}' for h in total))


def main():
    """Simulate, build on one core and on two, replay; print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--flights', type=int, default=4)
    parser.add_argument('--frames', type=int, default=60)
    parser.add_argument('--method', default='persem', help='refine.method')
    parser.add_argument('--folder', type=Path, help='keeps the simulated flights')
    parser.add_argument('--simulate', action='store_true', help='only make the flights')
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix='scale-') as work:
        out = Path(work)
        paths = flights(args.folder or out, args.flights, args.frames)
        if args.simulate:
            return
        warm_up(args.method == 'geometry')
        config = updated(Config(), {'memory.dynamic_labels': (10,), 'refine.method': args.method})
        seconds, _ = timed(replay, paths, out / 'replay', config, ('majority',), report=False)
        print(f'persem replay, all threads: {seconds:.1f} s (it renders and measures, too)')
        workers.one_thread()
        print('one core: ', end='')
        seconds, result = timed(build, paths, out / 'one', config, workers=1)
        costs = show(result, seconds, out / 'one' / 'map.persem')
        print('two processes: ', end='')
        seconds, both = timed(build, paths, out / 'two', config, workers=2)
        show(both, seconds, out / 'two' / 'map.persem')
        maps = [(out / name / 'map.persem').read_bytes() for name in ('replay', 'one', 'two')]
        print(f'the same bytes three times: {maps[0] == maps[1] == maps[2]}')
        city(costs, result, out / 'one' / 'map.persem', result['tiles'] * 64.0 ** 2)


if __name__ == '__main__':
    main()
