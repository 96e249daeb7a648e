"""
Ctrl-C and SIGTERM at any moment, imports and the interpreter's exit included: 130, no traceback.

Moments are counted in audit events (imports, opened files, started threads, …) rather than in
seconds, so that a run is like the next. A few moments here; `make signals` tries 200 of each.

"""

import json
import os
from pathlib import Path
import subprocess
import sys

import bags
import pytest

ROOT = Path(__file__).resolve().parents[2]
MANY = int(os.environ.get('PERSEM_SIGNALS', '0'))
# Runs persem and sends signals when the numbered audit events come; in the end writes how many
# there were. Child processes are not sent any.
CHILD = """
import os, sys
import signal as _      # of Python itself, so that events are counted from persem's own on
events, number, me, count = set(map(int, sys.argv[1].split(','))), int(sys.argv[2]), os.getpid(), 0
def hook(event, args):
    global count
    if event in ('import', 'open', 'os.rename', 'os.mkdir', 'os.remove', '_thread.start_new_thread'
                 ) and os.getpid() == me:
        count += 1
        if count in events:
            os.kill(me, number)
out, sys.argv = sys.argv[3], ['persem', *sys.argv[4:]]
from persem_ros import cli, ending
leave = ending.leave
def counted(status):
    with open(out, 'w') as file:
        file.write(str(count))
    leave(status)
ending.leave = counted
sys.addaudithook(hook)
cli.main()
"""


def run(arguments, events, number=2, tmp='/dev/null'):
    """Return (status, standard error) of persem when signals come at some events."""
    done = subprocess.run(
        [sys.executable, '-c', CHILD, ','.join(map(str, events)), str(number), str(tmp),
         *map(str, arguments)], cwd=ROOT, capture_output=True, text=True, timeout=300)
    return done.returncode, done.stderr


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Return the path of a small recording."""
    return bags.write(tmp_path_factory.mktemp('signals') / 'bag', 2)


def moments(n, few):
    """Return numbers 1 .. n, *few* or PERSEM_SIGNALS of them, spread evenly."""
    most = MANY or few
    return sorted({1 + k * (n - 1) // max(1, most - 1) for k in range(min(n, most))})


def interrupted(found):
    """Return those of {moment: (status, errors)} that are not a clean end by the signal."""
    return {at: one for at, one in found.items()
            if one[0] != 130 or one[1] not in ('persem: interrupted\n', '')}


@pytest.mark.parametrize(('number', 'few'), [(2, 4), (15, 1)])
def test_of_a_command_at_any_moment(bag, tmp_path, number, few):
    status, errors = run(['info', bag], [0], number, tmp_path / 'count')
    assert (status, errors) == (0, '')
    count = json.loads((tmp_path / 'count').read_text())
    assert count > 100
    assert interrupted({at: run(['info', bag], [at], number)
                        for at in moments(count - 1, few)}) == {}


def test_twice_is_not_worse_than_once(bag):
    assert interrupted({at: run(['info', bag], [at, at + 1, at + 30])
                        for at in moments(300, 2)}) == {}


def test_of_a_replay_at_any_moment(bag, tmp_path):
    out = tmp_path / 'out'
    arguments = ['replay', bag, '--out', out, '--set', 'memory.voxel_size=2']
    found = {}
    for at in (moments(2000, MANY) if MANY else (1000,)):
        found[at] = run(arguments, [at])
        if found[at][0] == 0:           # that many moments there are not
            del found[at]
            break
        assert not out.exists(), at
    assert found and interrupted(found) == {}


def test_the_command_line_handles_signals_before_it_imports_anything():
    code = """
import signal, sys
sys.argv = ['persem']
before = set(sys.modules)
handle = signal.signal
def first(*args):
    print(*sorted(set(sys.modules) - before))
    raise SystemExit
signal.signal = first
from persem_ros import cli
"""
    new = subprocess.run([sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True)
    # Where the installation is editable, its finder has imported __future__ before us.
    assert set(new.stdout.split()) - {'__future__'} == {'persem_ros', 'persem_ros.cli',
                                                        'persem_ros.ending'}


def ended(code):
    """Return (status, output) of what a process does with the node's Ending."""
    head = ('import os, signal, sys\n'
            'from persem_ros.ending import leave_deaf\n'
            'from persem_ros.ros.ending import Ending\n'
            'def ask(): os.kill(os.getpid(), signal.SIGTERM)\n')
    done = subprocess.run([sys.executable, '-c', head + code], cwd=ROOT, capture_output=True,
                          text=True, timeout=60)
    assert done.stderr == ''
    return done.returncode, done.stdout


def test_the_node_hears_a_signal_wherever_its_wait_is_interrupted():
    # at every line of all that is called wait, those of the standard library included
    assert ended('ending = Ending()\n'
                 'ending.patient = True\n'
                 'def trace(frame, event, arg):\n'
                 "    if event == 'line' and frame.f_code.co_name == 'wait': ask()\n"
                 '    return trace\n'
                 'sys.settrace(trace)\n'
                 'ending.wait()\n'
                 'sys.settrace(None)\n'
                 'print(ending.wanted)\n') == (0, 'True\n')


def test_the_node_leaves_at_once_before_it_has_begun_and_hears_nothing_when_it_is_over():
    assert ended('Ending(begun=False)\nask()\nprint(1)') == (130, '')
    assert ended('import atexit\nending = Ending()\natexit.register(ask)\nending.over()\nask()\n'
                 'leave_deaf(3)') == (3, '')


def test_the_node_hears_a_signal_that_does_not_interrupt_its_wait():
    # as one does that comes while the main thread waits for the interpreter's lock
    assert ended('import threading, time\n'
                 'ending = Ending()\n'
                 'ending.patient = True\n'
                 'def strike():\n'
                 '    time.sleep(0.2)\n'
                 '    signal.pthread_kill(threading.get_ident(), signal.SIGINT)\n'
                 'threading.Thread(target=strike).start()\n'
                 'ending.wait()\n'
                 'print(ending.wanted)\n') == (0, 'True\n')
