"""The launch file: the node with its topics, and a recording that it plays."""

from pathlib import Path
import subprocess
import time

import bags
from harness import ended, until
from persem_ros.outputs.map import store
import pytest

FRAMES = 10


def test_launch_file_maps_a_recording(ros, tmp_path):
    path = bags.write(tmp_path / 'bag', FRAMES)
    saved = tmp_path / 'map.persem'
    launch = ros.run('ros2', 'launch', 'persem_ros', 'mapper.launch.py', f'bag:={path}',
                     'voxel_size:=0.1', f'map_path:={saved}', 'namespace:=robot',
                     'labels:=/semantic/image', 'depth:=/depth/image', 'pose:=/pose',
                     'camera_info:=/depth/camera_info', 'rate:=2.0')
    with ended(launch):
        # Best effort, as by default: a busy machine may lose some of ten frames.
        until(lambda: frames(ros) >= FRAMES // 2, lambda: launch.output)
        response = ros.client.call('/robot/mapper/save_map')
        assert response.success, response.message
    assert len(store.load(saved).saved.cell) > 100


def test_without_rviz_no_node_is_left_behind(workspace):
    if not subprocess.run(['ros2', 'pkg', 'prefix', 'rviz2'], env=workspace,
                          capture_output=True, timeout=60).returncode:
        pytest.skip('RViz is installed here')
    done = subprocess.run(['ros2', 'launch', 'persem_ros', 'mapper.launch.py', 'rviz:=true',
                           'namespace:=orphan'], env=workspace, capture_output=True, text=True,
                          timeout=120)
    assert done.returncode and "package 'rviz2' not found" in done.stdout + done.stderr
    time.sleep(1.0)
    assert not any(b'__ns:=/orphan' in words for words in map(_words, Path('/proc').iterdir()))


def _words(process):
    try:
        return (process / 'cmdline').read_bytes()
    except OSError:
        return b''


def test_its_arguments_are_explained(workspace):
    shown = subprocess.run(['ros2', 'launch', 'persem_ros', 'mapper.launch.py', '--show-args'],
                           env=workspace, capture_output=True, text=True, timeout=120).stdout
    for name in ('config', 'bag', 'rviz', 'labels', 'depth', 'pose', 'voxel_size', 'loop'):
        assert f"'{name}':" in shown


def frames(ros):
    """Return the number of frames that the node says it has integrated."""
    values = {v.key: v.value for array in ros.diagnostics[-1:] for status in array.status
              for v in status.values}
    return int(values.get('frames', 0))
