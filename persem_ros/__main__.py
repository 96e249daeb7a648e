"""Run the command line as python -m persem_ros."""

import sys

from persem_ros.cli import main

if __name__ == '__main__':
    sys.exit(main())
