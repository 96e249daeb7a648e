"""Map files that somebody tampered with, checksums renewed; and all that may be done to a map."""

from contextlib import closing
import random
import shutil
import sqlite3
import struct

import numpy as np
from persem_ros.core.frame.observe import observe
from persem_ros.core.memory.evict import keep_near
from persem_ros.core.memory.paging import Pager
from persem_ros.core.refine.explain import explain
from persem_ros.core.refine.labelled import label
from persem_ros.core.refine.regions import regions
from persem_ros.core.refine.whole import refine, refine_all
from persem_ros.outputs.export.source import MapSource
from persem_ros.outputs.map import rows, store, tables
from persem_ros.outputs.map.cloud import map_points
from persem_ros.outputs.map.explanation import explanation, of_file
from persem_ros.outputs.map.habits import from_blob, to_blob
from persem_ros.outputs.map.living import LivingMap
from persem_ros.settings.config import Config, METHODS, Refine
from persem_ros.settings.legend import Legend

NUMBERS = (0, 1, -1, 2, 3, 7, 255, 511, 512, 65534, 65535, 65536, 2 ** 28 - 2, 2 ** 28,
           2 ** 31 - 1, 2 ** 31, 2 ** 32 - 1, 2 ** 53, 2 ** 63 - 1, -2 ** 31, -2 ** 63)
FLOATS = (0.0, -0.0, -1.0, 0.5, 1.0, 5e-324, 1e-46, 1e-300, 1e300, 2.0, 1e9, float('inf'),
          float('-inf'), float('nan'))
TEXTS = ('', 'map', '\0', 'a\0b', '\x1b[2J', 'x' * 100_000, '/**:\n  ros__parameters:\n    a: 1\n',
         'classes: []', 'classes:\n- {id: 1, name: a}\n', '&a [*a, *a]', '{' * 5000, '9' * 6000)


def renew(path):
    """Make the checksums of a map file right, as somebody who means harm would."""
    with closing(sqlite3.connect(path)) as db:
        _hurry(db)
        about = dict(db.execute('SELECT name, value FROM about'))
        small = {name: list(db.execute(f'SELECT * FROM {name} ORDER BY {tables.ORDER[name]}'))
                 for name in ('sessions', 'mounts', 'frames', 'classes')}
        if 'frames_crc' in about:
            about['frames_crc'] = rows.crc_of(small['frames'])
        for name, value in (('frames_crc', about.get('frames_crc')),
                            ('crc', rows.crc_of(rows.about_rows(about, small)))):
            db.execute('UPDATE about SET value = ? WHERE name = ?', (value, name))
        place = tables.NAMES['blocks'].index('crc')
        for number, *row in list(db.execute('SELECT rowid, * FROM blocks')):
            crc = rows.crc_of([(*row[:place], *row[place + 1:])])
            db.execute('UPDATE blocks SET crc = ? WHERE rowid = ?', (crc, number))
        db.commit()


def _hurry(db):
    """Have a database that only tests will read written at once, and end endless views."""
    db.executescript('PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF')
    db.set_progress_handler(lambda: 1, 500_000)


def tamper(source, target, seed):
    """Write a map file that differs from *source* in one to three places; return what was done."""
    rng, done = random.Random(seed), []
    shutil.copy(source, target)
    with closing(sqlite3.connect(target)) as db:
        _hurry(db)
        for _ in range(rng.choice((1, 1, 2, 3))):
            act = rng.choice((_column, _column, _column, _about, _cell, _rows, _schema, _shift,
                              _habits))
            try:
                done.append((act.__name__, act(db, rng)))
            except (sqlite3.Error, OverflowError, IndexError, TypeError, ValueError):
                pass        # what SQLite does not let in, or an earlier change took away
        db.commit()
    try:
        renew(target)
    except (sqlite3.Error, TypeError, IndexError, ValueError):
        pass
    return done


