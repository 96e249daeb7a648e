"""Several recordings and parts of them: one input A+B, sessions A B, --start, --end, --every."""

from collections import Counter
import json

import bags
from persem_ros.cli import main
from persem_ros.commands import frames_text
from persem_ros.outputs.map import store
from persem_ros.outputs.recording.writer import RecordingWriter
import pytest
import replays
import worlds


@pytest.fixture(scope='module')
def recordings(tmp_path_factory):
    """Return two flights over one wall; their stamps are the same."""
    folder = tmp_path_factory.mktemp('flights')
    return worlds.write(folder / 'a', frames=9), worlds.write(folder / 'b', frames=7, seed=1)


def replay(out, *arguments):
    """Replay into a folder; return metrics.json and the frame table."""
    assert main(['replay', *map(str, arguments), '--out', str(out), '--set',
                 'memory.voxel_size=0.2']) == 0
    return json.loads((out / 'metrics.json').read_text()), \
        store.load(out / 'map.persem').memory().frames


@pytest.mark.parametrize('causal', [False, True])
def test_recordings_in_a_row_are_sessions_of_one_map(tmp_path, recordings, causal):
    a, b = recordings
    flags = ['--causal'] if causal else []
    metrics, frames = replay(tmp_path / 'both', a, b, *flags)
    assert metrics['frames'] == {'used': 16, 'dropped': {}}
    assert [f.session for f in frames] == [0] * 9 + [1] * 7
    assert [f.t for f in frames] == list(range(16))
    assert [f.stamp for f in frames] == [bags.stamp(i) for i in (*range(9), *range(7))]
    replay(tmp_path / 'first', a)
    replay(tmp_path / 'second', b, '--set', f'map.path={tmp_path / "first" / "map.persem"}')
    assert replays.histories(tmp_path / 'both' / 'map.persem') == \
        replays.histories(tmp_path / 'second' / 'map.persem')


def test_flicker_does_not_compare_frames_of_two_sessions(tmp_path, recordings):
    a, _ = recordings
    once, _ = replay(tmp_path / 'once', a, '--methods', 'raw2d,ema2d')
    twice, _ = replay(tmp_path / 'twice', a, a, '--methods', 'raw2d,ema2d')
    for method in ('raw2d', 'ema2d'):
        assert twice['methods'][method] == once['methods'][method]
    assert twice['truth_flicker'] == once['truth_flicker']


def test_drive_and_labels_in_two_recordings(tmp_path, capsys):
    topics = {'drive': [], 'labels': []}
    for name in topics:
        with RecordingWriter(tmp_path / name) as out:
            for i in range(6):
                if name == 'labels':
                    out.image('semantic/image', bags.stamp(i), 'camera', bags.labels(i), 'mono16')
                    continue
                out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
                out.image('depth/image', bags.stamp(i), 'camera', bags.depth(i), '32FC1')
                out.camera_info('depth/camera_info', bags.stamp(i), 'camera', 16, 12, bags.K)
    both = f'{tmp_path / "drive"}+{tmp_path / "labels"}'
    metrics, _ = replay(tmp_path / 'out', both)
    assert metrics['frames'] == {'used': 6, 'dropped': {}}
    report = (tmp_path / 'out' / 'report.html').read_text()
    assert 'drive+labels' in report and f'persem replay {both}' in report
    assert main(['info', both]) == 0
    assert f'usable: persem replay {both} --out DIR' in capsys.readouterr().out


def test_an_excerpt_is_said_and_the_report_repeats_it(tmp_path, recordings, capsys):
    metrics, frames = replay(tmp_path / 'out', recordings[0], '--start', '0.2', '--end',
                             '0.7', '--every', '2')
    assert metrics['frames'] == {'used': 3, 'dropped': {}}
    assert [(f.t, f.stamp) for f in frames] == [(k, bags.stamp(i))
                                                for k, i in enumerate((2, 4, 6))]
    said = capsys.readouterr().err
    assert 'from 1700000000.200000000 s (--start 0.2, seconds after the first frame)' in said
    page = (tmp_path / 'out' / 'report.html').read_text()
    assert '--start 0.2 --end 0.7 --every 2 --out' in page


def test_poses_that_are_dropped_are_no_frames():
    dropped = {'no pose': 2, 'pose: went back': 3046, "labels: encoding 'yuv422'": 1}
    said = frames_text.lines({'used': 11, 'dropped': dropped}, '5 voxels')
    assert said[0] == '11 frames used, 3 dropped; 5 voxels'
    assert '  3046 dropped: pose: went back' in said


def test_results_are_not_written_over_what_is_read(tmp_path, recordings, capsys):
    replay(tmp_path / 'out', recordings[0])
    assert main(['replay', f'{recordings[1]}+{tmp_path / "out" / "refined"}', '--out',
                 str(tmp_path / 'out'), '--force']) == 1
    assert 'whose files this run would replace' in capsys.readouterr().err


def test_ids_of_a_second_session_follow_their_names(tmp_path, capsys):
    """Id 3 is a tree in one flight and a road in the other: "tree" stays one class."""
    for name, three, seven in (('a', 'tree', 'wall'), ('b', 'road', 'tree')):
        worlds.write(tmp_path / name, frames=3, legend=f'classes:\n- {{id: 3, name: {three}}}\n'
                                                       f'- {{id: 7, name: {seven}}}\n')
    assert main(['replay', str(tmp_path / 'a'), str(tmp_path / 'b'), '--out',
                 str(tmp_path / 'out'), '--set', 'memory.voxel_size=0.2']) == 0
    said = capsys.readouterr()
    assert "'road' 3 is 0, 'tree' 7 is 3" in said.out + said.err
    found = store.load(tmp_path / 'out' / 'map.persem')
    names = {item.id: item.name for item in found.legend.classes}
    assert names == {3: 'tree', 7: 'wall', 0: 'road'}
    alone = store.load(_replayed(tmp_path / 'b', tmp_path / 'alone')).memory()
    memory, own, joint = found.memory(), Counter(), Counter()
    for voxel in map(tuple, alone.voxels()['voxel'].tolist()):
        ids = alone.history(voxel)[0].tolist()
        own.update(ids)
        joint.update(memory.history(voxel)[0].tolist()[-len(ids):])
    # Of equal numbers of pixels the smaller id wins, so that a few are others'.
    assert set(joint) <= {0, 1, 3, worlds.MOVING} and min(own[3], own[7]) > 30
    assert joint[0] == pytest.approx(own[3], rel=0.2)
    assert joint[3] == pytest.approx(own[7], rel=0.2)


def _replayed(path, out):
    assert main(['replay', str(path), '--out', str(out), '--set', 'memory.voxel_size=0.2']) == 0
    return out / 'map.persem'


def test_evaluate_takes_two_recordings_as_one_and_a_part(tmp_path, recordings, capsys):
    a, b = recordings
    out = tmp_path / 'out'
    arguments = ['evaluate', str(a), '--every', '3', '--out', str(out), '--no-figures',
                 '--methods', 'raw2d,majority', '--workers', '1']
    assert main(arguments) == 0
    found = json.loads((out / 'sequences' / 'a' / 'summary.json').read_text())
    assert found['frames']['used'] == 3
    assert main(['evaluate', f'{a}+{b}', *arguments[2:]]) == 0
    summary = json.loads((out / 'sequences' / 'a+b' / 'summary.json').read_text())
    assert summary['name'] == 'a+b' and summary['frames']['dropped']['stamp repeated'] == 7
    capsys.readouterr()
    assert main(['evaluate', str(a), *arguments[4:]]) == 1
    assert 'other settings' in capsys.readouterr().err
