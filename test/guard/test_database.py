"""Databases that mean harm: plain tables of the expected columns, bounded by the file's size."""

from contextlib import closing
import sqlite3

from persem_ros.guard import database
from persem_ros.guard.database import (
    check_beside, check_declared, check_tables, checked, opened, SUPER, Unsafe)
import pytest


@pytest.fixture
def path(tmp_path):
    """Return the path of a database with one plain table."""
    with closing(sqlite3.connect(tmp_path / 'a.db')) as db:
        db.executescript('CREATE TABLE t (a, b); INSERT INTO t VALUES (1, zeroblob(1))')
    return tmp_path / 'a.db'


@pytest.mark.parametrize('script', [
    'CREATE VIEW u AS SELECT a, b FROM t', 'CREATE TABLE u (a, b AS (a + 1))',
    'CREATE TABLE u (a, c)', 'CREATE TABLE v (a, b)', 'CREATE VIRTUAL TABLE u USING fts5(a, b)'])
def test_what_is_no_plain_table_of_these_columns(path, script):
    with closing(sqlite3.connect(path)) as db:
        db.executescript(script)
    with closing(opened(path)) as db, pytest.raises(Unsafe):
        check_tables(db, {'u': ('a', 'b')})


def test_a_plain_table(path):
    with closing(opened(path)) as db:
        check_tables(db, {'t': ('a', 'b')})
        rows = db.execute('SELECT * FROM t')
        assert list(checked(rows, (int, bytes), 100)) == [(1, b'\0')]


def test_an_endless_query_ends(path, monkeypatch):
    monkeypatch.setattr(database, 'STEPS', 1_000_000)
    with closing(opened(path)) as db, pytest.raises(sqlite3.OperationalError, match='interrupt'):
        db.execute('WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i FROM n) '
                   'SELECT count(*) FROM n').fetchone()


@pytest.mark.parametrize('row', [(None, b''), ('1', b''), (1, 'x'), (1, None)])
def test_values_of_other_types(row):
    with pytest.raises(Unsafe, match='in the place of'):
        list(checked([row], (int, bytes), 100))


def test_more_than_the_file_has_room_for():
    with pytest.raises(Unsafe, match='room'):
        list(checked([(1, bytes(60))] * 2, (int, bytes), 100))


@pytest.mark.parametrize('script', [
    'CREATE TRIGGER g AFTER INSERT ON t BEGIN DELETE FROM t; END',
    'CREATE INDEX g ON t (hex(zeroblob(100000000)))', 'CREATE TABLE u (a)',
    'DROP TABLE t; CREATE TABLE t (a, b CHECK (length(hex(zeroblob(9))) > 0))',
    'DROP TABLE t; CREATE TABLE t (a, b DEFAULT (random()))', 'DROP TABLE t'])
def test_what_would_run_when_rows_are_written(path, script):
    with closing(sqlite3.connect(path)) as db:
        check_declared(db, 'CREATE TABLE t\n   (a, b);\n')
        db.executescript(script)
        with pytest.raises(Unsafe, match='declared otherwise'):
            check_declared(db, 'CREATE TABLE t (a, b);')


@pytest.mark.parametrize('suffix', ['-wal', '-shm', '-journal'])
def test_a_link_beside_a_database_is_not_followed(path, tmp_path, suffix):
    check_beside(path)
    path.with_name(path.name + suffix).symlink_to(tmp_path / 'mine')
    with pytest.raises(Unsafe, match=f'a.db{suffix} is a link'):
        check_beside(path)


def test_a_journal_that_would_have_another_file_deleted(path):
    journal = path.with_name('a.db-journal')
    journal.write_bytes(bytes(1000))
    check_beside(path)
    journal.write_bytes(bytes(1000) + b'/home/me/mine' + bytes(8) + SUPER)
    with pytest.raises(Unsafe, match='names other files'):
        check_beside(path)
