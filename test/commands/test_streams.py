"""Closed, narrow and broken streams: no traceback, and what was to be done is done."""

from contextlib import redirect_stdout
import io
import json
import os
from pathlib import Path
import subprocess
import sys

import bags
import core_worlds as cw
import cv2
import numpy as np
from persem_ros.cli import main
from persem_ros.outputs.map import store
from persem_ros.settings.config import Config
from persem_ros.settings.legend import Legend
import pytest

ROOT = Path(__file__).resolve().parents[2]
NARROW = {**os.environ, 'LC_ALL': 'C', 'PYTHONIOENCODING': 'ascii', 'PYTHONUTF8': '0',
          'PYTHONCOERCECLOCALE': '0'}
COMMANDS = ('config', 'info', 'map')


@pytest.fixture(scope='module')
def arguments(tmp_path_factory):
    """Return {command: arguments}, of files with names that are not ASCII."""
    folder = tmp_path_factory.mktemp('streams')
    memory = cw.core_of([(1, {(0, 0, 0): (1, 1.0)}, [])])
    store.save(folder / 'straße.persem', memory, Config(),
               Legend.from_yaml('classes:\n- {id: 1, name: "Straße\\e[2J"}\n'))
    bag = bags.write(folder / 'straße', 1)
    return {'config': ['config'], 'info': ['info', str(bag)],
            'map': ['map', 'info', str(folder / 'straße.persem')]}


def run(words, before='', **options):
    """Run persem by a shell that redirects its streams; return (status, output, errors)."""
    done = subprocess.run(['sh', '-c', f'"$0" -m persem_ros "$@" {before}', sys.executable,
                           *words], cwd=ROOT, capture_output=True, **options)
    return done.returncode, done.stdout, done.stderr.decode()


@pytest.mark.parametrize('command', COMMANDS)
def test_ascii_streams_in_the_locale_c(arguments, command):
    status, out, errors = run(arguments[command], env=NARROW)
    assert (status, errors) == (0, '')
    assert out.isascii() and b'\x1b' not in out
    assert command == 'config' or b'stra\\xdfe' in out or b'Stra\\xdfe' in out


@pytest.mark.parametrize('command', COMMANDS)
def test_streams_that_are_closed(arguments, command):
    assert run(arguments[command], '>&- 2>&- <&-') == (0, b'', '')


@pytest.mark.parametrize('command', ['info', 'map'])
def test_a_reader_that_has_gone(arguments, command):
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([sys.executable, '-m', 'persem_ros', *arguments[command]], cwd=ROOT,
                          stdout=write, stderr=subprocess.PIPE)
    os.close(write)
    assert (done.returncode, done.stderr) == (141, b'')


# What each command leaves in its folder '{}'; '' for those that only print.
ALL = {
    'config': (['config'], ''), 'info': (['info', 'BAG'], ''),
    'simulate': (['simulate', '{}/flight', '--frames', '1', '--size', '32x32'], 'flight'),
    'convert': (['convert', 'frames', 'FRAMES', '{}/bag', '--no-check'], 'bag'),
    'replay': (['replay', 'BAG', '--out', '{}/out', '--set=memory.voxel_size=2'], 'out'),
    'evaluate': (['evaluate', 'BAG', '--out', '{}/evaluated', '--workers', '1',
                  '--methods', 'raw2d,majority', '--set=memory.voxel_size=2'], 'evaluated'),
    'sweep': (['sweep', 'BAG', '--out', '{}/swept', '--vary', 'memory.stride=1,2', '--methods',
               'majority', '--set=memory.voxel_size=2'], 'swept'),
    'compare': (['compare', 'RESULT', 'RESULT'], ''),
    'map info': (['map', 'info', 'MAP'], ''),
    'map query': (['map', 'query', 'MAP', '0.1', '0.1', '0.1'], ''),
    'map export': (['map', 'export', 'MAP', '--ply', '{}/map.ply', '--npz', '{}/map.npz'],
                   'map.ply'),
    'map merge': (['map', 'merge', 'MAP', 'OTHER', '--out', '{}/both.persem'], 'both.persem'),
    'map georeference': (['map', 'georeference', 'MAP'], ''),
    'help': (['--help'],), 'refused': (['map', 'info', '{}/straße'],), 'usage': (['replay'],)}
