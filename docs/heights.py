"""
What the method geometry gains by heights above the ground that classes keep to, and where.

    python docs/heights.py --legend FILE [--ignore 0,255] SCENE ...

A SCENE is one of docs/trust.py, a simulated one or a recording with truth; FILE gives classes a
`height`. One row a scene: PA and mIoU of majority, and what geometry and geometry with these
heights are ahead of it.

"""

import argparse
from dataclasses import replace

from persem_ros.core.geometry.method import relabel
from persem_ros.core.refine.snapshot import take
from persem_ros.pipeline import Pipeline
from persem_ros.preflight.look import opened
from persem_ros.settings.config import Config
from persem_ros.settings.heights import hinted
from persem_ros.settings.legend import load_legend
from trust import measured, simulated


def main():
    """Print a row a scene."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('scenes', nargs='+')
    parser.add_argument('--legend', required=True)
    parser.add_argument('--ignore', default='255,65535')
    args = parser.parse_args()
    ignored = [int(c) for c in args.ignore.split(',')]
    config = replace(Config(), memory=replace(Config().memory, ignore_labels=ignored))
    legend = load_legend(args.legend)
    print('| scene | majority | geometry | with heights |\n|---|---|---|---|')
    for scene in args.scenes:
        if scene.startswith('sim:'):
            print(row(scene, simulated(scene), config, legend), flush=True)
            continue
        with opened(scene, config, True) as recording:
            print(row(scene, recording.frames(truth=True), recording.config, legend), flush=True)


def row(scene, frames, config, legend):
    """Return the row of a scene."""
    pipeline = Pipeline(config)
    seen = [(frame, pipeline.add(frame)) for frame in frames]
    memory = pipeline.memory
    taken = take(memory)
    pa, iou = measured(memory, seen, taken.number, taken.majority, config)
    cells = [f'{pa:.2f} {iou:.2f}']
    for known in (config, hinted(config, legend)):
        found = relabel(memory, taken, replace(known.refine, method='geometry'))
        other_pa, other_iou = measured(memory, seen, taken.number, found.labels, config)
        cells.append(f'{other_pa - pa:+.2f} {other_iou - iou:+.2f}')
    return f'| {scene} | ' + ' | '.join(cells) + ' |'


if __name__ == '__main__':
    main()
