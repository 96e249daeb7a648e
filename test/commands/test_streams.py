"""Closed, narrow and broken streams: no traceback, and what was to be done is done."""

import os
from pathlib import Path
import subprocess
import sys

import bags
import core_worlds as cw
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


def test_no_run_is_lost_for_want_of_a_reader(arguments, tmp_path):
    out = tmp_path / 'out'
    status, _, errors = run(['replay', arguments['info'][1], '--out', str(out),
                             '--set=memory.voxel_size=2'], '>&-', env=NARROW)
    assert (status, 'Traceback' in errors) == (0, False)
    assert (out / 'report.html').exists()
