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
SHOWN = 3               # faults of a kind


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
        print('compiling and loading …', flush=True)
        with silenced():
            trial.warm_up()
        if args.one:
            print(*trial.run(args.one[0], int(args.one[1])))
            return 0
        print(f'seed {args.seed}', flush=True)
        fuzz = Fuzz(trial, args)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, fuzz.stop)
        return fuzz.run()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def silenced():
    """Let nothing be heard of what decoders write on standard error."""
    kept, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(null)


class Worker:
    """A process that tries inputs from *first* on, and what is known of it."""

    def __init__(self, trial, first, seconds):
        self.first, self.asked = first, 0.0
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
        parent, ended = os.getppid(), []
        signal.signal(signal.SIGINT, signal.SIG_IGN)    # of a terminal; the parent asks by SIGTERM
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
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
        while time.monotonic() < end and not ended and os.getppid() == parent:
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

    def end(self):
        """Ask the worker to tell what it has when its input is done."""
        if not self.asked:
            self.asked = time.monotonic()
            os.kill(self.pid, signal.SIGTERM)

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
        self.counts, self.seconds, self.shown = Counter(), Counter(), Counter()
        self.deaths = self.faults = self.peak = 0
        self.longest = (0.0, 'none')
        self.began, self.stopped = time.monotonic(), False

    def stop(self, *_):
        """Begin no more; what was found so far is told."""
        self.stopped = True

    def run(self):
        """
        Keep workers at work until the time is over, or stop(); return 1 for a death or a fault.

        The table is printed however it ends.

        """
        end, first, workers = time.monotonic() + 60 * self.args.minutes, self.args.seed, []
        said = time.monotonic()
        while (left := end - time.monotonic()) > 0 and not self.stopped or workers:
            while left > 1 and not self.stopped and len(workers) < self.args.workers:
                workers.append(Worker(self.trial, first, min(TURN, left)))
                first += 10_000_000
            time.sleep(0.2)
            for worker in list(workers):
                if self.stopped:
                    worker.end()
                status = worker.poll()
                if status is not None:
                    workers.remove(worker)
                    self._take(status, *worker.told())
            if time.monotonic() - said > 300:
                said = time.monotonic()
                print(self.line(), flush=True)
        print(self.table())
        print(self.line())
        return int(bool(self.deaths or self.faults or self.peak > MOST))

    def table(self):
        """Return the figures by kind."""
        lines = [f'{"kind":12}{"inputs":>10}{"refused":>10}{"accepted":>10}{"faults":>8}'
                 f'{"ms each":>9}']
        for kind in sorted(self.seconds):
            refused, accepted, faults = (self.counts[f'{kind} {word}']
                                         for word in ('refused', 'accepted', 'fault'))
            n = refused + accepted + faults
            lines.append(f'{kind:12}{n:>10}{refused:>10}{accepted:>10}{faults:>8}'
                         f'{1000 * self.seconds[kind] / max(1, n):>9.2f}')
        return '\n'.join(lines)

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
            what = fault.partition(' s ')[2][:60]
            self.shown[what] += 1
            if self.shown[what] <= SHOWN:       # enough of what is one and the same defect
                print(f'fault {fault}', flush=True)


if __name__ == '__main__':
    sys.exit(main())
