"""Many recordings as one map: equal to the replay of one after the other, byte for byte."""

from dataclasses import replace
import json
import random

from persem_ros import workers
from persem_ros.cli import main
from persem_ros.errors import PersemError
from persem_ros.evaluate.work import manifest
from persem_ros.mosaic import fit, folder, plan, run
from persem_ros.outputs.map import store
from persem_ros.replay import replay
from persem_ros.settings.config import Config, updated
import pytest
import worlds

LEGENDS = ('{classes: [{id: 1, name: pole}, {id: 3, name: road}, {id: 7, name: roof}]}',
           '{classes: [{id: 3, name: roof}, {id: 7, name: road}, {id: 1, name: tree}]}', '')
# Voxels so small, and tiles of few blocks, that the little wall has many of both.
VALUES = {'memory.voxel_size': 0.05, 'refine.min_observations': 2}
TILE = 1.2


@pytest.fixture(scope='module')
def recordings(tmp_path_factory):
    """Return three recordings; classes of the second go by other ids, the third has no names."""
    base = tmp_path_factory.mktemp('recordings')
    return [str(worlds.write(base / f'r{k}', 6, k, legend=legend))
            for k, legend in enumerate(LEGENDS)]


def config_of(**values):
    return updated(Config(), {**VALUES, **values})


@pytest.fixture(scope='module')
def expected(recordings, tmp_path_factory):
    """Return the bytes of the map that a replay leaves."""
    out = tmp_path_factory.mktemp('replayed')
    replay(recordings, out, config_of(), report=False)
    return (out / 'map.persem').read_bytes()


def built(recordings, out, tile=TILE, values=(), **options):
    """Return the bytes of the map that a build leaves."""
    run.build(recordings, out, config_of(**dict(values)), tile, **{'workers': 1, **options})
    assert sorted(path.name for path in out.iterdir()) == [
        'build.json', 'config.yaml', 'map.persem']
    return (out / 'map.persem').read_bytes()


@pytest.mark.parametrize('tile', [0.3, 0.7, 64.0])      # one block, two, all of them
def test_a_build_is_the_replay_byte_for_byte(recordings, expected, tmp_path, tile):
    assert built(recordings, tmp_path, tile) == expected
    result = json.loads((tmp_path / 'build.json').read_text('utf-8'))
    assert result['frames']['used'] == 18 and result['sessions'] == 3
    assert (result['tiles'] <= 4) == (tile == 64.0)     # around the origin


@pytest.mark.parametrize('values', [
    {'refine.method': 'probabilistic', 'map.origin': (0.13, -5.0, 0.7)},
    {'memory.max_history': 2, 'refine.neighbours': 6}, {'refine.method': 'majority'}],
    ids=lambda values: next(iter(values)))
def test_other_settings(recordings, tmp_path, values):
    replay(recordings[:2], tmp_path / 'replay', config_of(**values), report=False)
    assert built(recordings[:2], tmp_path / 'build', values=values) == \
        (tmp_path / 'replay' / 'map.persem').read_bytes()


GEOMETRY = {'refine.method': 'geometry', 'refine.geometry.cell': 5, 'refine.geometry.window': 3}
FORMS = ('core.geometry.method', 'core.geometry.looks', 'core.geometry.totals', 'mosaic.look')


@pytest.fixture(scope='module')
def by_geometry(recordings, tmp_path_factory):
    """Return the bytes of the map that a replay by the method geometry leaves."""
    out = tmp_path_factory.mktemp('geometry')
    replay(recordings, out, config_of(**GEOMETRY), report=False)
    return (out / 'map.persem').read_bytes()


@pytest.mark.parametrize('tile', [0.3, 64.0])
def test_geometry_is_a_map_and_a_reduce_a_round(recordings, by_geometry, tmp_path, tile):
    assert built(recordings, tmp_path, tile, GEOMETRY) == by_geometry
    seconds = json.loads((tmp_path / 'build.json').read_text('utf-8'))['seconds']
    assert len(seconds['rounds']) == 4 * len(seconds['looks'])    # at the start, and three rounds


def test_several_processes(recordings, by_geometry, tmp_path):
    assert built(recordings, tmp_path, values=GEOMETRY, workers=2) == by_geometry


@pytest.mark.parametrize('values', [
    {'refine.up': 'x', 'memory.max_history': 2},
    {'map.origin': (0.13, -5.0, 0.7), 'refine.up': '-y', 'refine.geometry.smoothing': 0.0,
     'refine.geometry.heights': '1 -1 1'}],
    ids=lambda values: next(iter(values)))
def test_geometry_by_other_settings(recordings, tmp_path, values):
    values = {**GEOMETRY, **values}
    replay(recordings[:2], tmp_path / 'replay', config_of(**values), report=False)
    assert built(recordings[:2], tmp_path / 'build', values=values) == \
        (tmp_path / 'replay' / 'map.persem').read_bytes()


