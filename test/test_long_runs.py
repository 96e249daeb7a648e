"""The soak and the long survey of benchmarks/ in small."""

import importlib.util
from pathlib import Path

import numpy as np
from persem_ros.outputs.map import store
import pytest

BENCHMARKS = Path(__file__).resolve().parents[1] / 'benchmarks'


def script(name):
    """Return a script of benchmarks/ as a module."""
    spec = importlib.util.spec_from_file_location(name, BENCHMARKS / f'{name}.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_soak_in_small_loses_no_frame_and_keeps_to_its_bound(tmp_path):
    soak = script('soak')
    soak.SPEED, bound, told = 40.0, 300, []     # a place is left before the flight ends
    run = soak.Soak(tmp_path / 'map.persem', {'memory.max_voxels': bound,
                                              'memory.voxel_size': 4.0})
    run.fly(60, soak.Flight((32, 24)), every=10, told=told.append)
    saved = store.load(tmp_path / 'map.persem').saved
    assert len(saved.frames) == run.rendered == 60 and told == run.samples
    assert saved.observations.sum() == run.samples[-1]['observations']
    held = [sample['held'] for sample in run.samples]
    assert max(held) <= 1.3 * bound < len(saved.cell) / 1.5
    assert run.statistics.refinements > 0


def test_the_line_through_a_soak():
    soak = script('soak')
    rng = np.random.default_rng(3)
    samples = [{'minute': k, 'rss': 1e8 + 7e3 * k + noise} for k, noise in
               enumerate(rng.normal(0, 1e3, 200))]
    slope, error = soak.fitted([{'minute': -9, 'rss': 0}, *samples], 0)
    assert slope == pytest.approx(7, abs=3 * error) and 0 < error < 0.01


def test_a_long_survey_in_small():
    survey = script('long')
    survey.SIDE, survey.CHECKPOINT = 16, 4
    columns = {str(bound): survey.measured(4000, bound) for bound in (900, 0)}
    few, all_of_them = columns.values()
    assert few['observations'] == all_of_them['observations']
    assert few['voxels in the file'] == all_of_them['voxels in the file'] == \
        all_of_them['voxels in memory, at most'] > 1.5 * few['voxels in memory, at most']
    lines = survey.table(columns)
    assert lines[0] == '| | 900 | 0 |' and len({line.count('|') for line in lines}) == 1