def _column(db, rng):
    """Change values inside of a binary column of a block."""
    name, kind = rng.choice(tables.COLUMNS)
    number, data = rng.choice(list(db.execute(f'SELECT rowid, {name} FROM blocks')))
    values = np.frombuffer(data, kind).copy()
    how = rng.choice(('one', 'one', 'all', 'swap', 'longer', 'shorter', 'null', 'text', 'step'))
    new = rng.choice(FLOATS) if 'f' in kind else rng.choice(NUMBERS)
    with np.errstate(all='ignore'):
        new = np.array([new]).astype(np.float64 if 'f' in kind else object)
        new = new.astype(kind) if 'f' in kind else np.array(
            [int(new[0]) % (1 << 8 * np.dtype(kind).itemsize)], 'u8').astype(kind)
    if how == 'one' and len(values):
        values[rng.randrange(len(values))] = new[0]
    elif how == 'all':
        values[:] = new[0]
    elif how == 'swap' and len(values) > 1:
        a, b = rng.sample(range(len(values)), 2)
        values[a], values[b] = values[b], values[a]
    elif how == 'step' and len(values):
        values[rng.randrange(len(values))] += np.dtype(kind).type(1)
    data = values.tobytes()
    data = {'longer': data + new.tobytes(), 'shorter': data[:-1], 'null': None,
            'text': 'text'}.get(how, data)
    db.execute(f'UPDATE blocks SET {name} = ? WHERE rowid = ?', (data, number))
    return name, how, new.tolist()


def _value(rng):
    return rng.choice((rng.choice(NUMBERS[:-2]), rng.choice(FLOATS), rng.choice(TEXTS), None,
                       b'', bytes(24), struct.pack('<3d', 1e308, 0, float('nan'))))


def _about(db, rng):
    """Change or remove an entry of the table about."""
    name = rng.choice([row[0] for row in db.execute('SELECT name FROM about')])
    value = _value(rng)
    if rng.random() < 0.2:
        db.execute('DELETE FROM about WHERE name = ?', (name,))
        return name, 'deleted'
    db.execute('UPDATE about SET value = ? WHERE name = ?', (value, name))
    return name, repr(value)[:40]


def _cell(db, rng):
    """Change a single value of the tables of frames, sessions, mounts, classes and blocks."""
    table = rng.choice(('frames', 'frames', 'sessions', 'mounts', 'classes', 'blocks'))
    name = rng.choice(tables.NAMES[table])
    value, key = _value(rng), 'sensor' if table == 'mounts' else 'rowid'
    which = rng.choice(list(db.execute(f'SELECT {key} FROM {table}')))[0]
    db.execute(f'UPDATE {table} SET {name} = ? WHERE {key} = ?', (value, which))
    return table, name, repr(value)[:40]


def _rows(db, rng):
    """Remove rows, or hold them twice in a table without a key."""
    table = rng.choice(('frames', 'classes', 'blocks'))
    if rng.random() < 0.5:
        db.execute(f'DELETE FROM {table} WHERE rowid IN (SELECT rowid FROM {table} '
                   f'ORDER BY rowid LIMIT {rng.randint(1, 3)})')
        return table, 'deleted'
    db.executescript(f'CREATE TABLE other AS SELECT * FROM {table}; DROP TABLE {table}; '
                     f'ALTER TABLE other RENAME TO {table}; '
                     f'INSERT INTO {table} SELECT * FROM {table};')
    for name, query in (('blocks', 'SELECT count(*) FROM blocks'),
                        ('voxels', 'SELECT sum(voxels) FROM blocks')):
        db.execute(f'UPDATE about SET value = ({query}) WHERE name = ?', (name,))
    return table, 'twice'


def _schema(db, rng):
    """Put a view, a computed column or another table in the place of a table."""
    table = rng.choice(tuple(tables.NAMES))
    columns = ', '.join(tables.NAMES[table])
    how = rng.choice((
        f'CREATE VIEW {table} AS SELECT {columns} FROM was',
        f'CREATE VIEW {table} AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i FROM n) '
        f'SELECT {columns} FROM was, n', f'CREATE TABLE {table} ({columns})', ''))
    db.executescript(f'ALTER TABLE {table} RENAME TO was; {how};')
    return table, how


def _shift(db, rng):
    """Move a block, also to where its neighbours' indices overflow."""
    axis = rng.choice('xyz')
    db.execute(f'UPDATE blocks SET {axis} = ? WHERE rowid IN (SELECT rowid FROM blocks LIMIT 1)',
               (rng.choice(NUMBERS[:-2]),))
    return axis


