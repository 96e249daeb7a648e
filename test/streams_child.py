"""
Every command of persem with streams that are closed, narrow, full or without a reader.

Reads {"commands": {name: arguments}, "todo": [[name, kind]], "folder": path} as JSON from standard
input, '{}' in an argument standing for a folder of its own; writes
[[name, kind, status, output, errors, files]].
The processes are forks of one that has loaded everything, with streams as Python opens them.

"""

from contextlib import redirect_stderr, redirect_stdout
import gc
import json
import os
from pathlib import Path
import sys
import tempfile

from persem_ros import cli
import quick_yaml

OUT, ERRORS = 1, 2
os.fsync = lambda handle: None      # as in conftest.py
quick_yaml.use(quick_yaml.Yaml)


def main():
    """Run each command under each kind, two at a time."""
    given, results = json.load(sys.stdin), []
    folder = Path(tempfile.mkdtemp(dir=given['folder']))
    rehearse(given['commands'], folder / 'rehearsal')
    todo = given['todo']
    for i in range(0, len(todo), 2):
        begun = [start(given['commands'][name], kind, folder / f'{name}-{kind}')
                 for name, kind in todo[i:i + 2]]
        results += [[name, kind, *finish(*one)] for (name, kind), one in zip(todo[i:], begun)]
    json.dump(results, sys.stdout)


def rehearse(commands, folder):
    """Run each command once, so that all is loaded."""
    folder.mkdir()
    with open(os.devnull, 'w') as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        for arguments in commands.values():
            cli.main([word.replace('{}', str(folder)) for word in arguments])
    gc.freeze()


def start(arguments, kind, folder):
    """Fork a process; return its number, where its streams go, and its folder."""
    folder.mkdir()
    out, errors = tempfile.TemporaryFile(), tempfile.TemporaryFile()
    pid = os.fork()
    if pid == 0:
        status = 99
        try:
            os.dup2(out.fileno(), OUT)
            os.dup2(errors.fileno(), ERRORS)
            begin(kind)
            sys.argv = ['persem', *(word.replace('{}', str(folder)) for word in arguments)]
            cli.main()
        finally:
            os._exit(status)
    return pid, out, errors, folder


def begin(kind):
    """Make the streams of this process what *kind* says, as Python would find them."""
    if kind == 'closed':
        for handle in (0, OUT, ERRORS):
            os.close(handle)
    for name, handle in (('out', OUT), ('errors', ERRORS)):
        if kind == f'{name} without a reader':
            read, write = os.pipe()
            os.dup2(write, handle)
            os.close(read)
        elif kind == f'{name} on a full disk':
            os.dup2(os.open('/dev/full', os.O_WRONLY), handle)
    encoding = 'ascii' if kind == 'ascii' else 'utf-8'
    sys.stdin = opened(0, 'r', encoding, 'strict')
    sys.stdout = opened(OUT, 'w', encoding, 'strict')
    sys.stderr = opened(ERRORS, 'w', encoding, 'backslashreplace')


def opened(handle, mode, encoding, errors):
    """Return a stream of a handle, None where it is closed."""
    try:
        os.fstat(handle)
    except OSError:
        return None
    return open(handle, mode, encoding=encoding, errors=errors, closefd=False)


def finish(pid, out, errors, folder):
    """Wait for a process; return its status, what it wrote, and the files that it left."""
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    texts = []
    for file in (out, errors):
        with file:
            file.seek(0)
            texts.append(file.read().decode('utf-8', 'replace'))
    return status, *texts, sorted(path.name for path in folder.iterdir())


if __name__ == '__main__':
    main()
