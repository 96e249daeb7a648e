"""The parameters of the method geometry in map files: gone on with, or refused."""

from dataclasses import replace

import core_worlds as cw
import numpy as np
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.loading import load
from persem_ros.core.refine.job import finish
from persem_ros.core.refine.turns import begin_next
from persem_ros.core.refine.whole import refine
from persem_ros.errors import PersemError
from persem_ros.outputs.map import store
from persem_ros.outputs.map.habits import from_blob, to_blob
from persem_ros.settings.config import Config
import pytest

CONFIG = replace(Config(), refine=replace(Config().refine, method='geometry', sweep=90))


def frames(n):
    """Return n random frames of up to 60 voxels on both sides of zero."""
    rng = np.random.default_rng(5)
    return [(10 ** 18 + 10 ** 8 * t,
             {tuple(int(i) for i in voxel): (int(rng.choice(cw.IDS)), float(rng.choice(cw.EXACT)))
              for voxel in rng.integers(-9, 9, (60, 3))}) for t in range(n)]


@pytest.fixture(scope='module')
def memory():
    """Return a small map, labelled by the method geometry."""
    memory = cw.core_of(frames(9))
    refine(memory, CONFIG.refine)
    return memory


def go_on(memory, rounds=0):
    """Add a frame and refine, then in rounds as a node does; return labels and parameters."""
    memory.add(cw.observations(*frames(10)[-1]))
    refine(memory, CONFIG.refine, full=False)
    for _ in range(rounds):
        job = begin_next(memory, CONFIG.refine)
        finish(job, *job.compute())
    columns = memory.voxels()
    return [columns[name].tolist() for name in ('voxel', 'label', 'source', 'confidence')], {
        name: a.tolist() for name, a in memory.geometry.arrays().items()}


def test_saved_and_loaded_is_never_saved(memory, tmp_path):
    store.save(tmp_path / 'map.persem', memory, CONFIG)
    again = store.load(tmp_path / 'map.persem').memory()
    assert again.geometry is None and again.habits       # not fitted anew: taken from the file
    straight = cw.core_of(frames(9))
    refine(straight, CONFIG.refine)
    assert go_on(again) == go_on(straight)


def test_other_settings_fit_anew(memory, tmp_path):
    store.save(tmp_path / 'map.persem', memory, CONFIG)
    again = store.load(tmp_path / 'map.persem').memory()
    other = replace(CONFIG.refine, geometry=replace(CONFIG.refine.geometry, prior=5.0))
    assert refine(again, other, full=False) == again.n_voxels
    straight = cw.core_of(frames(9))
    refine(straight, other)
    assert again.geometry.theta.tolist() == straight.geometry.theta.tolist()


def test_tampered_bytes_are_refused_or_can_be_gone_by(memory):
    saved, rng, refused = dump(memory), np.random.default_rng(2), 0
    blob = to_blob(saved.habits, saved.fitted_by)
    for _ in range(300):
        harmed = bytearray(blob)
        for at in rng.integers(0, len(blob) if rng.random() < 0.5 else 900, rng.integers(1, 4)):
            harmed[at] = rng.integers(256)
        if rng.random() < 0.2:
            del harmed[rng.integers(len(harmed)):]
        try:
            habits, by = from_blob(bytes(harmed))
        except ValueError:
            refused += 1
            continue
        again = load(replace(saved, habits=habits, fitted_by=by))
        labels = go_on(again, 3)[0][1]
        assert set(labels) <= {*habits['classes'].tolist(), *cw.IDS}
    assert 100 < refused < 300


@pytest.mark.parametrize('name, value', [
    ('pi', 0.0), ('pi', 1e-320), ('pi', np.nan), ('theta', -1.0), ('fine', np.inf),
    ('fine', 1e308), ('rho', -0.1), ('coarse', -5.0)])
def test_values_that_no_fit_gives_are_refused(memory, name, value):
    saved = dump(memory)
    harmed = {**saved.habits, name: saved.habits[name].copy()}
    harmed[name].flat[0] = value
    with pytest.raises(ValueError):
        from_blob(to_blob(harmed, saved.fitted_by))
    huge = {**saved.habits, name: np.full_like(saved.habits[name], 2.0 ** 53)}
    labels = go_on(load(replace(saved, habits=huge)), 3)[0][1]     # sound, if absurd
    assert set(labels) <= set(cw.IDS)


def test_a_file_whose_parameters_were_exchanged(memory, tmp_path):
    path = tmp_path / 'map.persem'
    saved = dump(memory)
    store.save(path, replace(saved, habits={**saved.habits, 'pi': saved.habits['pi'][:1]}), CONFIG)
    with pytest.raises(PersemError, match='parameters of the method geometry'):
        store.load(path)
