"""Metrics against their plain definitions and against scikit-learn."""

import json

from hypothesis import given, settings as examples, strategies as st
import numpy as np
from persem_ros.core.refine.regions import REGIONS
from persem_ros.errors import PersemError
from persem_ros.outputs.results.metrics import Metrics, valid_pixels
import pytest

IDS = (0, 1, 7, 255, 65534)


def sequence(rng, frames=4, shape=(12, 15), ids=IDS):
    """Return random (valid, truth, prediction, regions) of some frames."""
    return [(rng.random(shape) < 0.8, rng.choice(ids, shape).astype(np.int32),
             rng.choice((*ids, -1, 9), shape).astype(np.int32),
             rng.integers(0, 8, shape).astype(np.uint8)) for _ in range(frames)]


def measured(frames, **options):
    metrics = Metrics(['m'], **options)
    for valid, truth, prediction, regions in frames:
        metrics.update(valid, {'m': prediction}, truth, regions)
    return metrics


def plain(frames, region=None):
    """Return accuracy, miou, flicker, truth flicker in percent, pixel by pixel."""
    inside = [valid & (regions & REGIONS[region] != 0 if region else True)
              for valid, _, _, regions in frames]
    t = np.concatenate([f[1][w] for f, w in zip(frames, inside)])
    p = np.concatenate([f[2][w] for f, w in zip(frames, inside)])
    iou = [100 * np.sum((t == c) & (p == c)) / np.sum((t == c) | (p == c)) for c in np.unique(t)]
    pairs, changed = 0, np.zeros(2)
    for before, now, here in zip(frames, frames[1:], inside[1:]):
        both = before[0] & here
        pairs += both.sum()
        changed += [np.sum(both & (before[k] != now[k])) for k in (2, 1)]
    return [100 * np.mean(t == p), np.mean(iou), *(100 * changed / pairs)]


def values(result):
    method = result['methods']['m']
    return [method['pixel_accuracy'], method['miou'], method['flicker'],
            result['truth_flicker']]


@examples(deadline=None, max_examples=30)
@given(st.integers(0, 2 ** 32 - 1))
def test_as_defined_pixel_by_pixel(seed):
    frames = sequence(np.random.default_rng(seed))
    result = measured(frames).result()
    assert values(result) == pytest.approx(plain(frames))
    for region in REGIONS:
        assert values(result['regions'][region]) == pytest.approx(plain(frames, region))


def test_parity_with_scikit_learn():
    import sklearn.metrics as sk
    frames = sequence(np.random.default_rng(1), 6, (60, 80), range(12))
    t = np.concatenate([truth[valid] for valid, truth, _, _ in frames])
    p = np.concatenate([labels[valid] for valid, _, labels, _ in frames])
    metrics = measured(frames)
    ids, matrix = metrics.confusion('m')
    p = np.where(p < 0, 65535, p)
    assert (ids == np.union1d(t, p)).all()
    assert (matrix == sk.confusion_matrix(t, p, labels=ids)).all()
    ours = metrics.result()['methods']['m']
    theirs = 100 * sk.jaccard_score(t, p, labels=np.unique(t), average=None)
    assert list(ours['iou'].values()) == pytest.approx(theirs.tolist())
    assert ours['miou'] == pytest.approx(theirs.mean())
    assert ours['pixel_accuracy'] == pytest.approx(100 * sk.accuracy_score(t, p))


def test_by_hand():
    truth = np.array([[1, 1, 2, 2]])
    first, second = np.array([[1, 2, 2, 3]]), np.array([[1, 1, 2, 3]])
    metrics = Metrics(['m'])
    for labels in (first, second):
        metrics.update(np.array([[True, True, True, True]]), {'m': labels}, truth)
    result = metrics.result()
    assert result['methods']['m'] == {
        'pixel_accuracy': 62.5, 'miou': pytest.approx((75 + 40) / 2), 'flicker': 25.0,
        'iou': {'1': 75.0, '2': 40.0}}       # 3 is not in the truth: no class of the mean
    assert result['truth_flicker'] == 0.0
    assert result['regions'] == {}