def _habits(db, rng):
    """Change an array of the parameters of the method geometry, its list kept right."""
    blob = db.execute("SELECT value FROM about WHERE name = 'habits'").fetchone()[0]
    arrays, fitted_by = from_blob(blob)
    name, how = rng.choice(sorted(arrays)), rng.choice(('one', 'all', 'swap', 'longer', 'shorter',
                                                        'none', 'other', 'gone'))
    array, kind = arrays[name], arrays[name].dtype
    with np.errstate(all='ignore'):
        new = np.float64(rng.choice(FLOATS)) if kind.kind == 'f' else np.array(
            rng.choice(NUMBERS) % (1 << 8 * kind.itemsize), 'u8').astype(kind)
    flat = array.reshape(-1)
    if how == 'one' and len(flat):
        flat[rng.randrange(len(flat))] = new
    elif how == 'all':
        flat[:] = new
    elif how == 'swap' and len(flat) > 1:
        a, b = rng.sample(range(len(flat)), 2)
        flat[a], flat[b] = flat[b], flat[a]
    with np.errstate(all='ignore'):
        arrays[name] = {
            'longer': np.concatenate([array, array[-1:]]), 'shorter': array[:-1],
            'none': array[:0], 'other': array.astype('<f8' if kind.kind != 'f' else '<i8'),
            }.get(how, array)
    if how == 'gone':
        del arrays[name]
    db.execute("UPDATE about SET value = ? WHERE name = 'habits'", (to_blob(arrays, fitted_by),))
    return name, how


def exercise(path, again):
    """
    Load a map and do to it all that persem does, and save, load and map on once more.

    Parameters
    ----------
    path, again : Path
        The file, and where the map is saved.

    Raises
    ------
    PersemError
        For a file that is refused; any other exception is a defect.

    """
    stored = store.load(path)
    stored.bounds() if len(stored.saved.cell) else None
    config = stored.config()
    memory = stored.memory()
    columns = memory.voxels()
    assert len(columns['voxel']) == memory.n_voxels == len(stored.saved.cell)
    assert ((columns['confidence'] >= 0) & (columns['confidence'] <= 1.0001)).all()
    seen = set(np.flatnonzero(memory.seen_ids).tolist())
    assert set(columns['label'].tolist()) <= seen
    map_points(columns, memory.voxel_size, stored.legend)
    for method in METHODS:
        labels, _ = label(memory, method, Refine(min_observations=1))
        assert set(labels[columns['number']].tolist()) <= seen, method
    regions(memory)
    if len(columns['voxel']):
        voxel = columns['voxel'][0]
        explanation(of_file(stored), voxel, explain(memory, voxel, config.refine))
    refine(memory, Refine())
    refine(stored.memory(), Refine(method='geometry'), full=False)      # by its parameters
    memory.new_session()
    far = [[0.0, 0.0, 1.0], [0.0, 5.0, 1.0]] + [
        ((voxel + 0.5) * memory.voxel_size).tolist() for voxel in columns['voxel'][:3]]
    for k in range(4):
        memory.add(observe(np.array(far), np.arange(1, len(far) + 1, dtype=np.int32), np.eye(4),
                           memory.voxel_size, stamp=k))
    refine(memory, Refine(), full=False)
    store.save(again, memory, config, stored.legend)
    copy = store.load(again).memory()
    assert (copy.voxels()['label'] == memory.voxels()['label']).all()
    keep_near(memory, (0, 0, 0), 1.0)
    memory.voxels()
    refine(memory, Refine())


def exercise_living(path):
    """
    Attach a map file, page all of it in, map on, write it and page it out.

    Raises
    ------
    PersemError
        For a file that is refused; any other exception is a defect.

    """
    living = LivingMap(path, Config(), Legend)
    try:
        pager = Pager(living.memory(), living)
        memory = pager.memory
        pager.need(living.index())
        seen = observe(np.array([[0.0, 0.0, 1.0], [0.0, 5.0, 1.0]]), np.array([1, 2], np.int32),
                       np.eye(4), memory.voxel_size, stamp=2)
        pager.need_voxels(seen.voxels)
        memory.add(seen)
        columns = memory.voxels()
        assert set(columns['label'].tolist()) <= set(np.flatnonzero(memory.seen_ids).tolist())
        pager.save()
        pager.let_go((0.0, 0.0, 0.0), 2)
        list(refine_all(memory, Refine(min_observations=1), 5))
        pager.save()
    finally:
        living.close()


def export(path):
    """Read a map file a few blocks at a time, as exports do; raises as exercise() does."""
    for columns in MapSource(path).chunks(blocks=2):
        assert len(columns['voxel']) == len(columns['label'])
