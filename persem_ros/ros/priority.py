"""How much of the processor a thread of the node takes: those beside the mapping stand back."""

from contextlib import suppress
import os
import threading

from persem_ros.core.jit import work_alone

NICE = 10       # above the priority of the process, where 19 is least


def stand_back() -> None:
    """Let this thread use one core, and that only where mapping does not need it."""
    work_alone()
    with suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)    # of this thread