def test_many_pairs_of_ids():
    rng = np.random.default_rng(2)
    truth, labels = 300 * rng.integers(0, 200, (2, 200, 250))
    metrics = Metrics(['m'])
    for _ in range(2):
        metrics.update(np.ones((200, 250), bool), {'m': labels}, truth)
    ids, matrix = metrics.confusion('m')
    expected = np.zeros((200, 200), int)
    np.add.at(expected, (truth.ravel() // 300, labels.ravel() // 300), 2)
    assert (ids == 300 * np.arange(200)).all()
    assert (matrix == expected).all()
    assert metrics.result()['methods']['m']['flicker'] == 0.0


def test_ids_that_become_more():
    rng, frames = np.random.default_rng(4), []
    for most in (3, 13, 14, 30, 61, 62, 63, 300, 20):       # tables of pairs of 4, 5, 6 bits; none
        frames += sequence(rng, 2, (20, 30), (0, 1, most - 1, most, 65534 if most > 62 else 2))
    result = measured(frames).result()
    assert values(result) == pytest.approx(plain(frames))
    assert values(result['regions']['boundary']) == pytest.approx(plain(frames, 'boundary'))


def test_without_truth_only_flicker():
    frames = sequence(np.random.default_rng(3))
    metrics = Metrics(['m'])
    for valid, _, labels, _ in frames:
        metrics.update(valid, [('m', labels)])
    method = metrics.result()['methods']['m']
    assert method.pop('flicker') == pytest.approx(plain(frames)[2])
    assert method == {'pixel_accuracy': None, 'miou': None, 'iou': {}}


def test_nothing_is_null_not_nan():
    metrics = Metrics(['m'])
    metrics.update(np.zeros((3, 4), bool), {'m': np.zeros((3, 4), int)}, np.zeros((3, 4), int),
                   np.zeros((3, 4), np.uint8))
    text = json.dumps(metrics.result(), allow_nan=False)
    assert json.loads(text)['methods']['m']['pixel_accuracy'] is None
    assert json.loads(text)['regions']['boundary']['share'] is None


def test_flicker_is_per_sensor_and_starts_anew_with_another_size():
    metrics = Metrics(['m'])
    small, big = np.ones((2, 2), bool), np.ones((3, 3), bool)
    for sensor, label in (('a', 1), ('b', 2), ('a', 1), ('b', 3)):
        metrics.update(small, {'m': np.full((2, 2), label)}, sensor=sensor)
    assert metrics.result()['methods']['m']['flicker'] == 50.0
    metrics.update(big, {'m': np.full((3, 3), 9)}, sensor='a')
    assert metrics.result()['methods']['m']['flicker'] == 50.0


def test_taxonomy_before_counting():
    table = {1: 10, 2: 10, 3: 30}
    truth = np.array([[1, 2, 3, 4]])
    first, second = np.array([[2, 4, 3, 1]]), np.array([[1, 2, 4, 3]])
    metrics = Metrics(['m'], taxonomy=table)
    everywhere = np.ones((1, 4), bool)
    for labels in (first, second):
        metrics.update(everywhere, {'m': labels}, truth)
    result = metrics.result()['methods']['m']
    # the true 4 is outside the table: ignored; a predicted 4 is wrong
    assert result['pixel_accuracy'] == pytest.approx(100 * 4 / 6)
    assert result['iou'] == {'10': 75.0, '30': 50.0}
    assert result['flicker'] == pytest.approx(100 * 2 / 3)


def test_frames_without_truth_between():
    truth = np.array([[1, 2]])
    everywhere = np.ones((1, 2), bool)
    metrics = Metrics(['m'])
    metrics.update(everywhere, {'m': truth}, truth)
    metrics.update(everywhere, {'m': truth})
    metrics.update(everywhere, {'m': truth}, truth + 1)
    result = metrics.result()
    assert result['truth_flicker'] is None      # no two consecutive true images
    assert result['methods']['m']['flicker'] == 0.0
    assert result['methods']['m']['pixel_accuracy'] == 50.0


def test_valid_pixels():
    depth = np.array([[0.0, np.nan, np.inf, -1.0, 0.05, 1.0, 1.0, 1.0, 1.0, 1.0, 200.0, 200.1]])
    labels = np.array([[1, 1, 1, 1, 1, 1, 255, -1, 65535, 70000, 65534, 1]])
    truth = np.ones_like(labels)
    found = valid_pixels(labels, depth, (255, -1), 0.1, 200.0)
    assert np.flatnonzero(found).tolist() == [5, 10]
    truth[0, 10] = 255
    assert np.flatnonzero(valid_pixels(labels, depth, (255,), 0.1, 200.0, truth)).tolist() == [5]


def test_images_of_another_size_and_unknown_methods_are_refused():
    metrics = Metrics(['persem'])
    with pytest.raises(PersemError, match=r'shape \(2, 3\), expected \(3, 2\)'):
        metrics.update(np.ones((3, 2), bool), {'persem': np.ones((2, 3), int)})
    with pytest.raises(PersemError, match="unexpected method 'trust'"):
        metrics.update(np.ones((3, 2), bool), {'trust': np.ones((3, 2), int)})
    with pytest.raises(PersemError, match='taxonomy'):
        Metrics(['m'], taxonomy={1: 65535})


def test_flicker_counts_between_two_calls_are_the_frames_between_them():
    frames = sequence(np.random.default_rng(5), 6)
    metrics = measured(frames[:4])
    before = metrics.flicker_counts()
    for valid, truth, prediction, regions in frames[4:]:
        metrics.update(valid, {'m': prediction}, truth, regions)
    after = metrics.flicker_counts()
    for name, k in (('m', 2), ('truth', 1)):
        both = [a[0] & b[0] for a, b in zip(frames[3:], frames[4:])]
        changed = sum(np.sum(w & (a[k] != b[k]))
                      for w, a, b in zip(both, frames[3:], frames[4:]))
        assert tuple(np.subtract(after[name], before[name])) == (changed, np.sum(both))
