"""Inputs that once found something must not again; and a few that nobody has tried."""

import inspect
import shutil

from findings import FINDINGS
import harm
import pytest


@pytest.fixture(scope='module')
def trial(tmp_path_factory):
    """Return what makes and tries inputs."""
    return harm.Trial(tmp_path_factory.mktemp('fuzz'))


@pytest.mark.parametrize('name', FINDINGS)
def test_what_once_found_something(trial, name):
    kind, make, words = FINDINGS[name]
    outcome, text = trial.outcome(_use, trial, kind, make)
    assert (outcome, words in text) == ('refused' if words else 'accepted', True), text


def _use(trial, kind, make):
    if kind == 'map':
        path = trial.folder / 'finding.persem'
        shutil.copy(trial.whole, path)
        make(path)
        trial.use_map(path, deep=True)
    elif kind in ('mcap', 'sqlite3'):
        files = trial.recordings[kind, False]
        files = make(*(files, trial.folder)[:len(inspect.signature(make).parameters)])
        trial.use_recording(trial.written(files), deep=False)
    elif kind == 'cdr':
        trial.use_cdr(*make())
    elif kind in ('track', 'picture'):
        name, content = make()
        path = trial.folder / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        getattr(trial, f'use_{kind}')(path)
    else:
        getattr(trial, f'use_{kind}')(make())


@pytest.mark.parametrize(('kind', 'number'), [
    ('legend', 60), ('settings', 60), ('cdr', 300), ('map', 20), ('recording', 20),
    ('picture', 60), ('track', 60), ('living', 10)])
def test_some_inputs_of_each_kind(trial, kind, number):
    outcomes = {n: trial.run(kind, n) for n in range(1, number)}
    assert {n: what for n, what in outcomes.items() if what[0] == harm.FAULT} == {}
    assert {what[0] for what in outcomes.values()} == {harm.ACCEPTED, harm.REFUSED}
