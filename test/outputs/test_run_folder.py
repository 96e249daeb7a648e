"""The folder of a run: built beside the old files, swapped when whole, one writer at a time."""

import os
from pathlib import Path
import subprocess
import sys

from persem_ros.errors import PersemError
from persem_ros.outputs.results import rundir
from persem_ros.outputs.results.rundir import building, check_extra
import pytest

ROOT = Path(__file__).parents[2]
SIMPLE = tuple(name for name in rundir.FILES if name != rundir.REFINED)


def fill(folder, text):
    for name in SIMPLE:
        (folder / name).write_text(text)


def content(folder):
    """Return {name: text} of all files in a folder, hidden ones too."""
    return {str(path.relative_to(folder)): path.read_text() for path in sorted(folder.rglob('*'))
            if path.is_file()}


@pytest.fixture
def old(tmp_path):
    """Return the folder of an earlier run with a file of somebody else."""
    out = tmp_path / 'out'
    out.mkdir()
    fill(out, 'old')
    (out / 'notes.txt').write_text('mine')
    return out


def test_new_files_take_the_place_of_old_ones_at_the_end(old):
    with building(old, force=True) as work:
        fill(work, 'new')
        assert content(old)['map.ply'] == 'old'
    assert content(old) == {**dict.fromkeys(SIMPLE, 'new'), 'notes.txt': 'mine'}


@pytest.mark.parametrize('error', [PersemError('no'), OSError(5, 'no'), KeyboardInterrupt()],
                         ids=lambda error: type(error).__name__)
def test_what_goes_wrong_leaves_the_folder_as_it_was(old, error):
    before = content(old)
    with pytest.raises((PersemError, KeyboardInterrupt)):
        with building(old, force=True) as work:
            fill(work, 'new')
            raise error
    assert content(old) == before


@pytest.mark.parametrize('nth', range(1, 12))
def test_a_swap_that_fails_on_the_way_is_undone(old, monkeypatch, nth):
    before, rename, calls = content(old), os.rename, []

    def failing(source, target):
        calls.append(source)
        if len(calls) == nth:
            raise KeyboardInterrupt
        rename(source, target)

    monkeypatch.setattr(rundir.os, 'rename', failing)
    with pytest.raises(KeyboardInterrupt):
        with building(old, force=True) as work:
            fill(work, 'new')
    assert content(old) == before


def test_a_run_that_was_killed_while_it_swapped_is_undone_by_the_next(old):
    before = content(old)
    left = old / f'{rundir.WORK}999999999.partial'
    (left / rundir.OLD).mkdir(parents=True)
    for name in SIMPLE[:3]:         # those are swapped, the fourth is on its way
        os.rename(old / name, left / rundir.OLD / name)
        (old / name).write_text('new')
    os.rename(old / SIMPLE[3], left / rundir.OLD / SIMPLE[3])
    with pytest.raises(PersemError, match='not empty'):
        with building(old):
            pass
    assert content(old) == before


def test_force_takes_no_folder_and_no_file_of_somebody_else(tmp_path):
    out = tmp_path / 'out'
    for name in ('map.ply', 'report.html'):
        (out / name).mkdir(parents=True)
        (out / name / 'mine').write_text('mine')
    before = content(out)
    with pytest.raises(PersemError, match='is a folder, not the file of an earlier run'):
        with building(out, force=True):
            pass
    assert content(out) == before


def test_names_that_look_like_ours_stay(old):
    for name in ('.map.ply.mine.partial', '.persem-run.notes.partial', '.refined.keep.partial'):
        (old / name).write_text('mine')
    with building(old, force=True) as work:
        fill(work, 'new')
    assert {'.map.ply.mine.partial', '.persem-run.notes.partial', '.refined.keep.partial'} \
        <= set(content(old))


def test_a_link_in_the_place_of_a_file_is_replaced_and_not_followed(old, tmp_path):
    other = tmp_path / 'other'
    other.mkdir()
    (other / 'data').write_text('mine')
    (old / 'refined').symlink_to(other)
    with building(old, force=True) as work:
        fill(work, 'new')
        (work / 'refined').mkdir()
    assert content(other) == {'data': 'mine'}
    assert not (old / 'refined').is_symlink()


def test_the_second_of_two_writers_is_refused(old):
    code = ('import sys; from persem_ros.outputs.results.rundir import building\n'
            f'with building({str(old)!r}, True): pass')
    with building(old, force=True) as work:
        fill(work, 'new')
        second = subprocess.run([sys.executable, '-c', code], cwd=ROOT, capture_output=True,
                                text=True)
    assert 'another run is writing into' in second.stderr
    assert content(old)['map.ply'] == 'new'


def test_folders_that_were_made_for_nothing_go_again(tmp_path):
    with pytest.raises(PersemError):
        with building(tmp_path / 'a' / 'b'):
            raise PersemError('no')
    assert list(tmp_path.iterdir()) == []


def test_the_recording_itself_and_folders_in_it_are_no_place(tmp_path):
    bag = tmp_path / 'bag'
    bag.mkdir()
    (bag / 'x.mcap').write_text('data')
    for out in (bag, bag / 'out', tmp_path / 'bag' / '..' / 'bag'):
        with pytest.raises(PersemError, match='which this run reads, or lies in it'):
            with building(out, force=True, keep=(bag, '')):
                pass
    assert content(bag) == {'x.mcap': 'data'}


def test_a_folder_that_cannot_be_written(tmp_path, monkeypatch):
    def read_only(path, *_, **__):
        raise OSError(30, 'Read-only file system')

    (tmp_path / 'out').mkdir()
    monkeypatch.setattr(rundir.Path, 'mkdir', read_only)
    with pytest.raises(PersemError, match='cannot write to .*out: Read-only file system'):
        with building(tmp_path / 'out'):
            pass


def test_an_extra_file_asks_for_force_and_spares_inputs(tmp_path):
    picture, bag = tmp_path / 'picture.png', tmp_path / 'bag'
    bag.mkdir()
    picture.write_text('precious')
    with pytest.raises(PersemError, match='exists; give another name with --figure, or --force'):
        check_extra(picture, '--figure', False)
    check_extra(picture, '--figure', True)
    for path in (bag / 'x.mcap', bag):
        with pytest.raises(PersemError, match='would replace'):
            check_extra(path, '--figure', True, (bag,))
    with pytest.raises(PersemError, match='is a folder'):
        check_extra(tmp_path, '--figure', True)
