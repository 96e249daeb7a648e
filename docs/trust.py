"""
Does anything in a map tell where the method geometry loses? Candidates, beside gain and loss.

    python docs/trust.py sim:SEED:DIFFICULTY[:CLASS-OTHER-SHARE[:wall|roof]] … RECORDING …

A simulated scene is 60 frames of 320 x 240; of a CLASS its segmenter calls a SHARE of the pixels
OTHER, everywhere or on what is steep (wall) or level (roof). A recording has truth; --ignore 0,255
names ids that count for nothing. One row a scene: the table of docs/results.md.

"""

import argparse
from dataclasses import replace

import numpy as np
from persem_ros.core.frame.images import backprojected
from persem_ros.core.frame.render import render, voxel_image
from persem_ros.core.geometry.method import relabel
from persem_ros.core.geometry.votes import take_votes
from persem_ros.core.memory.pools import ranges
from persem_ros.core.refine.labelled import label
from persem_ros.core.refine.snapshot import take
from persem_ros.pipeline import Pipeline
from persem_ros.preflight.look import opened
from persem_ros.settings.config import Config
from persem_ros.simulate.flight import Flight, Plan

FEW = 0.005     # classes with less of the map are not looked at


def main():
    """Print a row a scene."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('scenes', nargs='+')
    parser.add_argument('--ignore', default='65535')
    args = parser.parse_args()
    ignored = [int(c) for c in args.ignore.split(',')]
    config = replace(Config(), memory=replace(Config().memory, ignore_labels=ignored))
    print('| scene | PA | mIoU | most lost | changed | votes for what it was | one direction | '
          'halves agree | held-out votes |\n|---|---|---|---|---|---|---|---|---|')
    for scene in args.scenes:
        if scene.startswith('sim:'):
            print(row(scene, simulated(scene), Config()), flush=True)
            continue
        with opened(scene, config, True) as recording:
            print(row(scene, recording.frames(truth=True), recording.config), flush=True)


def simulated(scene):
    """Yield the frames of a simulated scene."""
    _, seed, difficulty, *habit = scene.split(':')
    plan = Plan(frames=60, width=320, height=240, seed=int(seed), rate=2.5)
    plan = replace(plan, mistakes=replace(plan.mistakes, difficulty=float(difficulty)))
    rng = np.random.default_rng(int(seed))
    for frame in Flight(plan, workers=1).frames():
        if habit:
            c, other, share = habit[0].split('-')
            where = (frame.truth == int(c)) & (rng.random(frame.truth.shape) < float(share))
            if len(habit) > 1:
                where &= (steepness(frame) < 0.5) == (habit[1] == 'wall')
            frame = replace(frame, labels=np.where(where, int(other), frame.labels).astype('i4'))
        yield frame


def steepness(frame):
    """Return |z of the normal| of each pixel's surface."""
    points = backprojected(frame, Config().memory) @ frame.T_map_camera[:3, :3].T
    points = points.reshape(*frame.truth.shape, 3)
    normal = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
    return np.abs(normal[..., 2]) / np.maximum(np.linalg.norm(normal, axis=-1), 1e-12)


def row(scene, frames, config):
    """Return the row of a scene."""
    whole, halves, seen = Pipeline(config), (Pipeline(config), Pipeline(config)), []
    for n, frame in enumerate(frames):
        observations = whole.add(frame)
        halves[n % 2].memory.add(observations)
        seen.append((frame, observations))
    memory, settings = whole.memory, replace(config.refine, method='geometry')
    taken = take(memory)
    found, before = relabel(memory, taken, settings), taken.majority
    changed = found.labels != before
    (pa, iou), (other_pa, other_iou) = (
        measured(memory, seen, taken.number, labels, config) for labels in (before, found.labels))
    c, other, share = most_lost(before, found.labels)
    votes = take_votes(memory, taken, settings.geometry.directions)
    own = np.array([s[votes.classes[p] == b].sum() for p, s, b in zip(*(
        np.split(a[:votes.start[-1]], votes.start[1:-1]) for a in (votes.place, votes.share)),
        before)])
    single = votes.total < 1.5
    agree = [agreement([p.memory for p in halves], name, settings)
             for name in ('majority', 'geometry')]
    return (f'| {scene} | {pa:.2f} {other_pa - pa:+.2f} | {iou:.2f} {other_iou - iou:+.2f} | '
            f'{share:.0%} of {c} to {other} | {changed.mean():.1%} | {own[changed].mean():.2f} | '
            f'{single[changed].mean():.0%} of {single.mean():.0%} | '
            f'{agree[0]:.1f} {agree[1] - agree[0]:+.1f} | '
            f'{held_out(*(p.memory for p in halves), settings):+.4f} |')


