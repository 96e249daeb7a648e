"""Names from files on a terminal: nothing that it would obey."""

from hypothesis import given, strategies as st
from persem_ros.guard.words import LONGEST, plain, sentence, short
import pytest


@pytest.mark.parametrize(('text', 'shown'), [
    ('road', 'road'), ('Straße 道路', 'Straße 道路'), ('\x1b]0;owned\x07', r'\x1b]0;owned\x07'),
    ('a\x9bJ', r'a\x9bJ'), ('\u202eabc', r'\u202eabc'), ('a\nb', r'a\nb'), ('\x7f', r'\x7f')])
def test_control_characters_are_escaped(text, shown):
    assert plain(text) == shown


@given(st.text())
def test_whatever_a_name_is_it_commands_no_terminal(text):
    for shown in (plain(text, lines=True), sentence(text), short(text)):
        assert not any(ord(c) < 32 and c not in '\n\t' or 127 <= ord(c) < 160 for c in shown)


def test_values_are_cut_before_they_are_written_out():
    deep = [0]
    for _ in range(50):
        deep = [deep] * 9       # 9 ** 50 items, were they written out
    assert len(short(deep)) < 200
    assert len(short('x' * 10 ** 6)) < 100
    assert len(sentence('x' * 10 ** 6)) <= LONGEST + 5
