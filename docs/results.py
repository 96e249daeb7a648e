"""
Run the commands behind docs/results.md and put their tables into it.

    python docs/results.py WORK [--town DIR] [--kitchen DIR] [--patch DIR] [--only NAME …]

TOWN, KITCHEN and PATCH in the commands stand for folders of data; without one, its tables stay as
they are. WORK keeps recordings and results: what is finished there is not computed again. The
sentences between the tables are written by hand: read them again when the tables change.

"""

import argparse
from pathlib import Path
import re
import shlex
import subprocess
import sys

PAGE = Path(__file__).with_name('results.md')
SEEDS = (1, 2, 3, 4, 5)
FLIGHTS = [f'flight{seed}' for seed in SEEDS]
DOWN = ['down1', 'down2']      # the camera looks straight down: what comes later is no nearer
SMALL = [f'small{seed}' for seed in range(1, 16)]
HARD = {f'hard{factor:g}-{seed}': (factor, seed) for factor in (1.5, 2, 3)
        for seed in (1, 2)}
FEW = 'raw2d,majority,context_history,persem,geometry'
FOUR = 'raw2d,majority,persem,geometry'
ORDER = 'disturb.order=recorded,reversed,shuffled'
GAMMA = 'refine.gamma=0.5,0.7,0.8,0.9,0.95,1'
GAMMA_METHODS = 'raw2d,majority,trust,history,persem'
ABLATIONS = ['directions=0', 'groups=shapes', 'groups=cells', 'weight=0', 'smoothing=0',
             'shrink=1000']
# Each constant halved and doubled, rounds as far as that goes.
CONSTANTS = ['directions=4,16', 'window=10,40', 'cell=16,64', 'weight=0.25,1', 'smoothing=3,12',
             'prior=30,120', 'shrink=0.05,0.2', 'rounds=2,6']
EXTRAS = 'TOWN/extras/interval5_AMtown01'
IGNORED = ['--set', 'memory.ignore_labels=[0,255,65535]']


def commands():
    """Return the commands as lists of words, {name of the result: words}."""
    two = FLIGHTS[:2]
    town = ['town-depth', '--labels', 'uavscenes']

    def simulate(name, seed, *words):
        return name, ['simulate', name, '--seed', str(seed), *words]

    def frames(name, folder, *words):
        return name, ['convert', 'frames', folder, name, '--intrinsics',
                      f'{folder}/camera-intrinsics.txt', *words]

    def uavscenes(name, *words):
        return name, ['convert', 'uavscenes', 'TOWN', 'AMtown01', name, '--predictions',
                      f'{EXTRAS}/pred_id', *words]

    def evaluate(name, *words):
        return name, ['evaluate', *words, '--out', name]

    def sweep(name, vary, *words, methods=FEW):
        vary = [vary] if isinstance(vary, str) else vary
        return name, ['sweep', *words, *(w for v in vary for w in ('--vary', v)), '--methods',
                      methods, '--out', name]

    def each(name, constants, *words):
        return sweep(name, [f'refine.geometry.{c}' for c in join(constants)], *words, '--each',
                     '--no-figures', methods='majority,geometry')

    in_order = 'raw2d,majority,recency,trust,context_history,persem'
    label, small = ['--labels', 'town'], ['--size', '320x240', '--frames', '100']
    return dict([
        *(simulate(name, seed) for name, seed in zip(FLIGHTS, SEEDS)),
        *(simulate(name, seed, '--tilt', '90') for name, seed in zip(DOWN, SEEDS)),
        *(simulate(name, seed, *small) for seed, name in enumerate(SMALL, 1)),
        *(simulate(name, seed, *small, '--difficulty', f'{factor:g}')
          for name, (factor, seed) in HARD.items()),
        uavscenes('town-depth', '--depth', f'{EXTRAS}/depth_cm_u16', '--depth-unit', 'cm'),
        frames('kitchen', 'KITCHEN'),
        *(frames(f'patch-{which}', 'PATCH', '--labels', f'frame-*.{which}.png', '--truth',
                 'frame-*.truth.png', '--rate', '5') for which in ('good', 'weak')),
        evaluate('flights', *FLIGHTS, *label),
        evaluate('small', *SMALL, *label, '--methods', FOUR, '--no-figures'),
        evaluate('town-single', *town), evaluate('town-grouped', *town, '--grouped'),
        *(evaluate(f'{name}-four', name, *words, '--methods', FOUR) for name, words in (
            ('patch-good', IGNORED), ('patch-weak', IGNORED))),
        evaluate('kitchen-fine', 'kitchen', '--set', 'memory.voxel_size=0.03', '--set',
                 'memory.ignore_labels=0,255,65535'),
        evaluate('town-all', 'town-depth', '--methods', FOUR, '--no-figures'),
        each('ablations', ABLATIONS, *SMALL[:4], *label),
        each('ablations-town', ABLATIONS, *town),
        *(each(f'ablations-{which}', ABLATIONS, f'patch-{which}', *IGNORED)
          for which in ('good', 'weak')),
        evaluate('hard', *SMALL[:2], *HARD, *label, '--methods', FOUR, '--no-figures'),
        each('constants', CONSTANTS, *SMALL[:2], *label),
        each('constants-good', CONSTANTS, 'patch-good', *IGNORED),
        sweep('order-geometry', ORDER, *SMALL[:2], 'patch-good', *IGNORED,
              methods='majority,geometry'),
        evaluate('down', *DOWN, *label),
        evaluate('flights-static', *FLIGHTS, '--no-dynamic', '--set',
                 'memory.dynamic_labels=10'),
        sweep('pose-noise', 'disturb.pose_noise=0,0.1,0.25,0.5,1', *two, *label),
        sweep('voxel-size', 'memory.voxel_size=0.25,0.5,1,2', *two, *label),
        sweep('pose-drift', 'disturb.pose_drift=0,0.5,1,2,4', *two, *label),
        sweep('depth-noise', 'disturb.depth_noise=0,0.005,0.01,0.02', *two, *label),
        sweep('stride', 'memory.stride=1,2,4', *two, *label),
        sweep('order', ORDER, *FLIGHTS, *label, methods=in_order),
        sweep('order-town', ORDER, *town, methods=in_order),
        sweep('gamma', GAMMA, *two, *label, methods=GAMMA_METHODS),
        sweep('gamma-town', GAMMA, *town, methods=GAMMA_METHODS),
        sweep('eta-tau', ['refine.eta=0,0.15,0.3,0.45,0.6', 'refine.tau_context=0,0.1,0.3'],
              *two, *label, methods='majority,history,context_history,persem'),
        sweep('ema', 'ema.alpha=0,0.3,0.5,0.7,0.9', *two, *label, methods='raw2d,ema2d')])