@pytest.mark.parametrize('up', ['z', 'x'])
def test_what_a_replay_says_of_the_legend(tmp_path, caplog, monkeypatch, up):
    """Heights that the votes contradict, the same in tiles; classes that move."""
    monkeypatch.setattr('persem_ros.core.geometry.overruled.FEW', 10)
    path = worlds.write(tmp_path / 'wall', 6, legend="""
classes:
- {id: 3, name: wall, height: [6, 7]}
- {id: 9, name: car, dynamic: true}
""")
    values, said = {**GEOMETRY, 'refine.up': up}, []
    for map_of, more in ((replay, {'report': False}),
                         (run.build, {'tile': TILE, 'workers': 1})):
        caplog.clear()
        map_of([str(path)], tmp_path / map_of.__name__, config_of(**values), **more)
        said.append([r.getMessage() for r in caplog.records if 'heights' in r.getMessage()
                     or 'legend marks' in r.getMessage()])
    assert said[0] == said[1]
    assert 'the votes contradict the heights of wall 6 to 7 m' in '\n'.join(said[1])
    assert any('marks 9 (car) as dynamic' in note for note in said[1])


def test_geometry_of_many_classes(recordings, tmp_path, monkeypatch):
    for module in FORMS:
        monkeypatch.setattr(f'persem_ros.{module}.MOST_DENSE', 0)
    replay(recordings[:2], tmp_path / 'replay', config_of(**GEOMETRY), report=False)
    assert built(recordings[:2], tmp_path / 'build', values=GEOMETRY) == \
        (tmp_path / 'replay' / 'map.persem').read_bytes()


def test_any_order_of_completion(recordings, by_geometry, tmp_path, monkeypatch):
    order = random.Random(7)
    results = workers.Crew.results

    def shuffled(self, work, tasks, *options):
        found = list(enumerate(tasks))
        order.shuffle(found)
        for (place, _), (_, result) in zip(found, sorted(
                results(self, work, [task for _, task in found], *options))):
            yield place, result
    monkeypatch.setattr(workers.Crew, 'results', shuffled)
    assert built(recordings, tmp_path, values=GEOMETRY) == by_geometry


STAGES = {'observe': run, 'join': run, 'look': fit, 'count': fit, 'refine': run}


@pytest.mark.parametrize('stage, after', [
    ('observe', 1), ('join', 2), ('look', 1), ('count', 1), ('count', 9), ('refine', 1),
    ('assemble', 0)])
def test_a_build_that_was_stopped_goes_on(recordings, by_geometry, tmp_path, monkeypatch, stage,
                                          after):
    counts = {}
    with monkeypatch.context() as patched:
        for name, module in STAGES.items():
            patched.setattr(module, name, _counting(getattr(module, name), counts, name,
                                                    after if name == stage else None))
        if stage == 'assemble':
            patched.setattr(run.assemble, 'assemble', _stop)
        with pytest.raises(KeyboardInterrupt):
            built(recordings, tmp_path, values=GEOMETRY)
    assert not (tmp_path / 'map.persem').exists()
    before, counts = counts, {}
    with monkeypatch.context() as patched:
        for name, module in STAGES.items():
            patched.setattr(module, name, _counting(getattr(module, name), counts, name))
        assert built(recordings, tmp_path, values=GEOMETRY) == by_geometry
    total = {name: before.get(name, 0) + counts.get(name, 0) for name in STAGES}
    tiles = json.loads((tmp_path / 'build.json').read_text('utf-8'))['tiles']
    assert total == {'observe': 3, 'join': tiles, 'look': tiles, 'count': 4 * tiles,
                     'refine': tiles}       # nothing was done twice


def _stop(*_):
    raise KeyboardInterrupt


def _counting(work, counts, name, last=None):
    """Return *work* that counts its tasks, and is interrupted after *last* of them."""
    def counted(task, tick=None):
        if counts.get(name, 0) == last:
            raise KeyboardInterrupt
        counts[name] = counts.get(name, 0) + 1
        return work(task, tick)
    return counted


def test_what_is_finished_is_not_built_again(recordings, tmp_path, monkeypatch, caplog):
    before = built(recordings[:1], tmp_path)
    monkeypatch.setattr(run, 'observe', _stop)
    with caplog.at_level('INFO', 'persem_ros'):
        assert built(recordings[:1], tmp_path) == before
    assert 'is finished already' in caplog.text


def refused(capsys, *words):
    """Return the line that the command line refuses *words* with."""
    assert main(['build', *map(str, words), '--set', 'memory.voxel_size=0.05',
                 '--workers', '1']) == 1
    return capsys.readouterr().err.splitlines()[-1]


