"""Recordings for the evaluation's tests: a wall of two classes, seen with mistakes and truth."""

import bags
import numpy as np

from persem_ros.outputs.recording.writer import RecordingWriter

MOVING = 9


def truth(i, shape=(bags.HEIGHT, bags.WIDTH)):
    """Return the true ids of frame *i*, (H, W) uint16: two halves, a moving thing, a hole."""
    image = np.where(np.arange(shape[1]) + i < 12, 3, 7) * np.ones((shape[0], 1), np.int64)
    image[2:4, i % shape[1]] = MOVING
    image[-1, :3] = 255
    return image.astype(np.uint16)


def labels(i, seed=0):
    """Return the input labels of frame *i*: the truth, a fifth of it mistaken."""
    rng = np.random.default_rng((seed, i))
    image = truth(i)
    wrong = (rng.random(image.shape) < 0.2) & (image != MOVING)
    image[wrong] = rng.choice((1, 3, 7, 255), np.count_nonzero(wrong))
    return image


def write(path, frames=12, seed=0, with_truth=True, legend='', truth_scale=1):
    """Write a recording of *frames* frames; with_truth may be a function of the frame."""
    has = with_truth if callable(with_truth) else lambda i: with_truth
    rng = np.random.default_rng(seed)
    with RecordingWriter(path) as out:
        if legend:
            out.text('semantic/legend', legend, latched=True)
        for i in range(frames):
            out.pose('pose', bags.stamp(i - 0.5), 'map', bags.pose(i - 0.5))
            depth = bags.depth(i)
            depth[rng.random(depth.shape) < 0.05] = np.nan
            at = bags.stamp(i)
            out.camera_info('depth/camera_info', at, 'camera', bags.WIDTH, bags.HEIGHT, bags.K)
            if has(i):
                image = truth(i).repeat(truth_scale, axis=0).repeat(truth_scale, axis=1)
                out.image('semantic/truth', at, 'camera', image, 'mono16')
            out.image('depth/image', at, 'camera', depth, '32FC1')
            out.image('semantic/image', at, 'camera', labels(i, seed), 'mono16')
        out.pose('pose', bags.stamp(frames - 0.5), 'map', bags.pose(frames - 0.5))
    return path
