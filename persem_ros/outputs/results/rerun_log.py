"""A replay for the Rerun viewer: camera, images, labels and the growing map in one .rrd file."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any, TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray
from persem_ros.errors import PersemError
from persem_ros.frames import UNKNOWN
from persem_ros.outputs.files import replacing

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

    from persem_ros.frames import Frame
    from persem_ros.passes import Replay
    from persem_ros.rendering import Rendering

EXTRA = "'.[viewer]'"
MAP_STEPS = 100     # the map grows in about so many pieces


class RerunLog:
    """
    Watches a replay (persem_ros.passes.Replay) and writes what it sees.

    A context manager: the file appears under its name only when the replay went well.

    Parameters
    ----------
    path : str or Path
        The .rrd file.

    Raises
    ------
    PersemError
        When rerun-sdk is not installed.

    """

    whole_map = True        # it goes by the numbers of voxels

    def __init__(self, path: Path | str) -> None:
        self._rr = _rerun()
        self._path = path
        self._seen = np.zeros(0, np.bool_)      # by voxel number: met since the last piece
        self._logged = np.zeros(0, np.bool_)    # ... and what the file has
        self._frames = 0
        self._columns: dict[str, NDArray[Any]] | None = None     # of the map

    def __enter__(self) -> RerunLog:
        """Open the file."""
        with ExitStack() as stack:
            work = stack.enter_context(replacing(self._path))
            self._out = self._rr.RecordingStream('persem_ros')
            self._out.save(work)
            stack.callback(self._out.disconnect)
            self._close = stack.pop_all()
        return self

    def __exit__(
            self, kind: type[BaseException] | None, value: BaseException | None,
            traceback: TracebackType | None) -> None:
        """Put the file under its name, or remove what there is of it."""
        self._close.__exit__(kind, value, traceback)

    def frame(self, replay: Replay, frame: Frame, rendering: Rendering) -> None:
        """Log a frame's camera and images, and now and then what was met of the map."""
        rr, out = self._rr, self._out
        if self._frames == 0:
            out.send_blueprint(self._blueprint(frame))
            self._names(replay)
        self._at(frame)
        self._camera(replay, frame)
        path = _camera_path(frame)
        if frame.color is not None:
            size = rendering.labels.shape[::-1]
            color = cv2.resize(frame.color, size, interpolation=cv2.INTER_AREA)
            out.log(f'{path}/image', rr.Image(color).compress(jpeg_quality=80))
        images = {'labels': rendering.labels, 'truth': rendering.truth,
                  'refined': rendering.images[replay.config.refine.method]}
        for name, image in images.items():
            if image is not None:
                out.log(f'{path}/{name}', rr.SegmentationImage(
                    np.where(image < 0, UNKNOWN, image).astype(np.uint16)))
        self._meet(rendering.voxels, replay.pipeline.memory.n_voxels)
        self._frames += 1
        if self._frames % max(1, replay.recording.expected // MAP_STEPS) == 0:
            self._grow(replay, self._seen & ~self._logged)

    def finish(self, replay: Replay, result: dict[str, Any]) -> None:
        """Log the rest of the map; where it changed on the way (--causal), all of it anew."""
        memory = replay.pipeline.memory
        self._meet(np.zeros(0, np.int32), memory.n_voxels)
        if replay.causal:
            self._out.log('world/map', self._rr.Clear(recursive=True))
            self._logged[:] = False
        self._columns = None
        self._grow(replay, ~self._logged)
        self._names(replay)

    def _at(self, frame: Frame) -> None:
        self._out.set_time('stamp', timestamp=np.datetime64(frame.stamp, 'ns'))
        self._out.set_time('frame', sequence=self._frames)

    def _camera(self, replay: Replay, frame: Frame) -> None:
        """Log where the camera is and what it sees, in the voxels' frame."""
        rr, path = self._rr, _camera_path(frame)
        T = frame.T_map_camera
        self._out.log(path, rr.Transform3D(
            translation=T[:3, 3] - replay.pipeline.memory.origin, mat3x3=T[:3, :3]))
        self._out.log(path, rr.Pinhole(
            image_from_camera=frame.camera.K, width=frame.camera.width,
            height=frame.camera.height,
            image_plane_distance=20 * replay.pipeline.memory.voxel_size))

    def _names(self, replay: Replay) -> None:
        """Log the names and colours of the classes: those of the legend and those that occur."""
        rr, legend = self._rr, replay.legend
        ids = sorted({*legend.ids, *np.flatnonzero(replay.pipeline.memory.seen_ids).tolist()})
        infos = [rr.AnnotationInfo(id=i, label=legend.name(i), color=legend.color(i)) for i in ids]
        unknown = rr.AnnotationInfo(id=UNKNOWN, label='no label', color=(0, 0, 0, 0))
        self._out.log('/', rr.AnnotationContext([*(i for i in infos if i.id != UNKNOWN), unknown]),
                      static=True)
        self._out.log('world', rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def _meet(self, voxels: NDArray[np.int32], n: int) -> None:
        """Note which voxels, by number, a frame met; there are *n* by now."""
        room = np.zeros(n - len(self._seen), np.bool_)
        self._seen = np.concatenate([self._seen, room])
        self._logged = np.concatenate([self._logged, room])
        self._seen[voxels[voxels >= 0]] = True

    def _grow(self, replay: Replay, new: NDArray[np.bool_]) -> None:
        """Log the voxels for which *new*, by number, is true, as one more piece of the map."""
        memory = replay.pipeline.memory
        if self._columns is None or replay.causal:
            self._columns = memory.voxels()
        columns = self._columns
        rows = np.flatnonzero(new[columns['number']])
        if len(rows):
            label = columns['label'][rows]
            self._out.log(f'world/map/{self._frames:06d}', self._rr.Points3D(
                (columns['voxel'][rows] + 0.5) * memory.voxel_size, class_ids=label,
                colors=replay.legend.colors(label), radii=0.5 * memory.voxel_size))
        self._logged |= new

    def _blueprint(self, frame: Frame) -> Any:
        """Return the arrangement of views: the map beside the first camera's images."""
        views, camera = self._rr.blueprint, '/' + _camera_path(frame)
        images = [views.Spatial2DView(origin=camera, name=name, contents=[f'{camera}/{name}'])
                  for name in ('image', 'labels', 'refined', 'truth')]
        return views.Blueprint(views.Horizontal(
            views.Spatial3DView(origin='/world', name='map',
                                contents=['+ $origin/**', f'- {camera}/**',
                                          f'+ {camera}/refined']),
            views.Vertical(*images), column_shares=[3, 1]))


def _camera_path(frame: Frame) -> str:
    """Return the entity of a frame's camera; Rerun escapes what it does not like."""
    name = ''.join(c if c.isalnum() else '_' for c in frame.sensor)
    return f'world/camera_{name}' if name else 'world/camera'


def _rerun() -> Any:
    """Return the module rerun, or refuse with what to type; Any: it need not be installed."""
    try:
        import rerun
        import rerun.blueprint
    except ImportError:
        raise PersemError('--rerun: expected the package rerun-sdk, which is not installed; '
                          f'type: pip install {EXTRA}') from None
    if not hasattr(rerun.RecordingStream, 'set_time'):
        raise PersemError('--rerun: expected rerun-sdk 0.23 or newer, found '
                          f'{rerun.__version__}; type: pip install --upgrade {EXTRA}')
    return rerun
