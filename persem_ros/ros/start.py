"""The executable `mapper`: what can be said before ROS, numba and the node itself are there."""

import sys

from persem_ros.errors import missing
from persem_ros.ros.ending import Ending

INTERRUPTED = 130


def main(args: list[str] | None = None) -> int:
    """Run the node until it is asked to end; return the exit status."""
    ending = Ending()
    try:
        from persem_ros.ros import node
    except KeyboardInterrupt:
        ending.over()
        return INTERRUPTED
    except ImportError as error:
        if ending.wanted:           # an import that the signal broke
            return INTERRUPTED
        sys.stderr.write(f'persem_ros: {missing(error)}\n')
        return 1
    return node.main(args, ending)
