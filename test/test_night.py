"""The night of benchmarks/night.py in small: killed in the second session, moved at the end."""

import importlib.util
from pathlib import Path

import bags
import cv2
from persem_ros.core.transforms import quaternions
import worlds

SCRIPT = Path(__file__).resolve().parents[1] / 'benchmarks' / 'night.py'


def test_a_night_in_small(tmp_path, capsys):
    spec = importlib.util.spec_from_file_location('night', SCRIPT)
    night = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(night)
    legend = '{classes: [{id: 1, name: pole}, {id: 3, name: road}, {id: 7, name: roof}]}'
    recordings = [worlds.write(tmp_path / f'r{k}', 6, k, legend=legend) for k in range(3)]
    rows = [(bags.stamp(i) / 1e9, bags.pose(i)) for i in range(6)]
    path = tmp_path / 'path.tum'
    path.write_text(''.join(
        f'{at:.9f} {" ".join(map(str, T[:3, 3] + (0, 0, 0.6)))} '
        f'{" ".join(map(str, quaternions(T[None, :3, :3])[0]))}\n' for at, T in rows))
    steps = night.night(recordings, path, tmp_path / 'night')
    said = capsys.readouterr().out
    assert 'the second session ended with status -9' in said
    assert '6 of 6 frames of session 2 moved, by up to 0.6 m' in said
    info = list(steps.values())
    assert info[0] == info[1] and '2 sessions' in info[2] and '3 sessions' in info[4]
    assert cv2.imread(str(tmp_path / 'night' / 'night.png')) is not None
