"""Stamps: labels stamped late, zero stamps, clocks apart, slow poses; the distances are said."""

from contextlib import closing
import re

import bags
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.cli import main
from persem_ros.errors import PersemError
from persem_ros.inputs.recording.excerpt import Excerpt
from persem_ros.outputs.recording.writer import RecordingWriter
from persem_ros.preflight.lag import distances, lags, lost
from persem_ros.preflight.look import opened
from persem_ros.settings.config import Config, updated
import pytest

MS = 1_000_000


def written(path, labels=lambda i: bags.stamp(i), depth=lambda i: bags.stamp(i),
            pose=lambda i: bags.stamp(i - 0.5), n=20, every=1, poses_every=1,
            there=lambda i: True):
    """Write *n* frames, with depth where it is *there*; the functions give stamps in ns."""
    with RecordingWriter(path) as out:
        for i in range(n):
            out.camera_info('depth/camera_info', depth(i), 'camera', bags.WIDTH, bags.HEIGHT,
                            bags.K)
            if there(i):
                out.image('depth/image', depth(i), 'camera', bags.depth(i), '32FC1')
            if i % every == 0:
                out.image('semantic/image', labels(i), 'camera', bags.labels(i), 'mono16')
        for i in range(0, n + 2, poses_every):
            out.pose('pose', pose(i), 'map', bags.pose(i - 0.5))
    return path


def looked(path, **values):
    config = updated(Config(), {k.replace('__', '.'): v for k, v in values.items()})
    with closing(opened(path, config)) as recording:
        return list(recording.frames()), recording


def refusal(path, **values):
    with pytest.raises(PersemError) as refused:
        looked(path, **values)
    return str(refused.value)


def late(i):
    """Return the stamp of labels that come 150 to 190 ms after their image."""
    return bags.stamp(i) + (150 + 10 * (i % 5)) * MS


def test_labels_stamped_late_are_refused_and_the_printed_flag_maps_them(tmp_path):
    path = written(tmp_path / 'bag', late)
    text = refusal(path)
    assert '--set sync.offset_labels=-0.170' in text and 'median' in text
    assert 'sync.tolerance (20 ms)' in text
    frames, _ = looked(path, sync__offset_labels=-0.17)
    assert len(frames) == 20
    assert all(abs(f.stamp - bags.stamp(i)) <= 20 * MS for i, f in enumerate(frames))


def test_a_lag_that_brings_all_labels_near_a_later_depth_is_said(tmp_path, caplog):
    path = written(tmp_path / 'bag', lambda i: bags.stamp(i) + 190 * MS)
    looked(path)
    assert '--set sync.offset_labels=-0.190' in caplog.text


def test_jitter_beyond_the_tolerance_needs_both_settings(tmp_path):
    text = refusal(written(tmp_path / 'bag', lambda i: bags.stamp(i)
                           + (300 + 10 * (3 * i % 8)) * MS, n=40))
    assert 'sync.offset_labels=-0.3' in text and 'sync.tolerance=0.0' in text


@pytest.mark.parametrize('options', [
    {}, {'every': 3}, {'labels': lambda i: bags.stamp(i) + 3 * MS},
    {'labels': lambda i: bags.stamp(i) + (7 * i % 15 - 7) * MS}])
def test_stamps_that_fit_are_not_spoken_of(tmp_path, caplog, options):
    written(tmp_path / 'bag', **options)
    looked(tmp_path / 'bag')
    assert not caplog.text


def test_a_lag_that_is_ambiguous_by_the_period_of_depth_is_said_so(tmp_path, caplog):
    path = written(tmp_path / 'bag', lambda i: bags.stamp(i) + 440 * MS, every=3, n=60)
    text = refusal(path)
    assert re.search(r'sync.offset_labels=-0\.\d40 or whole periods of the depth \(100 ms\) less',
                     text)
    looked(path, sync__offset_labels=-0.44)
    assert not caplog.text


def test_labels_anywhere_between_images_are_doubted_however_large_the_tolerance(tmp_path, caplog):
    path = written(tmp_path / 'bag', lambda i: bags.stamp(i) + (200 + 37 * i % 100) * MS, every=3,
                   n=60)
    looked(path, sync__tolerance=0.05)
    assert 'as if their stamps had nothing to do with it' in caplog.text
    assert '--set sync.offset_labels=-SECONDS' in caplog.text


def test_labels_after_the_last_depth_may_be_late_by_whole_periods(tmp_path, caplog):
    path = written(tmp_path / 'bag', lambda i: bags.stamp(i + 1), n=40)
    looked(path)
    assert '1 label image comes after the last depth image, and all 40' in caplog.text
    assert '--set sync.offset_labels=-0.100 in the second case' in caplog.text


@given(st.integers(-90, 900), st.integers(1, 4), st.integers(0, 8))
def test_the_lag_is_found(lag, every, jitter):
    depth = bags.START + 100 * MS * np.arange(60)
    rng = np.random.default_rng(lag + 1000)
    labels = np.unique(depth[::every] + lag * MS + rng.integers(-jitter, jitter + 1,
                                                                60)[::every] * MS)
    found = lags(labels, depth, 20 * MS)
    # A whole number of periods more explains as many where the labels are fewer.
    best = [x for x, count in found if count == found[0][1]]
    assert found[0][1] >= len(labels) - 1
    assert min(abs((x - lag * MS + 50 * MS) % (100 * MS) - 50 * MS) for x in best) <= 20 * MS


@given(st.lists(st.integers(0, 999), min_size=1), st.lists(st.integers(0, 999), min_size=1))
def test_distances_are_those_of_a_plain_search(labels, depth):
    found = distances(np.array(labels), np.array(depth))
    for a, off in zip(labels, found.tolist(), strict=True):
        assert abs(off) == min(abs(a - d) for d in depth) and a - off in depth