KINDS = ('closed', 'ascii', 'out without a reader', 'out on a full disk',
         'errors without a reader', 'errors on a full disk')
# Seconds each: `make signals` tries them, too.
SLOW = ('simulate', 'evaluate', 'sweep')
LONG = bool(int(os.environ.get('PERSEM_SIGNALS', '0')))
TODO = [(command, kind) for command in ALL for kind in KINDS if LONG or command not in SLOW]
STATUS = {'out without a reader': 141, 'out on a full disk': 1}
SAYS = {'help': 0, 'refused': 1, 'usage': 2}       # whatever becomes of it


@pytest.fixture(scope='module')
def ran(arguments, tmp_path_factory):
    """Return {(command, kind): [status, output, errors, files]}."""
    folder = tmp_path_factory.mktemp('straße')
    frames, result = folder / 'frames', folder / 'result'
    places = {'BAG': arguments['info'][1], 'MAP': arguments['map'][2], 'FRAMES': str(frames),
              'OTHER': str(folder / 'other.persem'), 'RESULT': str(result)}
    memory = cw.core_of([(2, {(0, 0, 0): (1, 1.0)}, [])])
    store.save(places['OTHER'], memory, Config(),
               Legend.from_yaml('classes:\n- {id: 1, name: "Straße\\e[2J"}\n'))
    seven_scenes(frames)
    with redirect_stdout(io.StringIO()):
        assert main(['replay', places['BAG'], '--out', str(result),
                     '--set=memory.voxel_size=2']) == 0
    commands = {name: [places.get(word, word) for word in words]
                for name, (words, *_) in ALL.items() if LONG or name not in SLOW}
    done = subprocess.run([sys.executable, str(ROOT / 'test' / 'streams_child.py')], cwd=ROOT,
                          input=json.dumps({'commands': commands, 'todo': TODO,
                                            'folder': str(folder)}),
                          capture_output=True, text=True, timeout=300,
                          env={**os.environ, 'PYTHONPATH': str(ROOT), 'PERSEM_THREADS': '1'})
    assert done.returncode == 0, done.stderr
    return {(name, kind): rest for name, kind, *rest in json.loads(done.stdout)}


def seven_scenes(folder):
    """Write one frame as 7-Scenes has it."""
    folder.mkdir()
    cv2.imwrite(str(folder / 'frame-000000.depth.png'), np.full((6, 8), 2000, np.uint16))
    cv2.imwrite(str(folder / 'frame-000000.label.png'), np.ones((6, 8), np.uint8))
    np.savetxt(folder / 'frame-000000.pose.txt', np.eye(4))
    (folder / 'intrinsics.txt').write_text('8 8 3.5 2.5\n')


@pytest.mark.parametrize(('command', 'kind'), TODO)
def test_no_stream_costs_a_run_or_gives_a_traceback(ran, command, kind):
    status, out, errors, files = ran[command, kind]
    assert 'Traceback' not in errors and 'internal error' not in errors, errors
    assert '\x1b' not in out + errors
    if command in SAYS:
        assert status == SAYS[command]
    else:
        assert status == STATUS.get(kind, 0), errors
        assert ALL[command][1] in ['', *files]
    if kind == 'ascii':
        assert (out + errors).isascii()


def test_no_run_is_lost_for_want_of_a_reader(arguments, tmp_path):
    out = tmp_path / 'out'
    status, _, errors = run(['replay', arguments['info'][1], '--out', str(out),
                             '--set=memory.voxel_size=2'], '>&-', env=NARROW)
    assert (status, 'Traceback' in errors) == (0, False)
    assert (out / 'report.html').exists()
