"""The depth's unit and kind, told by its numbers and by frames that see one place."""

import numpy as np
from persem_ros.core.transforms import transform
from persem_ros.frames import pinhole
from persem_ros.preflight.depth_fit import about_depth, Seen
from persem_ros.settings.config import Config, updated
import pytest

CAMERA = pinhole(32, 24, 25.0, 25.0, 15.5, 11.5)
LENGTHS = np.sqrt(1.0 + (CAMERA.rays ** 2).sum(-1))
DOWN = (1.0, 0.0, 0.0, 0.0)


def flat(i):
    """Return the depth (24, 32) of flat ground 10.2 m below."""
    return np.full(CAMERA.rays.shape[:2], 10.2)


def hills(i):
    """Return the depth of ground in waves, a tenth of a metre farther along x each frame."""
    depth = flat(i)
    for _ in range(40):     # a fixed point: the depth at which the ray meets the ground
        x, y = i / 10 + CAMERA.rays[..., 0] * depth, -CAMERA.rays[..., 1] * depth
        depth = 10.0 - 1.5 * np.sin(x) * np.cos(y)
    return depth


def said(depth, factor=1.0, settings=(), unit=1.0):
    """Return what is said of a flight of 12 frames."""
    frames = [Seen(depth(i) * factor, CAMERA, transform((i / 10, 0, 10), DOWN))
              for i in range(12)]
    return list(about_depth(frames, updated(Config(), dict(settings)), unit))


@pytest.mark.parametrize('depth', [flat, hills])
def test_metres_along_the_axis_pass(depth):
    assert said(depth) == []
    assert said(lambda i: 1.0 * np.rint(depth(i))) == []      # whole, but near


@pytest.mark.parametrize('factor, unit, flag', [
    (1000.0, 1.0, 'depth.scale=0.001'), (100.0, 1.0, 'depth.scale=0.01'),
    (4.0, 0.001, 'depth.scale=0.00025'), (0.1, 0.001, 'depth.scale=0.01'),
    (5.0, 0.001, 'depth.scale=0.0002'), (2.0, 0.001, 'depth.scale=0.0005'),
    (0.5, 0.001, 'depth.scale=0.002')])
def test_a_unit_with_which_frames_agree_is_proposed(factor, unit, flag):
    sentence, = said(hills, factor, unit=unit)
    assert sentence.endswith(f'--set {flag}') and 'nowhere' in sentence or '%' in sentence


@pytest.mark.parametrize('depth', [flat, hills])
def test_the_kind_with_which_frames_agree_is_proposed(depth):
    sentence, = said(depth, LENGTHS)
    assert sentence.endswith('--set depth.kind=ray')
    sentence, = said(depth, 1.0 / LENGTHS, {'depth.kind': 'ray'})
    assert sentence.endswith('--set depth.kind=z')


@pytest.mark.parametrize('stored, words', [
    (10000.0, ['whole numbers', '--set depth.scale=0.001']),
    (150.0, ['whole numbers', '--set depth.scale=0.001']),
    (10000.5, ['100 % of the depths are beyond', 'millimetres: --set depth.scale=0.001'])])
def test_flat_ground_in_millimetres_is_told_by_its_numbers(stored, words):
    sentence, = said(lambda i: np.full((24, 32), stored))
    assert all(word in sentence for word in words) and 'max_depth=' not in sentence


def test_nothing_is_said_of_nothing():
    assert said(lambda i: np.full((24, 32), np.nan)) == [] == list(about_depth([], Config()))
