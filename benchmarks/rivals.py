"""The same frames through Open3D and OctoMap (pip install .[bench])."""

import time

import numpy as np
from persem_ros.core.frame.images import backprojected
from persem_ros.core.transforms import inverse, transformed
from persem_ros.settings.config import Config

VOXEL_SIZE, MAX_DEPTH = 0.5, 200.0


def open3d_seconds(frames):
    """
    Return the seconds per frame of VoxelBlockGrid.integrate, block coordinates included.

    TSDF and weight only, no colour and no labels, block_resolution 16, on the CPU.

    """
    import open3d as o3d
    core, device = o3d.core, o3d.core.Device('CPU:0')
    grid = o3d.t.geometry.VoxelBlockGrid(
        ('tsdf', 'weight'), (core.float32, core.float32), ((1,), (1,)), VOXEL_SIZE, 16, 20000,
        device)
    seconds = []
    for frame in frames:
        depth = o3d.t.geometry.Image(core.Tensor(frame.depth.astype(np.float32)[..., None]))
        intrinsic, extrinsic = core.Tensor(frame.camera.K), core.Tensor(
            inverse(frame.T_map_camera))
        begin = time.perf_counter()
        blocks = grid.compute_unique_block_coordinates(depth, intrinsic, extrinsic, 1.0,
                                                       MAX_DEPTH)
        grid.integrate(blocks, depth, intrinsic, extrinsic, 1.0, MAX_DEPTH)
        seconds.append(time.perf_counter() - begin)
    return seconds


def octomap_seconds(frames):
    """Return the seconds per frame of OcTree.insertPointCloud, which casts free space too."""
    import octomap
    tree = octomap.OcTree(VOXEL_SIZE)
    seconds = []
    for frame in frames:
        points = backprojected(frame, Config().memory)
        points = transformed(points[np.isfinite(points[:, 2])], frame.T_map_camera)
        begin = time.perf_counter()
        tree.insertPointCloud(points, frame.T_map_camera[:3, 3], MAX_DEPTH)
        seconds.append(time.perf_counter() - begin)
    return seconds
