"""Heights above the ground that classes keep to: what is said, and what is refused."""

from dataclasses import replace

from persem_ros.errors import PersemError
from persem_ros.settings.config import Config, updated
from persem_ros.settings.heights import canonical, hinted, parsed
from persem_ros.settings.legend import Legend
import pytest

LEGEND = """
classes:
- {id: 3, name: road, height: [-1, 1]}
- {id: 4, name: path}
- {id: 5, name: building, height: [2.5, .inf]}
"""


def test_a_setting_says_class_lowest_highest():
    assert parsed('') == parsed(' ; ') == ()
    assert canonical('legend: 5 4 inf;3 -2 2.50') == canonical('3 -2 2.5; 5 4 inf') == \
        '3 -2 2.5; 5 4 inf'
    assert parsed('3 -inf inf') == ((3, -float('inf'), float('inf')),)      # anywhere
    assert parsed('5 4 inf; 3 -2 2.5;') == ((3, -2.0, 2.5), (5, 4.0, float('inf')))


@pytest.mark.parametrize('text', ['3', '3 1', '3 a b', '3.5 0 1', '3 0 1 2', '3 2 1', '3 nan 1',
                                  '3 0 1; 3 2 4', '-1 0 1', '65535 0 1', '[3, 0, 1]'])
def test_what_is_no_height_is_refused(text):
    with pytest.raises(PersemError, match="^refine.geometry.heights: expected .*'3 -2 2; 5 4 inf"):
        updated(Config(), {'refine.geometry.heights': text})


def test_a_legend_gives_metres_and_the_setting_goes_before():
    legend = Legend.from_yaml(LEGEND)
    assert [c.height for c in legend.classes] == [(-1.0, 1.0), None, (2.5, float('inf'))]
    assert Legend.from_yaml(legend.to_yaml()) == legend
    config = hinted(updated(Config(), {'memory.voxel_size': 0.25}), legend)
    assert parsed(config.refine.geometry.heights) == ((3, -4.0, 4.0), (5, 10.0, float('inf')))
    assert config.refine.geometry.heights.startswith('legend: ')
    assert hinted(config, legend) is config
    coarse = hinted(updated(config, {'memory.voxel_size': 0.5}), legend)    # given back
    assert parsed(coarse.refine.geometry.heights) == ((3, -2.0, 2.0), (5, 5.0, float('inf')))
    assert hinted(config, Legend()).refine == Config().refine
    none = updated(Config(), {'refine.geometry.heights': 'none'})
    assert hinted(none, legend) is none and parsed('none') == ()
    said = updated(Config(), {'refine.geometry.heights': '3 0 9'})
    assert hinted(said, legend) is said
    assert hinted(Config(), Legend()) == Config()
    assert replace(config, refine=Config().refine) == updated(Config(),
                                                              {'memory.voxel_size': 0.25})


@pytest.mark.parametrize('height', ['1', '[1]', '[2, 1]', '[a, b]', '[.nan, 1]', '[true, 2]',
                                    f'[0, 1{"0" * 400}]'])
def test_a_height_that_is_none_is_refused(height):
    words = r"classes\[0\] \('road'\): height: expected \[lowest, highest\]"
    with pytest.raises(PersemError, match=words):
        Legend.from_yaml(f'classes:\n- {{id: 3, name: road, height: {height}}}')
