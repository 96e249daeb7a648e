"""
How soon is the method geometry good? Accuracy over the time of a flight, while it is mapped.

    python docs/causal.py RECORDING [--set NAME=VALUE …]

Replays as a node maps (--causal: refined once a second by kept parameters, which sweeps estimate
anew) and prints a row a stretch of the flight: what was right, in percent of the valid pixels, as
published at that moment, and with the parameters that the whole flight gives.

"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from persem_ros.replay import replay
from persem_ros.settings.config import updated
from persem_ros.settings.config_file import from_args

METHODS = 'majority', 'geometry'
STRETCHES = 10


class Accuracy:
    """A watcher that notes the share of right pixels of every frame."""

    def __init__(self):
        self.stamps, self.right = [], []

    def frame(self, replay, frame, rendering):
        """Count a frame."""
        valid = rendering.valid & (rendering.truth >= 0)
        self.stamps.append(frame.stamp)
        self.right.append([(image[valid] == rendering.truth[valid]).mean() if valid.any()
                           else np.nan for image in map(rendering.images.get, METHODS)])

    def finish(self, replay, result):
        """Do nothing."""


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('recording', type=Path)
    parser.add_argument('--set', action='append', default=[], dest='items', metavar='NAME=VALUE')
    args = parser.parse_args()
    config = updated(from_args(set_items=args.items), {'refine.method': 'geometry'})
    found = []
    for causal in (True, False):
        watcher = Accuracy()
        with TemporaryDirectory() as folder:
            replay([args.recording], Path(folder, 'out'), config, METHODS, causal,
                   watchers=[watcher], report=False)
        found.append(watcher)
    live, whole = (100 * np.array(one.right) for one in found)
    seconds = (np.array(found[0].stamps) - found[0].stamps[0]) / 1e9
    print('| seconds of flight | majority, live | geometry, live | majority, whole flight | '
          'geometry, whole flight |\n|---|---:|---:|---:|---:|')
    for part in np.array_split(np.arange(len(seconds)), STRETCHES):
        print(f'| {seconds[part[0]]:.0f} to {seconds[part[-1]]:.0f} | ' + ' | '.join(
            f'{value:.2f}' for value in [*np.nanmean(live[part], axis=0),
                                         *np.nanmean(whole[part], axis=0)]) + ' |')


if __name__ == '__main__':
    main()