def join(constants):
    """Return NAME=A,B of NAME=A and NAME=B."""
    found = {}
    for name, values in (item.split('=') for item in constants):
        found.setdefault(name, []).append(values)
    return [f'{name}={",".join(values)}' for name, values in found.items()]


def main():
    """Run what is missing and rewrite the page's tables."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('work', metavar='WORK', type=Path)
    for name in ('town', 'kitchen', 'patch'):
        parser.add_argument(f'--{name}', metavar='DIR', type=Path)
    parser.add_argument('--only', metavar='NAME', nargs='*', default=[],
                        help='no more than these results')
    parser.add_argument('--by', metavar='COMMAND', default='',
                        help='what runs each command, for example "nice -n 19"')
    parser.add_argument('--workers', metavar='N', default='0', help='of each evaluation')
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    folders = {'TOWN': args.town, 'KITCHEN': args.kitchen, 'PATCH': args.patch}
    for name, words in commands().items():
        done = (args.work / name).exists()
        if words[0] in ('simulate', 'convert') and done or args.only and name not in args.only:
            continue
        words = [filled_in(word, folders) for word in words]
        if None in words:
            continue
        if words[0] in ('evaluate', 'sweep'):
            if any(word in commands() and not (args.work / word).exists() for word in words[1:-1]):
                continue
            words += ['--workers', args.workers]
        subprocess.run([*shlex.split(args.by), sys.executable, '-m', 'persem_ros', *words],
                       cwd=args.work, check=True)
    PAGE.write_text(filled(PAGE.read_text('utf-8'), args.work), 'utf-8')


def filled_in(word, folders):
    """Return a word with the path of the folder that it begins with; None without that folder."""
    name, slash, rest = word.partition('/')
    if name not in folders:
        return word
    return folders[name] and str(folders[name].resolve()) + slash + rest


def filled(page, work):
    """Return the page with its blocks replaced by what lies in the folder of results."""
    def block(match):
        name = match[1]
        if name == 'commands':
            text = '```console\n' + ''.join(
                f'$ {shlex.join(["persem", *words])}\n' for words in commands().values()) + '```\n'
        else:
            path = work / f'{name}.md'
            text = path.read_text('utf-8') if path.exists() else match[2]
        return f'<!-- begin {name} -->\n{text.strip()}\n<!-- end -->'
    return re.sub(r'<!-- begin (\S+) -->\n(.*?)<!-- end -->', block, page, flags=re.DOTALL)


if __name__ == '__main__':
    main()
