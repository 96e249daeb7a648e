"""Heights that count are said, and those that cannot."""

import numpy as np
from persem_ros.core.geometry.overruled import Overruled
from persem_ros.preflight.advice import Advice
from persem_ros.settings.config import Config, updated
from persem_ros.settings.heights import hinted
from persem_ros.settings.legend import Legend

LEGEND = Legend.from_yaml("""
classes:
- {id: 3, name: road, height: [-1, 1]}
- {id: 5, name: building, height: [2.5, .inf]}
""")


def said(ids, legend=LEGEND, overruled=(), methods=(), **values):
    """Return what is said of the heights where so many ids were seen."""
    config = updated(Config(), {'refine.method': 'geometry', **{
        f'refine.{name}': value for name, value in values.items()}})
    seen = np.zeros(65536, np.uint8)
    seen[ids] = 1
    return Advice(hinted(config, legend), legend, methods).sentences(seen, overruled)


def test_heights_that_count_are_said():
    assert said([3, 5]) == [
        'geometry goes by the heights of road -1 to 1 m, building 2.5 to inf m above the ground; '
        'without them: --set refine.geometry.heights=none']
    assert said([3, 5], method='persem', methods=('raw2d', 'geometry')) == said([3, 5])
    assert said([3, 5], **{'geometry.heights': '3 -2 2'})[0].startswith(
        'geometry goes by the heights of road -2 to 2 voxels above')
    assert said([3, 5], Legend()) == said([7], method='persem') == []
    off = updated(Config(), {'refine.method': 'geometry', 'refine.geometry.heights': 'none'})
    assert Advice(hinted(off, LEGEND), LEGEND).sentences(np.ones(65536, np.uint8)) == []


def test_heights_without_the_method_that_goes_by_them_are_said():
    assert said([3, 5], method='persem', methods=('raw2d', 'majority')) == [
        'heights of road, building are given, by which the method geometry alone goes: '
        '--set refine.method=geometry']


def test_heights_of_nothing_are_said():
    told, = said([7])
    assert told.startswith('refine.geometry.heights or the legend give heights of classes that do '
                           'not occur: 3, 5; expected ids that do: 7 (class 7)')
    assert len(said([3])) == 1      # a legend may know of more than was seen


def test_heights_that_votes_contradict_are_said():
    told = said([3, 5], overruled=[Overruled(3, -2.0, 2.0, 1000, 900, 300),
                                   Overruled(5, 5.0, np.inf, 1000, 400, 100)])
    assert told[1:] == [
        'the votes contradict the heights of road -1 to 1 m (90% of its voxels by votes lie '
        'beyond, 33% of these keep the name): expected metres above the ground, with a metre or '
        'two to spare, of the right class (or most labels of it are wrong, or the map holds a few '
        'seconds only); without them: --set refine.geometry.heights=none']


def test_what_was_typed_in_voxels_is_contradicted_in_voxels():
    told = said([3], overruled=[Overruled(3, -2.0, 2.0, 1000, 900, 300)],
                **{'geometry.heights': '3 -2 2'})
    assert 'contradict the heights of road -2 to 2 voxels (90%' in told[1]
    assert 'expected voxels (of 0.5 m) above the ground, with a metre or two' in told[1]
