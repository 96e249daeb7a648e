"""The executable `mapper`: what can be said before ROS, numba and the node itself are there."""

from __future__ import annotations

import sys

from persem_ros import ending as process

if sys.argv[:1] and sys.argv[0].rpartition('/')[2] == 'mapper':
    process.handle(process.silently)        # until main() begins

from persem_ros.errors import missing               # noqa: E402
from persem_ros.ros.ending import Ending            # noqa: E402


def main(args: list[str] | None = None) -> int:
    """Run the node until it is asked to end; return the exit status; a process ends with it."""
    ending = Ending(begun=False)
    try:
        from persem_ros.ros import node
    except ImportError as error:
        sys.stderr.write(f'persem_ros: {missing(error)}\n')
        return 1
    status: int = node.main(args, ending)
    if args is None:            # not called by somebody who goes on
        process.leave_deaf(status)
    return status
