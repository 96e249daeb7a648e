"""Ctrl-C and SIGTERM at any moment: at once, with status and without a traceback."""

import os
import signal
import time

import pytest


RUN = ['ros2', 'run', 'persem_ros', 'mapper']


def fresh(ros, tmp_path):
    """Let the node compile its kernels anew."""
    ros.env = {**ros.env, 'NUMBA_CACHE_DIR': str(tmp_path / 'kernels')}


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_while_kernels_compile(ros, tmp_path, number):
    fresh(ros, tmp_path)
    mapper = ros.mapper({'map.path': str(tmp_path / 'map.persem'), 'map.save': True})
    mapper.says('listening to')
    time.sleep(0.5)
    mapper.signal(number)
    assert mapper.wait() == 0
    kernels = tmp_path / 'kernels'
    assert list(kernels.glob('kernels-*')) and not list(kernels.glob('*/complete'))     # not all
    assert 'Traceback' not in mapper.output and 'ready' not in mapper.output


@pytest.mark.parametrize('delay', [0.3, 0.8, 1.5])
def test_while_it_starts(ros, delay):
    mapper = ros.mapper(start=RUN)
    time.sleep(delay)
    mapper.signal(signal.SIGINT)
    mapper.wait()
    # `ros2 run` itself may be interrupted before it has started the node, and Python before ours.
    assert 'persem_ros/ros/' not in mapper.output, mapper.output


def test_ros2_run_passes_ctrl_c_on(ros):
    mapper = ros.mapper(start=RUN).ready()
    assert mapper.stop() == 0, mapper.output
    assert 'Traceback' not in mapper.output


def test_with_the_signal_of_a_closed_terminal(ros):
    mapper = ros.mapper().ready()
    mapper.signal(signal.SIGHUP)
    mapper.wait()
    assert 'Traceback' not in mapper.output


def test_a_dependency_that_is_missing_is_one_sentence(ros, tmp_path):
    (tmp_path / 'broken' / 'numba').mkdir(parents=True)
    (tmp_path / 'broken' / 'numba' / '__init__.py').write_text(
        "raise ModuleNotFoundError(\"No module named 'numba'\", name='numba')\n")
    path = f'{tmp_path / "broken"}{os.pathsep}{ros.env.get("PYTHONPATH", "")}'
    ros.env = {**ros.env, 'PYTHONPATH': path}
    mapper = ros.mapper()
    assert mapper.wait() == 1
    assert 'the Python package numba is missing' in mapper.output
    assert 'pip install "numpy<2" numba rosbags' in mapper.output
    assert 'Traceback' not in mapper.output
