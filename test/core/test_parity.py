"""Measures against scikit-learn's and the plain definition, as a printed table (pytest -s)."""

import os
from pathlib import Path

import numpy as np
from persem_ros.core.refine.regions import REGIONS, regions
from persem_ros.evaluate.work.sequence import evaluate_sequence
from persem_ros.evaluate.work.task import ALL_METHODS, Task
from persem_ros.inputs.recording.recording import Recording
from persem_ros.pipeline import Pipeline
from persem_ros.rendering import Renderer
from persem_ros.settings.config import Config, updated
import pytest
import reference
import worlds

# A recording of a real flight, with truth, for those who have one.
REAL = os.environ.get('PERSEM_TEST_RECORDING', '')


def frames_of(path, config, methods):
    """Return per frame: valid mask, truth, {method: labels}, region codes; all images (h, w)."""
    pipeline, frames = Pipeline(config), []
    with Recording(path, config) as recording:
        for frame in recording.frames():
            pipeline.add(frame)
        pipeline.refine()
        renderer = Renderer(pipeline, methods)
        renderer.relabel()
        codes = regions(pipeline.memory)[0]
        for frame in recording.frames(truth=True):
            r = renderer.render(frame)
            at = np.where(r.voxels >= 0, codes[r.voxels], 0)
            frames.append((
                r.valid, r.truth, {m: i.astype(np.int32) for m, i in r.images.items()}, at))
    return frames


def theirs(frames, method, bit=None):
    """Return accuracy and mean IoU by scikit-learn, in percent, and its confusion matrix."""
    # Here, for it takes as long to load as some hundred tests, and all processes read this file.
    from sklearn.metrics import accuracy_score, confusion_matrix, jaccard_score
    inside = [f[0] & (f[3] & bit != 0 if bit else True) for f in frames]
    truth = np.concatenate([f[1][w] for f, w in zip(frames, inside)])
    found = np.concatenate([f[2][method][w] for f, w in zip(frames, inside)])
    labels = np.unique(truth)
    every = np.union1d(truth, found)
    return (100 * accuracy_score(truth, found), 100 * jaccard_score(
        truth, found, labels=labels, average='macro', zero_division=0.0),
        every, confusion_matrix(truth, found, labels=every))


def held(path, config, methods=ALL_METHODS, places=REGIONS):
    """Compare all methods of a recording; print the table and return the largest difference."""
    frames = frames_of(path, config, methods)
    summary, arrays = evaluate_sequence(Task(str(path), config, methods, pictures=False))
    rows = []
    for m, method in enumerate(methods):
        for region, bit in ((None, None), *places.items()):
            place = summary['regions'][region or 'all']['methods'][method]
            accuracy, miou, every, matrix = theirs(frames, method, bit)
            rows += [(f'{method} {region or ""} accuracy', place['pixel_accuracy'], accuracy),
                     (f'{method} {region or ""} mIoU', place['miou'], miou)]
            if region is None:
                order = [arrays['ids'].tolist().index(i) for i in every]
                ours = arrays['matrix'][m][np.ix_(order, order)]
                rows.append((f'{method} confusion, pixels apart', np.abs(ours - matrix).sum(), 0))
        plain = reference.flicker([f[2][method].ravel().tolist() for f in frames],
                                  [f[0].ravel().tolist() for f in frames])
        rows.append((f'{method} flicker', summary['methods'][method]['flicker'], plain))
    print(f'\n{"metric":<44}{"ours":>14}{"theirs":>14}{"difference":>12}')
    for name, ours, other in rows:
        print(f'{name:<44}{ours:>14.8f}{other:>14.8f}{ours - other:>12.1e}')
    return max(abs(ours - other) for _, ours, other in rows)


@pytest.mark.parametrize('seed', [0, 1])
def test_random_frames(tmp_path, seed):
    path = worlds.write(tmp_path / 'wall', frames=8, seed=seed)
    config = updated(Config(), {'memory.voxel_size': 0.15,
                                'memory.dynamic_labels': (worlds.MOVING,)})
    assert held(path, config) < 1e-9


@pytest.mark.skipif(not Path(REAL).exists() or not REAL, reason='PERSEM_TEST_RECORDING not set')
def test_real_frames():
    assert held(REAL, Config(), ('raw2d', 'persem'), {}) < 1e-9
