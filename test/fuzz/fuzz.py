"""
Files that mean harm, without end: `make fuzz MINUTES=30`, or `python test/fuzz/fuzz.py --help`.

Maps with renewed checksums, recordings, legends, settings and CDR, tried by processes that are
forked from one that has everything imported and compiled. Prints its seed, what a death or an
internal error came from (kind and number, which make the same input again: --try KIND NUMBER),
and figures. What once found something becomes an entry of findings.py, which `make test` replays.

"""

import argparse
from collections import Counter
import contextlib
import faulthandler
import gc
import json
import os
from pathlib import Path
import random
import resource
import shutil
import signal
import sys
import tempfile
import time

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]
LONGEST = 20.0          # s of processor time for one input
MOST_TIME = 60.0        # s of processor time after which one ends a worker
PATIENCE = 900.0        # s after which a worker that does nothing any more is killed
MOST = 2 << 30          # bytes of a worker
TURN = 120.0            # s for a worker


def main():
    """Fork workers until the time is over; return 1 for a death or a fault, 0 for none."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--minutes', type=float, default=30)
    parser.add_argument('--seed', type=int, default=random.SystemRandom().randrange(1 << 30))
    parser.add_argument('--workers', type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument('--try', nargs=2, dest='one', metavar=('KIND', 'NUMBER'))
    args = parser.parse_args()
    os.environ['PERSEM_THREADS'] = '1'      # one process a core is enough
    for name in ('OPENCV_LOG_LEVEL', 'OPENCV_FOR_THREADS_NUM'):
        os.environ[name] = '0'
    memory = Path('/dev/shm')
    folder = Path(tempfile.mkdtemp(prefix='persem-fuzz-', dir=memory if os.access(
        memory, os.W_OK) else None))
    tempfile.tempdir = str(folder)
    try:
        import harm
        trial = harm.Trial(folder)
        trial.warm_up()
        if args.one:
            print(*trial.run(args.one[0], int(args.one[1])))
            return 0
        print(f'seed {args.seed}', flush=True)
        return Fuzz(trial, args).run()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


class Worker:
    """A process that tries inputs from *first* on, and what is known of it."""

    def __init__(self, trial, first, seconds):
        self.first, self.began = first, time.monotonic()
        self.file = trial.folder / f'worker-{first}'
        self.file.touch()
        self.pid = os.fork()
        if self.pid:
            return
        status = 3
        try:
            status = self._work(trial, seconds)
        finally:
            os._exit(status)

    def _work(self, trial, seconds):
        """Try inputs; every line tells of one that begins, of a fault, or of all."""
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        null = os.open(os.devnull, os.O_WRONLY)     # the decoders' own complaints
        for handle in (1, 2):
            os.dup2(null, handle)
        trial.folder = trial.folder / f'files-{self.first}'
        trial.folder.mkdir()
        file = os.open(self.file, os.O_WRONLY)
        faulthandler.enable(os.open(f'{self.file}-stack', os.O_CREAT | os.O_WRONLY))
        gc.freeze()
        number, end, counts, seconds_of, longest = self.first, time.monotonic() + seconds, \
            Counter(), Counter(), (0.0, '')
        faults = []
        while time.monotonic() < end:
            kind = trial.kind_of(number)
            os.pwrite(file, f'{kind} {number}\n{"":40}'.encode(), 0)
            begin = time.process_time()     # other processes do not make an input slower
            signal.setitimer(signal.ITIMER_PROF, MOST_TIME)     # SIGPROF: the end
            outcome, what = trial.run(kind, number)
            took = time.process_time() - begin
            counts[f'{kind} {outcome}'] += 1
            seconds_of[kind] += took
            longest = max(longest, (took, f'{kind} {number}'))
            if outcome == 'fault' or took > LONGEST:
                faults.append(f'{kind} {number}: {took:.1f} s {what}')
            number += 1
        shutil.rmtree(trial.folder, ignore_errors=True)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        os.pwrite(file, json.dumps([counts, seconds_of, longest, peak, faults]).encode(), 0)
        return 0

    def poll(self):
        """Return None while it works, else its status; kill it where it takes too much."""
        with contextlib.suppress(OSError, IndexError, ValueError):
            pages = int(Path(f'/proc/{self.pid}/statm').read_text().split()[1])
            if pages * os.sysconf('SC_PAGE_SIZE') > 2 * MOST:
                os.kill(self.pid, signal.SIGKILL)
            if time.time() - self.file.stat().st_mtime > PATIENCE:
                os.kill(self.pid, signal.SIGKILL)
        pid, status = os.waitpid(self.pid, os.WNOHANG)
        return os.waitstatus_to_exitcode(status) if pid else None

    def told(self):
        """Return what the worker wrote last, and the stack of a death."""
        stack = Path(f'{self.file}-stack')
        text = self.file.read_text(), stack.read_text() if stack.exists() else ''
        for path in (self.file, stack):
            path.unlink(missing_ok=True)
        shutil.rmtree(self.file.with_name(f'files-{self.first}'), ignore_errors=True)
        return text


class Fuzz:
    """Workers, and the sums of what they tell."""

    def __init__(self, trial, args):
        self.trial, self.args = trial, args
        self.counts, self.seconds = Counter(), Counter()
        self.deaths = self.faults = self.peak = 0
        self.longest = (0.0, 'none')
        self.began = time.monotonic()

    def run(self):
        """Keep workers at work until the time is over; return 1 for a death or a fault."""
        end, first, workers = time.monotonic() + 60 * self.args.minutes, self.args.seed, []
        said = time.monotonic()
        while (left := end - time.monotonic()) > 0 or workers:
            while left > 1 and len(workers) < self.args.workers:
                workers.append(Worker(self.trial, first, min(TURN, left)))
                first += 10_000_000
            time.sleep(0.2)
            for worker in list(workers):
                status = worker.poll()
                if status is not None:
                    workers.remove(worker)
                    self._take(status, *worker.told())
            if time.monotonic() - said > 300:
                said = time.monotonic()
                print(self.line(), flush=True)
        for kind in sorted(self.seconds):
            refused, accepted = (self.counts[f'{kind} {word}'] for word in ('refused', 'accepted'))
            print(f'{kind:10} {refused + accepted:8} inputs, {accepted:8} of them accepted, '
                  f'{1000 * self.seconds[kind] / max(1, refused + accepted):7.2f} ms each')
        print(self.line())
        return int(bool(self.deaths or self.faults or self.peak > MOST))

    def line(self):
        """Return the figures as one line."""
        minutes = (time.monotonic() - self.began) / 60
        return (f'{sum(self.counts.values())} inputs in {minutes:.1f} minutes, '
                f'{self.deaths} deaths, {self.faults} faults, '
                f'longest {self.longest[0]:.1f} s ({self.longest[1]}), '
                f'peak RSS {self.peak / 1e6:.0f} MB')

    def _take(self, status, text, stack):
        """Add what a worker told, which may have died."""
        if status:
            self.deaths += 1
            print(f'death ({status}) at {text.splitlines()[:1]}: {stack[:1500]}', flush=True)
            return
        counts, seconds, longest, peak, faults = json.loads(text)
        self.counts.update(counts)
        self.seconds.update(seconds)
        self.longest = max(self.longest, tuple(longest))
        self.peak = max(self.peak, peak)
        self.faults += len(faults)
        for fault in faults:
            print(f'fault {fault}', flush=True)


if __name__ == '__main__':
    sys.exit(main())
