"""Columns of voxels, made of the rows of a map file's blocks and checked."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.pools import SIDE
from persem_ros.outputs.map.rows import columns_of

Columns = dict[str, NDArray[Any]]


def decoded(rows: list[Any], first: bool) -> Columns:
    """Return the columns of all voxels of some blocks; ValueError for damaged ones."""
    raw = columns_of(rows, first)
    count = np.array([row[3] for row in rows], np.int64)
    n = len(raw['cell'])
    start, history = (np.concatenate([[0], np.cumsum(raw[f'{name}_count'], dtype=np.int64)])
                      for name in ('evidence', 'history'))
    newest = raw['history_t' if first else 'history_frame']
    if count.sum() != n or raw['cell'].max(initial=0) >= SIDE ** 3 or \
            start[-1] != len(raw['evidence_class']) or len(raw['evidence_sum']) != start[-1] or \
            history[-1] != len(newest) or not (np.diff(history) > 0).all() or \
            any(len(raw[name]) != n for name in ('observations', 'switches', 'label',
                                                 'majority', 'source')):
        raise ValueError('length of a column')
    cell = raw['cell'].astype(np.int32)
    corner = np.repeat(np.array([row[:3] for row in rows], np.int64).reshape(-1, 3) * SIDE,
                       count, axis=0)
    if (np.abs(corner) >= 2 ** 31 - 2 * SIDE).any():
        raise ValueError('place of a block')
    voxel = corner.astype(np.int32) + np.stack([cell >> 6, cell >> 3 & 7, cell & 7], axis=1)
    owner = np.repeat(np.arange(n), np.diff(start))
    total = np.bincount(owner, raw['evidence_sum'], n)
    if not (total > 0).all() or not np.isfinite(total).all():
        raise ValueError('evidence')
    share = raw['evidence_sum'] / total[owner]
    own = np.bincount(owner, np.where(raw['evidence_class'] == raw['label'][owner], share, 0), n)
    posterior = np.zeros(n, np.float32) if first else raw['posterior']
    return {'voxel': voxel, 'label': raw['label'], 'majority': raw['majority'],
            'confidence': np.where(posterior > 0, posterior, own).astype(np.float32),
            'observations': raw['observations'], 'switches': raw['switches'],
            'source': raw['source'],
            'gone': np.zeros(n, np.uint8) if first else raw['gone'],
            'first_seen': newest[history[:-1]], 'last_seen': newest[history[1:] - 1],
            'start': start, 'classes': raw['evidence_class'],
            'probabilities': share.astype(np.float32)}


def kept(columns: Columns, keep: NDArray[np.bool_]) -> Columns:
    """Return the columns of some of the voxels."""
    length = np.diff(columns['start'])
    entries = np.repeat(keep, length)
    result = {name: column[keep] for name, column in columns.items()
              if name not in ('start', 'classes', 'probabilities')}
    result['start'] = np.concatenate([[0], np.cumsum(length[keep])])
    for name in ('classes', 'probabilities'):
        result[name] = columns[name][entries]
    return result
