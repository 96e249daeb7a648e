"""Asking for records ahead: for kernels alone, and no harm where there are none."""

import mmap

from numba.core.errors import TypingError
import numpy as np
from persem_ros.core.jit import inlined
from persem_ros.core.prefetch import prefetch
import pytest

RECORD = np.dtype([('a', 'i8'), ('b', 'u4', 15)])
NOWHERE = (-1, 4, -10 ** 6, 10 ** 9, 2 ** 62, -2 ** 63, 2 ** 63 - 1)


@inlined
def asked(records, rows, offset):
    """Ask for some records; return how many rows there were."""
    n = 0
    for row in rows:
        prefetch(records, row, offset)
        n += 1
    return n


@pytest.mark.parametrize('offset', [0, 8, -5, 2 ** 40])
def test_records_that_are_not_there_do_no_harm(offset):
    own = np.zeros(4, RECORD)
    mapped = np.frombuffer(mmap.mmap(-1, mmap.PAGESIZE), RECORD, 4)     # nothing lies before it
    for records in own, mapped:
        for kind in np.int64, np.int32, np.uint32:
            rows = np.array([0, 3, *NOWHERE]).astype(kind)
            assert asked(records, rows, offset) == len(rows)
        assert not records.view(np.uint8).any()


def test_the_machine_is_told_to_fetch():
    asked(np.zeros(4, RECORD), np.zeros(1, np.int64), 0)
    assert 'llvm.prefetch' in asked.inspect_llvm(asked.signatures[0])


@pytest.mark.parametrize('records', [
    np.zeros(8), np.zeros(8, RECORD)[::2], np.zeros((2, 2), RECORD)])
def test_what_is_no_row_of_records_is_refused(records):
    with pytest.raises(TypingError, match='prefetch'):
        asked(records, np.zeros(1, np.int64), 0)
