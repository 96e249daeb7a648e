"""The parameters of the method geometry in a map file: one value of its table 'about'."""

from __future__ import annotations

import json
import math
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.kept import sound

KINDS = '<u2', '<i4', '<i8', '<f8'
LONGEST = 1 << 16       # bytes of the list of arrays
Arrays = dict[str, NDArray[Any]]


def to_blob(habits: Arrays, fitted_by: tuple[Any, ...]) -> bytes:
    """Return arrays and what they were fitted by as bytes: a list in JSON, then the arrays."""
    arrays = {name: np.ascontiguousarray(a, a.dtype.newbyteorder('<'))
              for name, a in sorted(habits.items())}
    head = json.dumps({'fitted_by': fitted_by, 'arrays': [
        [name, a.dtype.str, a.shape] for name, a in arrays.items()]}).encode()
    return b''.join([struct.pack('<I', len(head)), head, *(a.tobytes() for a in arrays.values())])


def from_blob(blob: Any) -> tuple[Arrays, tuple[Any, ...]]:
    """Return what to_blob() was given; refuse (ValueError) what it would not have written."""
    try:
        length, = struct.unpack_from('<I', blob)
        if length > LONGEST:
            raise ValueError
        head, at, arrays = json.loads(blob[4:4 + length]), 4 + length, {}
        for name, kind, shape in head['arrays']:
            n = math.prod(shape)
            if kind not in KINDS or not all(type(x) is int and x >= 0 for x in shape) or \
                    n > len(blob):
                raise ValueError
            arrays[str(name)] = np.frombuffer(blob, kind, n, at).reshape(shape).copy()
            at += n * np.dtype(kind).itemsize
        up, *constants = head['fitted_by']
        if at != len(blob) or not sound(arrays) or type(up) is not str or \
                not all(type(x) in (int, float, str) for x in constants):
            raise ValueError
    except (ValueError, TypeError, KeyError, struct.error, RecursionError):
        raise ValueError('parameters of the method geometry') from None
    return arrays, (up, *constants)
