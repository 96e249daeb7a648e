"""The night of benchmarks/night.py in small: killed in the second session, moved at the end."""

import importlib.util
from pathlib import Path

import bags
import cv2
from persem_ros.core.transforms import quaternions
from persem_ros.errors import PersemError
import pytest
import worlds

SCRIPT = Path(__file__).resolve().parents[1] / 'benchmarks' / 'night.py'


@pytest.fixture
def night(monkeypatch):
    """Return the script as a module."""
    monkeypatch.syspath_prepend(SCRIPT.parent)
    spec = importlib.util.spec_from_file_location('night', SCRIPT)
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def test_a_night_in_small(night, tmp_path, capsys):
    legend = '{classes: [{id: 1, name: pole}, {id: 3, name: road}, {id: 7, name: roof}]}'
    recordings = [worlds.write(tmp_path / f'r{k}', 6, k, legend=legend) for k in range(3)]
    rows = [(bags.stamp(i) / 1e9, bags.pose(i)) for i in range(6)]
    path = tmp_path / 'path.tum'
    path.write_text(''.join(
        f'{at:.9f} {" ".join(map(str, T[:3, 3] + (0, 0, 0.6)))} '
        f'{" ".join(map(str, quaternions(T[None, :3, :3])[0]))}\n' for at, T in rows))
    steps = night.night(recordings, path, tmp_path / 'night')
    said = capsys.readouterr().out
    assert 'the same voxels and labels as without a bound' in said
    assert 'the second session ended with status -9' in said
    assert '6 of 6 frames of session 2 moved, by up to 0.6 m' in said
    info = list(steps.values())
    assert info[0] == info[1] and '2 sessions' in info[2] and '3 sessions' in info[4]
    assert cv2.imread(str(tmp_path / 'night' / 'night.png')) is not None


def test_a_node_where_there_is_no_ros(night, tmp_path, monkeypatch):
    monkeypatch.setattr('sys.argv', ['night.py', str(tmp_path), '--node'])
    monkeypatch.setenv('PATH', str(tmp_path))
    with pytest.raises(PersemError, match='--node needs ROS 2: make night-live '):
        night.main()
    ros2 = tmp_path / 'ros2'        # without this package
    ros2.write_text('#!/bin/sh\nexit 1\n')
    ros2.chmod(0o700)
    with pytest.raises(PersemError, match='finds no persem_ros in ROS: make night-live builds'):
        night.main()
    assert sorted(tmp_path.iterdir()) == [ros2]
