"""Where the depth of a UAVScenes frame comes from: a folder of images, or LiDAR scans."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.convert.images import nearest, parse_unit, read_array, read_depth, units_per_metre
from persem_ros.convert.uavscenes import lidar
from persem_ros.convert.uavscenes.layout import folder_of, images
from persem_ros.errors import PersemError
from persem_ros.frames import same_aspect

if TYPE_CHECKING:
    from persem_ros.convert.uavscenes.calibration import Calibration
    from persem_ros.convert.uavscenes.convert import UavscenesOptions
    from persem_ros.convert.uavscenes.layout import Run


class FolderDepth:
    """Depth from a folder of images that are named like the camera's."""

    def __init__(self, options: UavscenesOptions) -> None:
        self._options = options
        self._unit = parse_unit(options.depth_unit or None)
        self.files = images(folder_of('--depth', options.depth))
        if not self.files:
            raise PersemError(f'--depth {options.depth}: no files named after stamps, like '
                              '1658137057.641204937.png')
        first = next(iter(self.files.values()))
        if self._unit is None and read_array(first).dtype.kind != 'f':
            raise PersemError(f'{first}: integers without a unit; say --depth-unit mm, cm, m or '
                              'the units that make a metre')

    def stored(self, key: str) -> tuple[NDArray[Any], str]:
        """Return (depth, encoding) of a frame in the size of its file."""
        return read_depth(self.files[key], self._unit, self._options.depth_invalid)

    def units_per_metre(self, key: str) -> float:
        """Return the stored units per metre."""
        return units_per_metre(self.files[key], self._unit)

    def image(self, key: str, K_of: Callable[[tuple[int, int]], NDArray[np.float64]],
              D: NDArray[np.float64], size: tuple[int, int]) -> tuple[NDArray[Any], str]:
        """Return (depth, encoding) of a frame, never larger than *size* (width, height)."""
        depth, encoding = self.stored(key)
        own = depth.shape[1], depth.shape[0]
        if not same_aspect(own, size):
            raise PersemError(f'{self.files[key]}: {own[0]}x{own[1]}, but the labels are '
                              f'{size[0]}x{size[1]}; expected one aspect ratio')
        return nearest(depth, size) if own[0] > size[0] else depth, encoding


class LidarDepth:
    """Depth from the frame's scan and its neighbours, the nearest point of a pixel."""

    def __init__(self, run: Run, rig: Calibration, options: UavscenesOptions) -> None:
        if run.lidar is None:
            raise PersemError(f'no folder interval{run.interval}_LIDAR of {run.name}; unpack the '
                              'LiDAR archive, or give --depth DIR')
        scans = lidar.scans_of(run.lidar)
        self.files = {key: path for key, path in scans.items() if key in run.samples}
        if not self.files:
            raise PersemError(f'{run.lidar}: no scans named image<stamp>_lidar<stamp>.txt with a '
                              f'pose; {len(scans)} scans, {len(run.samples)} poses')
        self._run, self._rig, self._around = run, rig, options.lidar
        self._order = list(self.files)
        self._index = {key: i for i, key in enumerate(self._order)}
        # In the map frame, the last used.
        self._scans: OrderedDict[str, NDArray[np.float64]] = OrderedDict()

    def image(self, key: str, K_of: Callable[[tuple[int, int]], NDArray[np.float64]],
              D: NDArray[np.float64], size: tuple[int, int]) -> tuple[NDArray[np.float32], str]:
        """Return (depth, encoding) of a frame, of *size* (width, height)."""
        i = self._index[key]
        near = self._order[max(0, i - self._around):i + self._around + 1]
        points = np.concatenate([self._in_map(other) for other in near])
        T = self._run.samples[key].T_map_camera
        points = (points - T[:3, 3]) @ T[:3, :3]
        return lidar.depth_of_points(points, K_of(size), D, size), '32FC1'

    def _in_map(self, key: str) -> NDArray[np.float64]:
        """Return a scan's points in the map frame; the last few stay in memory."""
        if key not in self._scans:
            T = self._run.samples[key].T_map_camera @ self._rig.T_camera_lidar
            self._scans[key] = lidar.read_scan(self.files[key]) @ T[:3, :3].T + T[:3, 3]
            while len(self._scans) > 2 * self._around + 1:
                self._scans.popitem(last=False)
        return self._scans[key]
