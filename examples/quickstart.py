"""From arrays to a refined label image: a wall, half of it door, seen by a poor segmenter."""

import numpy as np
from persem_ros.frames import Frame, pinhole
from persem_ros.pipeline import Pipeline
from persem_ros.settings.config import Config, updated

WALL, DOOR = 1, 2
rng = np.random.default_rng(0)
camera = pinhole(width=160, height=120, fx=120.0, fy=120.0, cx=79.5, cy=59.5)
depth = np.full((120, 160), 8.0)                    # metres along the optical axis
pipeline = Pipeline(updated(Config(), {'memory.voxel_size': 0.2}))

for i in range(20):
    T_map_camera = np.eye(4)                        # maps points of the camera to the map
    T_map_camera[0, 3] = 0.1 * i                    # the camera moves to its right
    truth = np.where(camera.rays[..., 0] * depth + T_map_camera[0, 3] < 1.0, WALL, DOOR)
    labels = np.where(rng.random(depth.shape) < 0.3, rng.integers(1, 5, depth.shape), truth)
    frame = Frame(stamp=i * 100_000_000, labels=labels.astype(np.int32), depth=depth,
                  camera=camera, T_map_camera=T_map_camera)
    pipeline.add(frame)                             # remember what was seen where

pipeline.refine()                                   # let the memory make up its mind
refined = pipeline.render(frame)                    # and look at the last frame again

print(f'right before: {np.mean(labels == truth):.1%}, after: {np.mean(refined == truth):.1%}; '
      f'{pipeline.memory.n_voxels} voxels')
