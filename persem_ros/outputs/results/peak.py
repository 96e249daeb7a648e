"""Peak memory of a stretch of work, not of the whole life of the process."""

from __future__ import annotations

from pathlib import Path
import resource

CLEAR, STATUS = Path('/proc/self/clear_refs'), Path('/proc/self/status')


class PeakMemory:
    """
    The most memory that the process held since the block began.

    Where the system does not let the mark be reset (anything but Linux), since its start.

    """

    def __enter__(self) -> PeakMemory:
        """Reset the high-water mark."""
        try:
            CLEAR.write_text('5')
        except OSError:
            pass
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the mark as it is."""

    def bytes(self) -> int:    # noqa: A003 - a unit, not the type
        """Return the high-water mark of the resident set."""
        try:
            # Not ru_maxrss where it can be helped: a child inherits its parent's mark.
            line = next(x for x in STATUS.read_text().splitlines() if x.startswith('VmHWM'))
            return 1024 * int(line.split()[1])
        except (OSError, StopIteration, ValueError):
            return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