def measured(memory, seen, number, labels, config):
    """Return PA and mIoU of voxels' labels, over the pixels with a label, a truth and a voxel."""
    by_number = np.zeros(memory.n_numbers, np.uint16)
    by_number[number] = labels
    counts = np.zeros((256, 256), np.int64)
    for frame, observations in seen:
        voxels = voxel_image(memory, observations, frame.depth.shape)
        valid = (voxels >= 0) & (frame.labels >= 0) & (frame.truth >= 0) & ~np.isin(
            frame.truth, config.memory.ignore_labels)
        np.add.at(counts, (frame.truth[valid], render(voxels, by_number)[valid] & 255), 1)
    right, true = np.diag(counts), counts.sum(axis=1)
    union = np.maximum(true + counts.sum(axis=0) - right, 1)
    return 100 * right.sum() / true.sum(), 100 * (right / union)[true > 0].mean()


def most_lost(before, after):
    """Return (class, other class, share): which class lost most of its voxels to one other."""
    found = (0, 0, 0.0)
    for c in np.flatnonzero(np.bincount(before) > FEW * len(before)):
        became = np.bincount(after[before == c], minlength=int(c) + 1)
        whole, became[c] = became.sum(), 0
        found = max(found, (int(c), int(became.argmax()), became.max() / whole),
                    key=lambda one: one[2])
    return found


def held_out(first, second, settings):
    """
    Return how much better geometry's labels foretell the other half's votes than majority's do.

    Labels of the first half of the frames, and the confusions that they imply with the votes of
    that half, give every vote of the second half a probability: mean difference of its logarithm,
    nats a look.

    """
    taken, other = take(first), take(second)
    own, theirs = (take_votes(m, t, settings.geometry.directions)
                   for m, t in ((first, taken), (second, other)))
    at = second.find(taken.index)
    row = np.where(at >= 0, other.row[np.maximum(at, 0)].astype(np.int64) - 1, -1)
    said, to_say = dense(own, len(own.count)), dense(theirs, len(theirs.count))
    both, found = row >= 0, []
    for labels in (relabel(first, taken, settings).labels, taken.majority):
        confusion = np.ones((256, 1)) * said.mean(axis=0)      # one look's worth of the mean
        np.add.at(confusion, labels, said)
        chance = confusion / confusion.sum(axis=1, keepdims=True)
        looks = to_say[row[both]]
        found.append((looks * np.log(chance[labels[both]] + 1e-6)).sum() / looks.sum())
    return found[0] - found[1]


def dense(votes, n):
    """Return the votes as an array (n, 256) by class id."""
    full = np.zeros((n, 256))
    rows = np.repeat(np.arange(n), votes.count)
    entries = ranges(votes.start[:-1], votes.count.astype(np.int64))
    np.add.at(full, (rows, votes.classes[votes.place[entries]]), votes.share[entries])
    return full


def agreement(memories, method, settings):
    """Return the percentage of common voxels that two halves of the frames label alike."""
    first, second = (label(memory, method, settings)[0] for memory in memories)
    columns = memories[0].voxels()
    there = memories[1].find(columns['voxel'])
    both = there >= 0
    return 100 * (first[columns['number'][both]] == second[there[both]]).mean()


if __name__ == '__main__':
    main()
