"""
What the look before mapping costs: python benchmarks/preflight.py RECORDING.

Prints the processor time of opening, of the pass over all heads and of the checks, the least of
five, seconds; imports are not counted, they are a replay's anyway.

"""

import sys
import time

from persem_ros.inputs.recording.source import Source
from persem_ros.inputs.recording.topics import Choice
from persem_ros.preflight import recorded
from persem_ros.preflight.look import look
from persem_ros.settings.config import Config


def looked(path):
    """Return the processor time of each part, seconds, and how many label images there are."""
    times = [time.process_time()]
    with Source(path) as source:
        times.append(time.process_time())
        sample = recorded.sample(source, Choice(source, Config()), Config())
        times.append(time.process_time())
        look(sample)
        times.append(time.process_time())
    return [b - a for a, b in zip(times, times[1:])], len(sample.views[0].stamps['labels'])


def main():
    """Print a line."""
    runs = [looked(sys.argv[1]) for _ in range(5)]
    opening, heads, checks = min((times for times, _ in runs), key=sum)
    print(f'{runs[0][1]} frames: {opening + heads + checks:.2f} s (open {opening:.2f}, heads '
          f'{heads:.2f}, checks {checks:.2f})')


if __name__ == '__main__':
    main()
