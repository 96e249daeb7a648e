"""
Files that mean harm, without end: `make fuzz MINUTES=30`, or `python test/fuzz/fuzz.py --help`.

Maps with renewed checksums, recordings, legends, settings and CDR, in child processes under a
limit of memory and time. Prints its seed, what a death or an internal error came from (the kind
and the number that makes the same input again), and figures. Numbers that once found something
stand in corpus.txt, which `make test` replays.

"""

import argparse
from pathlib import Path
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]
LONGEST = 20.0          # s for one input
MOST = 2 << 30          # bytes of a child


def main():
    """Run children one after another until the time is over; return the number of deaths."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--minutes', type=float, default=30)
    parser.add_argument('--seed', type=int, default=random.SystemRandom().randrange(1 << 30))
    parser.add_argument('--child', type=int, help=argparse.SUPPRESS)
    parser.add_argument('--seconds', type=float, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.child is not None:
        return child(args.child, args.seconds)
    print(f'seed {args.seed}', flush=True)
    end, number, deaths, faults = time.time() + 60 * args.minutes, args.seed, 0, 0
    inputs, longest, peak = 0, (0.0, ''), 0
    while (left := end - time.time()) > 0:
        result = subprocess.run(
            [sys.executable, __file__, '--child', str(number), '--seconds',
             str(min(120.0, left))], capture_output=True, text=True)
        last = ''
        for line in result.stdout.splitlines():
            word, _, rest = line.partition(' ')
            if word == 'begin':
                last = rest
            elif word == 'fault':
                faults += 1
                print(line, flush=True)
            elif word == 'done':
                count, seconds, slowest, rss = rest.split(' ', 3)
                inputs += int(count)
                longest = max(longest, (float(seconds), slowest))
                peak = max(peak, int(rss))
        if result.returncode:
            deaths += 1
            print(f'death ({result.returncode}) at {last}: {result.stderr[-500:]}', flush=True)
        number += 1_000_000
    print(f'{inputs} inputs, {deaths} deaths, {faults} faults, longest {longest[0]:.1f} s '
          f'({longest[1]}), peak RSS {peak / 1e6:.0f} MB')
    return int(deaths or faults)


def child(number, seconds):
    """Try inputs for some time; print what is needed to tell what happened."""
    import harm
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    folder = Path(tempfile.mkdtemp(prefix='persem-fuzz-'))
    try:
        trial = harm.Trial(folder)
        end, count, longest = time.time() + seconds, 0, (0.0, 'none')
        while time.time() < end:
            kind = trial.kind_of(number)
            print(f'begin {kind} {number}', flush=True)
            begin = time.time()
            fault = trial.run(kind, number)
            took = time.time() - begin
            longest = max(longest, (took, f'{kind}-{number}'))
            if fault or took > LONGEST:
                print(f'fault {kind} {number} {took:.1f} s {fault}', flush=True)
            number, count = number + 1, count + 1
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        print(f'done {count} {longest[0]:.3f} {longest[1]} {peak * 1000}', flush=True)
        return int(peak * 1024 > MOST)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == '__main__':
    sys.exit(main())