def test_a_folder_that_holds_something_else(recordings, tmp_path, capsys):
    one, out = recordings[0], tmp_path / 'out'
    built(recordings[:1], out)
    said = refused(capsys, one, '--out', out)
    assert 'holds another build (' in said and 'other settings' in said and '--force' in said
    assert 'holds another build (tile, blocks: 3 -> 4' in _other_tile(recordings, out)
    (tmp_path / 'full').mkdir()
    (tmp_path / 'full' / 'file').write_text('')
    assert 'is not empty and holds no build; give another folder with --out, or --force' in \
        refused(capsys, one, '--out', tmp_path / 'full')
    assert 'is a file' in refused(capsys, one, '--out', tmp_path / 'full' / 'file')
    assert 'which this run reads' in refused(capsys, one, '--out', one)
    assert built(recordings[:1], out, 1.5, force=True) == built(recordings[:1], tmp_path / 'new')


def _other_tile(recordings, out):
    with pytest.raises(PersemError) as error:
        built(recordings[:1], out, 1.5)
    return str(error.value)


def test_a_folder_in_use(recordings, tmp_path, capsys):
    with folder.rundir.locked(tmp_path):
        assert 'another run is writing into' in refused(capsys, recordings[0], '--out', tmp_path)


@pytest.mark.parametrize('words, said', [
    (('--tile', '0'), '--tile 0: expected metres above 0, such as --tile 64'),
    (('--tile', 'nan'), '--tile nan: expected metres above 0'),
    (('--tile', '1e300'), 'expected metres, such as --tile 64'),
    (('--set', 'memory.clear_after=3'), 'needs the frames one after the other'),
    (('--set', 'map.path=other.persem'), 'join maps with persem map merge'),
    (('--set', 'memory.clear_after=3'), '--set memory.clear_after=0, or use persem replay'),
    (('--scheduler', 'tcp://10.0.0.1:8786'), 'without TLS anybody on the network'),
    (('--scheduler', '10.0.0.1'), 'without TLS anybody on the network')])
def test_options_that_no_build_can_follow(recordings, tmp_path, capsys, words, said):
    pytest.importorskip('distributed')
    assert said in refused(capsys, recordings[0], '--out', tmp_path / 'out', *words)
    assert not (tmp_path / 'out').exists()


def test_one_recording_is_one_session(recordings, tmp_path, capsys):
    assert main(['build', recordings[0], '--out', str(tmp_path / 'o'), '--workers', '1']) == 0
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith('6 frames used, 0 dropped; 1 session, ') and ' tiles, ' in first


def test_a_map_of_too_many_tiles(recordings, tmp_path, monkeypatch):
    monkeypatch.setattr(run, 'MOST_TILES', 1)
    with pytest.raises(PersemError, match=r'more than 1; give a larger one, such as --tile 4\.8'):
        built(recordings, tmp_path)


def test_legends_that_contradict_are_what_a_replay_makes_of_them(tmp_path, recordings, caplog):
    twice = '{classes: [{id: 3, name: pole}, {id: 7, name: pole}]}'
    some = [recordings[0], str(worlds.write(tmp_path / 'bad', 3, legend=twice))]
    replay(some, tmp_path / 'replay', config_of(), report=False)
    assert built(some, tmp_path / 'build') == (tmp_path / 'replay' / 'map.persem').read_bytes()
    assert 'bad: ids follow their names' in caplog.text


def test_a_recording_that_gives_nothing(tmp_path, recordings, capsys):
    empty = worlds.write(tmp_path / 'empty', 0)
    assert 'empty' in refused(capsys, recordings[0], empty, '--out', tmp_path / 'out')
    assert 'r0: nothing went into the map, ' in refused(
        capsys, recordings[0], '--out', tmp_path / 'few', '--set', 'memory.min_pixels=9999')


def test_a_damaged_part_is_named(recordings, tmp_path, monkeypatch):
    monkeypatch.setattr(run, 'join', _stop)
    with pytest.raises(KeyboardInterrupt):
        built(recordings[:1], tmp_path)
    monkeypatch.undo()
    path = tmp_path / folder.WORK / 'recordings' / '000000.persem'
    data = bytearray(path.read_bytes())
    data[-4000:-3000] = bytes(1000)
    path.write_bytes(data)
    with pytest.raises(PersemError, match=r'000000\.persem: damaged'):
        built(recordings[:1], tmp_path)


def test_another_source_is_another_build(recordings, monkeypatch):
    one = plan.planned(recordings[:1], config_of(), TILE)
    before = one.identity()
    assert one.identity() == before == replace(one).identity()
    monkeypatch.setattr(plan, 'source_hash', lambda: 'other')
    assert manifest.changes(before, one.identity())


def test_a_map_that_a_reader_opens(recordings, tmp_path):
    built(recordings, tmp_path)
    stored = store.load(tmp_path / 'map.persem')
    assert len(stored.saved.frames.sessions) == 3 and stored.saved.rho is not None