def test_depth_faster_than_labels_is_no_loss(tmp_path, capsys):
    path = written(tmp_path / 'bag', every=2)
    assert main(['replay', str(path), '--out', str(tmp_path / 'out')]) == 0
    said = capsys.readouterr().out
    assert '10 frames used, 0 dropped' in said
    assert '10 depth images came without labels, which is no loss' in said


def test_zero_stamps_are_named(tmp_path):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(5):
            bags.write_images(out, i, 0)
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
    assert '5 of 5 label images on /semantic/image have the stamp 0' in refusal(tmp_path / 'bag')


@pytest.mark.parametrize('options, words', [
    ({'pose': lambda i: bags.stamp(i) + 3600 * 1000 * MS}, ['poses on /pose', '3600']),
    ({'depth': lambda i: bags.stamp(i) - 50 * 1000 * MS}, ['50.0']),
    ({'pose': lambda i: i * 100 * MS}, ['different clocks'])])
def test_clocks_that_do_not_overlap_are_refused_and_info_says_so(tmp_path, capsys, options, words):
    path = written(tmp_path / 'bag', **options)
    text = refusal(path)
    assert main(['info', str(path)]) == 1
    report = capsys.readouterr().out
    assert all(word in text and word in report for word in words)


def test_poses_of_a_clock_that_is_seconds_off_are_said(tmp_path, caplog):
    """Stamps overlap, but the recorder saw poses of 3 s ahead come with images of now."""
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(80):
            bags.write_images(out, i)
            out.message('pose', bags.stamp(i), *out.make.pose(bags.stamp(i + 30), 'map',
                                                              bags.pose(i)))
    looked(tmp_path / 'bag')
    assert 'stamps of /pose are 3.0 s ahead of those of /depth/image' in caplog.text


def test_slow_poses_name_max_gap_before_and_after(tmp_path, capsys):
    path = written(tmp_path / 'bag', poses_every=10)
    assert '--set pose.max_gap=1.2' in refusal(path)
    assert len(looked(path, pose__max_gap=1.2)[0]) == 20
    few = written(tmp_path / 'few', n=60, pose=lambda i: bags.stamp(
        i - 0.5 if i < 50 else i + 7.5))
    assert main(['replay', str(few), '--out', str(tmp_path / 'out'),
                 '--set', 'memory.voxel_size=0.2']) == 0
    out = capsys.readouterr().out
    assert 'dropped: pose gap; ' in out and '--set pose.max_gap=' in out


def test_labels_without_depth_are_summed_up_with_the_distance(tmp_path, capsys):
    path = written(tmp_path / 'bag', labels=lambda i: bags.stamp(i) + (30 * MS if i > 16 else 0))
    assert main(['replay', str(path), '--out', str(tmp_path / 'out'),
                 '--set', 'memory.voxel_size=0.2']) == 0
    out = capsys.readouterr().out
    assert '3 dropped: no depth within tolerance; the nearest depth image was 30 ms before' in out


@pytest.mark.parametrize('share', [0.4, 0.7])
@pytest.mark.parametrize('seed', range(2))
def test_depth_that_was_lost_is_called_lost_not_late(tmp_path, capsys, share, seed):
    there = np.random.default_rng(seed).random(60) > share
    there[[0, -1]] = True
    path = written(tmp_path / 'bag', n=60, there=lambda i: there[i])
    assert main(['info', str(path)]) == 0
    out = capsys.readouterr().out
    assert f'{60 - there.sum()} of 60 label images have no depth image' in out
    assert 'offset_labels' not in out
    assert main(['replay', str(path), '--out', str(tmp_path / 'out'),
                 '--set', 'memory.voxel_size=0.2']) == 0
    out = capsys.readouterr().out
    assert 'it was lost when it was recorded' in out and 'offset_labels' not in out


@pytest.mark.parametrize('shift', [30 * MS, 150 * MS])
def test_nothing_is_called_lost_where_all_labels_are_late_alike(shift):
    depth = np.arange(50) * 100 * MS
    assert lost(depth, depth) == 0
    assert lost(depth + shift, depth) == 0


def test_the_printed_command_is_complete(tmp_path, capsys):
    path = written(tmp_path / 'bag', late)
    assert main(['info', str(path), '--set', 'sync.offset_labels=-0.17']) == 0
    out = capsys.readouterr().out
    assert '20 of 20 label images find depth and pose' in out
    assert f'persem replay {path} --out DIR --set sync.offset_labels=-0.17' in out


@pytest.mark.parametrize('start', ['1', f'{bags.stamp(10) / 1e9:.3f}'])
def test_checks_look_at_the_part_that_is_used(tmp_path, start):
    """Labels of the first second are late, those behind it are not."""
    path = written(tmp_path / 'bag', labels=lambda i: bags.stamp(i) + (170 * MS if i < 9 else 0),
                   n=40)
    with closing(opened(path, Config(), excerpt=Excerpt(start=start))) as recording:
        assert len(list(recording.frames())) >= 20
    assert main(['info', str(path), '--start', start]) == 0


def test_what_is_wrong_outside_of_the_part_is_not_said(tmp_path, caplog):
    path = written(tmp_path / 'bag', n=40,
                   pose=lambda i: bags.stamp(i - 0.5 if i < 20 else i + 100))
    opened(path, Config()).close()
    assert 'of 40 frames have no pose' in caplog.text
    caplog.clear()
    opened(path, Config(), excerpt=Excerpt(end='1.5')).close()
    assert not caplog.text.count('frames have no pose')
