"""
Replays in processes of their own that are killed, interrupted or run out of space on the way.

Reads a JSON list of jobs from standard input, writes a JSON list of [exit status, standard error]
to standard output; a status below 0 is the signal that ended the process. A job has the keys
arguments (of the command line), phase, signal (a name, or '') and file_size (bytes that a file
may have, or 0). The processes are forks of one that has replayed once, so that all is loaded.

"""

from contextlib import redirect_stdout
import gc
import json
import os
import resource
import signal
import sys
import tempfile

from persem_ros import cli, rendering, replay
from persem_ros.outputs import files
from persem_ros.outputs.map import store
from persem_ros.outputs.recording import refined, writer
from persem_ros.outputs.results import timing
import quick_yaml

os.fsync = lambda handle: None      # as in conftest.py
quick_yaml.use(quick_yaml.Yaml)


def main():
    """Run all jobs, two at a time."""
    jobs, results = json.load(sys.stdin), []
    rehearse(jobs[0]['arguments'])
    for i in range(0, len(jobs), 2):
        results += [finish(*begun) for begun in [start(job) for job in jobs[i:i + 2]]]
    json.dump(results, sys.stdout)


def rehearse(arguments):
    """Replay into a folder that is thrown away; what it left in memory is not collected again."""
    with tempfile.TemporaryDirectory() as folder, open(os.devnull, 'w') as nowhere, \
            redirect_stdout(nowhere):
        assert cli.main([*arguments[:3], f'{folder}/out', *arguments[4:]]) == 0
    gc.freeze()         # lest a collection touch, and so copy, every page in every fork


def start(job):
    """Fork a process for one job; return its number and the file of its standard error."""
    errors = tempfile.TemporaryFile()
    pid = os.fork()
    if pid == 0:
        os.dup2(errors.fileno(), 2)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        status = 99
        try:
            prepare(job)
            status = cli.main(job['arguments'])
            sys.stderr.flush()
        finally:
            os._exit(status)
    return pid, errors


def finish(pid, errors):
    """Wait for a process; return its exit status and what it wrote as errors."""
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    with errors:
        errors.seek(0)
        return status, errors.read().decode()


def prepare(job):
    """Arrange for what the job wants to happen."""
    if job['file_size']:
        resource.setrlimit(resource.RLIMIT_FSIZE, (job['file_size'],) * 2)
    if job['signal']:
        number = getattr(signal, job['signal'])
        at(job['phase'], lambda: os.kill(os.getpid(), number))


def at(phase, act):
    """Have act() called when a replay gets to *phase*."""
    if phase.startswith('writing '):    # the content is there, its name not yet
        part = f'.{phase.removeprefix("writing ")}.'
        before(files, '_sync', act, lambda path: part in str(path))
    else:
        owner, name, calls = {
            'opening': (replay, 'start_map', 1),
            'integrating': (replay.Replay, '_integrate', 6),
            'refining': (replay.Replay, '_refine', 1),
            'naming': (writer.RecordingWriter, 'text', 1),       # of the legend
            'rendering': (rendering.Renderer, 'render', 6),
            'recording': (refined.RefinedWriter, 'frame', 6),       # in another thread
            'closing': (writer.RecordingWriter, '_move', 1),
            'finishing': (timing, 'content', 1),
            'handing over': (store.shutil, 'copyfile', 2)}[phase]     # of an attached map
        count = []
        before(owner, name, act, lambda *_: count.append(1) or len(count) == calls)


def before(owner, name, act, when):
    """Have act() called before owner.name, where when(*arguments) says so."""
    original = getattr(owner, name)

    def acting(*arguments, **options):
        if when(*arguments):
            act()
        return original(*arguments, **options)

    setattr(owner, name, acting)


if __name__ == '__main__':
    main()
