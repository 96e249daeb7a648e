"""Databases that mean harm: plain tables of the expected columns, bounded by the file's size."""

from contextlib import closing
import sqlite3

from persem_ros.guard import database
from persem_ros.guard.database import check_tables, checked, opened, Unsafe
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
