"""Inputs that once found something: they must not again."""

from pathlib import Path

import harm
import pytest

CORPUS = [line.split() for line in Path(__file__).with_name('corpus.txt').read_text().splitlines()
          if line and line[0] != '#']


@pytest.fixture(scope='module')
def trial(tmp_path_factory):
    """Return what makes and tries inputs."""
    return harm.Trial(tmp_path_factory.mktemp('fuzz'))


@pytest.mark.parametrize(('kind', 'number'), CORPUS)
def test_what_once_found_something(trial, kind, number):
    assert trial.run(kind, int(number)) == ''


@pytest.mark.parametrize('kind', ('legend', 'settings', 'cdr'))
@pytest.mark.parametrize('first', (0, 50))
def test_some_inputs_of_each_kind(trial, kind, first):
    assert {number: fault for number in range(first, first + 50)
            if (fault := trial.run(kind, number))} == {}
