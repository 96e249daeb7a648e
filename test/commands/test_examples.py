"""The examples run, each in a process of its own as a user starts it, and keep their promise."""

from pathlib import Path
import re
import subprocess
import sys

import pytest

EXAMPLES = Path(__file__).resolve().parents[2] / 'examples'


def said(name, folder, *arguments):
    """Run an example somewhere else; return what it printed."""
    done = subprocess.run([sys.executable, EXAMPLES / name, *arguments], text=True,
                          capture_output=True, cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_look_into_a_map(tmp_path):
    text = said('look_into_a_map.py', tmp_path)
    assert re.search(r"<map '.*map.persem': \d+ voxels of 0.2 m in 'map', 20 frames>", text)
    for words in ('class 1 ', 'most uncertain: ', ' s, from [', '\nwhy\n', 'in the lower corner'):
        assert words in text
    assert not list(tmp_path.iterdir())


def test_segmenter_in_the_loop(tmp_path):
    for name in ('onnx', 'onnxruntime'):
        pytest.importorskip(name, reason='the example runs a network with ONNX Runtime')
    text = said('segmenter_in_the_loop.py', tmp_path)
    before, after = map(float, re.findall(r'([\d.]+)%', text))
    assert before < 95 and after > before + 5


def test_every_example_is_run_here():
    tested = ''.join(Path(__file__).with_name(name).read_text()
                     for name in ('test_examples.py', 'test_quickstart.py'))
    assert [path.name for path in EXAMPLES.glob('*.py') if path.name not in tested] == []
