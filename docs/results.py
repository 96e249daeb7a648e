"""
Run the commands behind docs/results.md and put their tables into it.

    python docs/results.py WORK [--town RECORDING] [--kitchen RECORDING]

TOWN and KITCHEN in the commands stand for the two recordings; without one, its tables stay as they
are. WORK keeps recordings and results: what is finished there is not computed again. The sentences
between the tables are written by hand: read them again when the tables change.

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
FEW = 'raw2d,majority,context_history,persem'
ORDER = 'disturb.order=recorded,reversed,shuffled'
GAMMA = 'refine.gamma=0.5,0.7,0.8,0.9,0.95,1'
GAMMA_METHODS = 'raw2d,majority,trust,history,persem'


def commands():
    """Return the commands as lists of words, {name of the result: words}."""
    two = FLIGHTS[:2]
    town = ['TOWN', '--labels', 'uavscenes']

    def evaluate(name, *words):
        return name, ['evaluate', *words, '--out', name]

    def sweep(name, vary, *words, methods=FEW):
        vary = [vary] if isinstance(vary, str) else vary
        return name, ['sweep', *words, *(w for v in vary for w in ('--vary', v)), '--methods',
                      methods, '--out', name]

    in_order = 'raw2d,majority,recency,trust,context_history,persem'
    label = ['--labels', 'town']
    return dict([
        *((flight, ['simulate', flight, '--seed', str(seed)])
          for flight, seed in zip(FLIGHTS, SEEDS)),
        *((flight, ['simulate', flight, '--seed', str(seed), '--tilt', '90'])
          for flight, seed in zip(DOWN, SEEDS)),
        evaluate('flights', *FLIGHTS, *label),
        evaluate('down', *DOWN, *label),
        evaluate('flights-static', *FLIGHTS, '--no-dynamic', '--set',
                 'memory.dynamic_labels=10'),
        evaluate('town-single', *town), evaluate('town-grouped', *town, '--grouped'),
        evaluate('kitchen-fine', 'KITCHEN', '--set', 'memory.voxel_size=0.03', '--set',
                 'memory.ignore_labels=0,255,65535'),
        sweep('order', ORDER, *FLIGHTS, *label, methods=in_order),
        sweep('order-town', ORDER, *town, methods=in_order),
        sweep('gamma', GAMMA, *two, *label, methods=GAMMA_METHODS),
        sweep('gamma-town', GAMMA, *town, methods=GAMMA_METHODS),
        sweep('eta-tau', ['refine.eta=0,0.15,0.3,0.45,0.6', 'refine.tau_context=0,0.1,0.3'],
              *two, *label, methods='majority,history,context_history,persem'),
        sweep('ema', 'ema.alpha=0,0.3,0.5,0.7,0.9', *two, *label, methods='raw2d,ema2d'),
        sweep('pose-noise', 'disturb.pose_noise=0,0.1,0.25,0.5,1', *two, *label),
        sweep('pose-drift', 'disturb.pose_drift=0,0.5,1,2,4', *two, *label),
        sweep('depth-noise', 'disturb.depth_noise=0,0.005,0.01,0.02', *two, *label),
        sweep('voxel-size', 'memory.voxel_size=0.25,0.5,1,2', *two, *label),
        sweep('stride', 'memory.stride=1,2,4', *two, *label)])


def main():
    """Run what is missing and rewrite the page's tables."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('work', metavar='WORK', type=Path)
    for name in ('town', 'kitchen'):
        parser.add_argument(f'--{name}', metavar='RECORDING', type=Path)
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    found = {'TOWN': args.town, 'KITCHEN': args.kitchen}
    for name, words in commands().items():
        if name in FLIGHTS + DOWN and (args.work / name).exists():
            continue
        if any(word in found and found[word] is None for word in words):
            continue
        words = [str(found[word].resolve()) if found.get(word) else word for word in words]
        subprocess.run([sys.executable, '-m', 'persem_ros', *words], cwd=args.work, check=True)
    PAGE.write_text(filled(PAGE.read_text('utf-8'), args.work), 'utf-8')


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
