"""The example of the documentation runs, is short, and does what it promises."""

from pathlib import Path
import re
import runpy

import numpy as np

QUICKSTART = Path(__file__).resolve().parents[2] / 'examples' / 'quickstart.py'


def test_labels_become_better(capsys):
    found = runpy.run_path(str(QUICKSTART))
    assert found['refined'].shape == found['labels'].shape
    before, after = (np.mean(found[name] == found['truth']) for name in ('labels', 'refined'))
    assert before < 0.8 and after > 0.95
    printed = re.search(r'before: ([\d.]+)%, after: ([\d.]+)%', capsys.readouterr().out)
    assert [float(text) for text in printed.groups()] == [round(100 * before, 1),
                                                          round(100 * after, 1)]


def test_it_stays_short():
    lines = QUICKSTART.read_text().splitlines()
    assert sum(bool(line.strip()) for line in lines) <= 30
