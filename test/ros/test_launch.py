"""The launch file: the node with its topics, and a recording that it plays."""

import subprocess

import bags
from harness import ended, until
from persem_ros.outputs.map import store

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
