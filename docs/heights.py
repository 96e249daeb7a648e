"""
What the method geometry gains by heights above the ground that classes keep to, and where.

    python docs/heights.py --legend FILE [--ignore 0,255] SCENE ...

A SCENE is one of docs/trust.py, a simulated one or a recording with truth; FILE gives classes a
`height`. One row a scene: PA and mIoU of majority, what geometry and geometry with these heights
are ahead of it, and of which classes a replay says that votes contradict the heights: the share of
a class's voxels that lie out of them, and that of these which keep the name; of none: the largest.

"""

import argparse
from dataclasses import replace

from persem_ros.core.geometry.method import relabel
from persem_ros.core.geometry.overruled import FEW, overruled, SOME
from persem_ros.core.refine.snapshot import take
from persem_ros.pipeline import Pipeline
from persem_ros.preflight.look import opened
from persem_ros.settings.config import Config
from persem_ros.settings.heights import hinted
from persem_ros.settings.legend_files import load_legend
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
    print('| scene | majority | geometry | with heights | said |\n|---|---|---|---|---|')
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
    columns = {'voxel': taken.index, 'majority': taken.majority, 'label': found.labels}
    cells.append(said(overruled(columns, known.refine), legend))
    return f'| {scene} | ' + ' | '.join(cells) + ' |'


def said(rows, legend):
    """Return which of some Overruled are said, with their shares."""
    told = [f'{legend.name(one.label)} {one.out / one.voxels:.2f} {one.kept / one.out:.2f}'
            for one in rows if one.doubtful]
    some = [one for one in rows if one.out >= max(FEW, SOME * one.voxels)]
    most = [max(shares, default=0.0) for shares in (
        [one.out / one.voxels for one in some], [one.kept / one.out for one in some])]
    return ', '.join(told) or 'nothing: {:.2f} {:.2f}'.format(*most)


if __name__ == '__main__':
    main()
