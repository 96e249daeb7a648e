"""What is freed goes back to the system where a stage ends, and the warm-up keeps nothing."""

import gc
import subprocess
import sys

from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.warmup import _mapped, _refined
import pytest

SCRIPT = """
import numpy as np
from persem_ros.core.jit import give_back, keep_memory

def resident():
    with open('/proc/self/statm') as file:
        return int(file.read().split()[1])

keep_memory()
before = resident()
images = [np.ones(1 << 20, np.uint8) for _ in range(64)]
held = resident() - before
del images
kept = resident() - before
give_back()
print(held, kept, resident() - before)
"""


@pytest.mark.skipif(not sys.platform.startswith('linux'), reason='glibc keeps, Linux tells')
def test_freed_memory_is_kept_for_the_next_frame_until_it_is_given_back():
    done = subprocess.run([sys.executable, '-c', SCRIPT], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    held, kept, left = map(int, done.stdout.split())
    assert kept > 0.9 * held and left < 0.2 * held


def test_the_warm_up_leaves_no_map_behind():
    _refined(_mapped())
    gc.collect()
    gc.disable()        # what it leaves is frozen before anything collects it
    try:
        before = maps()
        _refined(_mapped())
        assert maps() == before
    finally:
        gc.enable()


def maps():
    """Return the number of maps in memory."""
    return sum(isinstance(thing, VoxelMemory) for thing in gc.get_objects())
