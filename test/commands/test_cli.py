"""The command line: status, one line for what goes wrong, speed of --help."""

import os
from pathlib import Path
import signal
import subprocess
import sys

import persem_ros
from persem_ros import cli
from persem_ros.commands import config as some_command
from persem_ros.errors import PersemError
import pytest

ROOT = Path(__file__).parents[2]


def persem(*arguments, **options):
    """Run the command in a process of its own."""
    return subprocess.run([sys.executable, '-m', 'persem_ros', *arguments], cwd=ROOT, text=True,
                          capture_output=True, timeout=60, **options)


@pytest.fixture
def failing(monkeypatch):
    """Return a function that makes a sub-command raise."""
    def failing(error):
        def run(args):
            raise error
        monkeypatch.setattr(some_command, 'run', run)
    return failing


def test_help_names_every_command():
    result = persem('--help')
    assert result.returncode == 0
    assert all(name in result.stdout for name in cli.COMMANDS)


def test_help_imports_nothing_heavy():
    heavy = ('numpy', 'numba', 'cv2', 'rosbags', 'tqdm', 'yaml')
    code = ('import sys; from persem_ros.cli import main; main(["--help"]); '
            f'print([m for m in {heavy} if m in sys.modules])')
    result = subprocess.run([sys.executable, '-c', code], cwd=ROOT, text=True,
                            capture_output=True)
    assert result.stdout.splitlines()[-1] == '[]'


def test_version(capsys):
    assert cli.main(['--version']) == 0
    assert capsys.readouterr().out.strip() == f'persem_ros {persem_ros.__version__}'


@pytest.mark.parametrize('arguments', [[], ['no_such_command'], ['config', '--no-such-option'],
                                       ['map'], ['map', 'info']])
def test_usage_is_2(arguments, capsys):
    assert cli.main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == '' and 'usage: persem' in err


@pytest.mark.parametrize('arguments, hint', [
    ('replay --voxel-size 0.05 bag --out x', '; did you mean --set memory.voxel_size=0.05?'),
    ('replay bag --out x --voxel_size=2', '; did you mean --set memory.voxel_size=2?'),
    ('replay bag --refine.eta 0.1 --out x', '; did you mean --set refine.eta=0.1?'),
    ('replay bag --rectified --out x', '; did you mean --set camera.rectified=VALUE?'),
    ('sweep bag --out x --vary a=1 --max-voxels 5',
     '; did you mean --set memory.max_voxels=5 or --set map.max_voxels=5?'),
    ('replay bag --out x --set memory.voxel_size 0.2',
     ' 0.2; did you mean --set memory.voxel_size=0.2?'),
    ('replay bag --out x --no-such 5', 'arguments: --no-such 5'),
    ('map info file --voxel-size 5', 'arguments: --voxel-size 5'),      # it has no --set
    ('replay bag --method geometry --out x',
     '; did you mean --set refine.method=geometry (the map '
     'and the pictures) or --methods geometry (rows of the table)?'),
    ('evaluate bag --method=trust', '; did you mean --set refine.method=trust (the map and the '
     'pictures) or --methods trust (rows of the table)?'),
    ('build bag --method geometry --out x', '; did you mean --set refine.method=geometry (the map '
     'and the pictures)?'),
    ('replay bag --out x --forc', '; did you mean --force?'),
    ('repaly bag', ", did you mean 'replay'?"), ('map inof x', ", did you mean 'info'?")])
def test_slips_are_usage_and_the_right_word_is_named(capsys, arguments, hint):
    assert cli.main(arguments.split()) == 2
    assert capsys.readouterr().err.endswith(f'{hint}\n')


def test_refused_is_1_and_one_line(capsys):
    assert cli.main(['config', '--set', 'memory.voxel_size=0']) == 1
    out, err = capsys.readouterr()
    assert out == ''
    assert err.splitlines() == [
        'persem: --set memory.voxel_size: expected 0.001 to 1000.0 m, got 0.0']


@pytest.mark.parametrize(('error', 'words'), [
    (PersemError('two\nlines'), ['two lines']),
    (OSError(28, 'No space left on device', '/full/file'), ['/full/file: No space left']),
    (OSError('odd'), ['odd']),
    (MemoryError(), ['out of memory', 'memory.stride']),
    (ZeroDivisionError('of ours'), ['internal error (ZeroDivisionError: of ours)', 'report',
                                    '--debug'])])
def test_whatever_goes_wrong_is_one_line(failing, capsys, error, words):
    failing(error)
    assert cli.main(['config']) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    for word in words:
        assert word in lines[0]


@pytest.mark.parametrize('arguments', [['--debug', 'config'], ['config', '--debug']])
def test_debug_shows_the_traceback(failing, capsys, arguments):
    failing(PersemError('wrong'))
    assert cli.main(arguments) == 1
    err = capsys.readouterr().err
    assert 'Traceback' in err and err.splitlines()[-1] == 'persem: wrong'


def test_interrupted_is_130(failing, capsys):
    failing(KeyboardInterrupt())
    assert cli.main(['config']) == 130
    assert 'Traceback' not in capsys.readouterr().err


def test_interrupted_by_a_signal():
    code = ('import signal, time; from persem_ros import cli; from persem_ros.commands import '
            'config; config.run = lambda args: (print("up", flush=True), time.sleep(30)); '
            'raise SystemExit(cli.main(["config"]))')
    with subprocess.Popen([sys.executable, '-c', code], cwd=ROOT, text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout.readline() == 'up\n'
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 130
        assert process.stderr.read() == 'persem: interrupted\n'


def test_a_reader_that_goes_away():
    read, write = os.pipe()
    os.close(read)
    result = subprocess.run([sys.executable, '-m', 'persem_ros', 'config'], cwd=ROOT,
                            stdout=write, stderr=subprocess.PIPE, text=True)
    os.close(write)
    assert (result.returncode, result.stderr) == (141, '')


def test_log_records_go_to_standard_error(capsys, monkeypatch):
    import logging
    monkeypatch.setattr(some_command, 'run',
                        lambda args: logging.getLogger('persem_ros.x').warning('%d dropped', 3))
    assert cli.main(['config']) == 0
    out, err = capsys.readouterr()
    assert (out, err) == ('', 'persem: 3 dropped\n')
