"""
A segmentation network in the loop: colour images -> ONNX Runtime -> label images -> memory.

The network is as small as one can be, a 1 x 1 convolution that this script makes itself, and it
is right in good light only. Put your own model in its place: whatever gives an (H, W) array of
class ids. Needs: pip install onnx onnxruntime

"""

import numpy as np
import onnx
from onnx import helper, TensorProto
import onnxruntime
from persem_ros.frames import Frame, pinhole
from persem_ros.pipeline import Pipeline
from persem_ros.settings.config import Config, updated

COLORS = np.array([[0.3, 0.3, 0.35], [0.2, 0.6, 0.2], [0.7, 0.3, 0.2]])     # road, grass, roof
FIRST = 1               # id of the first class
rng = np.random.default_rng(0)


def network():
    """Return a model that names the class whose colour is nearest: W x + b, then ArgMax."""
    weight = (2 * COLORS)[:, :, None, None].astype(np.float32)
    bias = -(COLORS ** 2).sum(axis=1).astype(np.float32)
    graph = helper.make_graph(
        [helper.make_node('Conv', ['image', 'weight', 'bias'], ['scores']),
         helper.make_node('ArgMax', ['scores'], ['classes'], axis=1, keepdims=0)],
        'segmenter',
        [helper.make_tensor_value_info('image', TensorProto.FLOAT, [1, 3, 'height', 'width'])],
        [helper.make_tensor_value_info('classes', TensorProto.INT64, [1, 'height', 'width'])],
        [onnx.numpy_helper.from_array(weight, 'weight'),
         onnx.numpy_helper.from_array(bias, 'bias')])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid('', 13)], ir_version=8)
    onnx.checker.check_model(model)
    return onnxruntime.InferenceSession(model.SerializeToString(),
                                        providers=['CPUExecutionProvider'])


def ground(x, y):
    """Return the true class at points of the ground: a road through grass, and roofs."""
    roofs = (np.floor(x / 6) + np.floor(y / 6)) % 3 == 0
    return np.where(np.abs(y) < 1.5, FIRST, np.where(roofs, FIRST + 2, FIRST + 1))


session = network()
camera = pinhole(width=160, height=120, fx=110.0, fy=110.0, cx=79.5, cy=59.5)
pipeline = Pipeline(updated(Config(), {'memory.voxel_size': 0.25}))
R = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]])     # the camera looks down
depth = np.full((120, 160), 12.0)
frames, before = [], []

for i in range(25):
    T_map_camera = np.eye(4)
    T_map_camera[:3, :3], T_map_camera[:3, 3] = R, [0.4 * i, 0.0, 12.0]
    seen = np.concatenate([camera.rays * depth[..., None], depth[..., None]], axis=2)
    points = seen @ R.T + T_map_camera[:3, 3]
    truth = ground(points[..., 0], points[..., 1])
    # What a camera sees: the colours, more or less light, a shadow that moves, noise.
    light = rng.uniform(0.7, 1.2) * np.where(np.abs(points[..., 0] - 0.9 * i) < 1.5, 0.5, 1.0)
    image = COLORS[truth - FIRST] * light[..., None] + rng.normal(0, 0.08, (120, 160, 3))

    tensor = image.transpose(2, 0, 1)[None].astype(np.float32)
    labels = session.run(['classes'], {'image': tensor})[0][0].astype(np.int32) + FIRST

    frame = Frame(stamp=i * 100_000_000, labels=labels, depth=depth, camera=camera,
                  T_map_camera=T_map_camera)
    pipeline.add(frame)
    frames.append((frame, truth))
    before.append(np.mean(labels == truth))

pipeline.refine()
after = [np.mean(pipeline.render(frame) == truth) for frame, truth in frames]
print(f'right: {np.mean(before):.1%} of the pixels as the network sees them, '
      f'{np.mean(after):.1%} with a memory; {pipeline.memory.n_voxels} voxels')
