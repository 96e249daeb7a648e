"""Confidence images that cannot be used, or of which nothing is left: said before mapping."""

from contextlib import closing

import bags
import numpy as np
from persem_ros.errors import PersemError
from persem_ros.preflight.look import opened
from persem_ros.settings.config import Config, updated
import pytest


def looked(path, **values):
    """Open a recording; dots in names are double underscores."""
    with closing(opened(path, updated(
            Config(), {k.replace('__', '.'): v for k, v in values.items()}))):
        pass


def written(path, shape=(12, 16), value=0.5, encoding='32FC1', late=0):
    """Write frames and a confidence image of one value beside each."""
    def extra(out):
        dtype = np.uint8 if encoding == 'mono8' else np.float32
        for i in range(5):
            out.image('trust', bags.stamp(i) + late, 'camera', np.full(shape, value, dtype),
                      encoding)
    return bags.write(path, extra=extra)


@pytest.mark.parametrize('made, settings, said', [
    ({'shape': (6, 8)}, {'confidence': 'trust'}, 'the size 8 x 6, the labels have 16 x 12'),
    ({'shape': (6, 12)}, {'depth_confidence': 'trust'}, 'expected one aspect ratio'),
    ({'late': 50_000_000}, {'confidence': 'trust'}, 'the nearest is 50 ms away'),
    ({'encoding': '32FC1', 'value': 3.0}, {'depth_confidence': 'trust', 'least': 50.0},
     '--set depth.min_confidence=-50 where large is bad')])
def test_they_are_refused(tmp_path, made, settings, said):
    values = {f'topics__{k}' if k != 'least' else 'depth__min_confidence': v
              for k, v in settings.items()}
    with pytest.raises(PersemError, match=said):
        looked(written(tmp_path / 'bag', **made), **values)


def test_what_has_no_effect_is_said(tmp_path, caplog):
    path = written(tmp_path / 'bag', value=70.0)
    looked(path, topics__confidence='trust')
    assert 'are above 1 and count as 1' in caplog.text
    caplog.clear()
    looked(path, topics__depth_confidence='trust')
    assert '--set depth.min_confidence=N leaves out what is below N' in caplog.text
    caplog.clear()
    looked(path, depth__min_confidence=50.0)
    assert '--set topics.depth_confidence=TOPIC' in caplog.text
