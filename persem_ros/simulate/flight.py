"""A whole simulated flight: frames for tests and benchmarks, or a recording."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.frames import Frame, IGNORED, pinhole
from persem_ros.inputs.sync.track import interpolated
from persem_ros.settings.legend_files import load_legend
from persem_ros.simulate.materials import VOID
from persem_ros.simulate.path import make_path, rotation
from persem_ros.simulate.plan import check, Plan
from persem_ros.simulate.render import Renderer
from persem_ros.simulate.segmenter import Segmenter
from persem_ros.simulate.sensor import measured, recorded
from persem_ros.simulate.world import make_world

if TYPE_CHECKING:
    from persem_ros.outputs.recording.writer import RecordingWriter
    from persem_ros.simulate.render import View
    from persem_ros.simulate.world import World

START = 1_700_000_000_000_000_000       # nanoseconds, stamp of the first pose
POSE_STEP = 10_000_000                  # nanoseconds between poses: 100 Hz
FIRST_IMAGE = 103_700_000               # nanoseconds; images never fall on a pose
KEYFRAMES = 1.0                         # s between the poses of the corrected path
MAP, BODY, MOUNT, OPTICAL = 'map', 'base_link', 'camera_link', 'camera_optical_frame'


@dataclass(frozen=True, eq=False)
class Shot:
    """One image of the flight: what the sensors say and what is true."""

    stamp: int
    labels: NDArray[np.uint8]       # (H, W)
    truth: NDArray[np.uint8]        # (H, W)
    depth: NDArray[np.float32]      # (H, W), metres, NaN: none
    color: NDArray[np.uint8]        # (H, W, 3)


class Flight:
    """
    A flight over a made-up town and forest.

    Parameters
    ----------
    plan : Plan
    workers : int
        Threads that render; the result does not depend on it.
    world : World, optional
        What a flight of the same seed has made already; made anew where there is none.

    Raises
    ------
    PersemError
        For a plan that cannot be flown.

    """

    def __init__(
            self, plan: Plan | None = None, workers: int = 2, world: World | None = None) -> None:
        plan = Plan() if plan is None else plan
        check(plan)
        self.plan, self.workers = plan, workers
        self.legend = load_legend('town')
        focal = plan.width / 2 / np.tan(np.radians(plan.field_of_view) / 2)
        self.camera = pinhole(plan.width, plan.height, focal, focal, (plan.width - 1) / 2,
                              (plan.height - 1) / 2, OPTICAL)
        self.stamps = [START + FIRST_IMAGE + round(i * 1e9 / plan.rate)
                       for i in range(plan.frames)]
        count = (self.stamps[-1] - START) // POSE_STEP + 12
        self.pose_stamps = [START + i * POSE_STEP for i in range(count)]
        self.path = make_path(np.random.default_rng([plan.seed, 2]), count * POSE_STEP / 1e9,
                              plan.flown_altitude, plan.speed)
        self.T_body_mount, self.T_mount_camera = mounting(plan.tilt)
        self.T_body_camera = self.T_body_mount @ self.T_mount_camera
        self.poses = recorded([self.body(stamp) for stamp in self.pose_stamps], plan.pose_errors,
                              np.random.default_rng([plan.seed, 3]))
        self._segmenter = Segmenter(np.random.default_rng([plan.seed, 4]), plan.mistakes)
        self.world = world or make_world(plan.seed)
        self._renderer = Renderer(self.world, self.camera)

    def body(self, stamp: int) -> NDArray[np.float64]:
        """Return the true T_map_body, 4x4, at *stamp* (ns)."""
        return self.path.body((stamp - START) / 1e9)

    def recorded_camera(self, stamp: int) -> NDArray[np.float64]:
        """Return T_map_camera, 4x4, at *stamp* (ns), interpolated between recorded poses."""
        i = (stamp - START) // POSE_STEP
        fraction = (stamp - self.pose_stamps[i]) / POSE_STEP
        return interpolated(self.poses[i], self.poses[i + 1], fraction) @ self.T_body_camera

    @property
    def keyframes(self) -> list[int]:
        """Return the stamps of the images whose poses are in the corrected path, ns."""
        every = max(1, round(KEYFRAMES * self.plan.rate))
        return sorted({*self.stamps[::every], self.stamps[-1]})

    def shots(self) -> Iterator[Shot]:
        """Yield the Shot of every image, in order."""
        if self.workers < 2:
            yield from map(self.shot, range(self.plan.frames))
            return
        with ThreadPoolExecutor(self.workers) as pool:
            ahead: deque[Future[Shot]] = deque()
            try:
                for i in range(self.plan.frames):
                    ahead.append(pool.submit(self.shot, i))
                    if len(ahead) > self.workers + 1:
                        yield ahead.popleft().result()
                while ahead:
                    yield ahead.popleft().result()
            finally:
                for future in ahead:
                    future.cancel()

    def frames(self) -> Iterator[Frame]:
        """Yield every image as a persem_ros.frames.Frame with truth and colour, in order."""
        for shot in self.shots():
            labels, truth = (np.where(image == VOID, IGNORED, image.astype(np.int32))
                             for image in (shot.labels, shot.truth))
            yield Frame(shot.stamp, labels, shot.depth.astype(np.float64), self.camera,
                        self.recorded_camera(shot.stamp), frame_id=OPTICAL, encoding='mono8',
                        truth=truth, color=shot.color)

    def view(self, index: int) -> View:
        """Return the render.View of image *index*, without any error."""
        stamp = self.stamps[index]
        return self._renderer.render(self.body(stamp) @ self.T_body_camera, (stamp - START) / 1e9)

    def shot(self, index: int) -> Shot:
        """Return the Shot of image *index*; it does not depend on the others."""
        rng = np.random.default_rng([self.plan.seed, 5, index])
        view = self.view(index)
        origin = (self.body(self.stamps[index]) @ self.T_body_camera)[:3, 3]
        labels = self._segmenter.labels(view, origin, rng)
        depth = measured(view, self.plan.depth_errors, rng)
        return Shot(self.stamps[index], labels, view.labels, depth, view.color)

    def record(self, writer: RecordingWriter,
               progress: Callable[[Iterator[Shot]], Iterable[Shot]] = iter) -> None:
        """
        Write the flight to a persem_ros.outputs.recording.writer.RecordingWriter.

        Topics are the defaults of the settings. *progress* wraps the iterator of shots. Where the
        poses are those of a dead reckoning, the true ones are on /true_pose, and at the end comes
        /corrected_path, as a SLAM system publishes it when it has closed the loop.

        """
        closes = self.plan.pose_errors.odometry > 0
        writer.text('/semantic/legend', self.legend.to_yaml(), latched=True)
        writer.tf(None, BODY, MOUNT, self.T_body_mount, static=True)
        writer.tf(None, MOUNT, OPTICAL, self.T_mount_camera, static=True)
        poses = deque(zip(self.pose_stamps, self.poses))
        for shot in progress(self.shots()):
            while poses and poses[0][0] <= shot.stamp:
                _write_pose(writer, *poses.popleft())
            self._write_shot(writer, shot)
            if closes:
                writer.pose('/true_pose', shot.stamp, MAP, self.body(shot.stamp), 'Odometry', BODY)
        for stamp, T in poses:
            _write_pose(writer, stamp, T)
        if closes:
            writer.trajectory('/corrected_path', self.pose_stamps[-1], MAP,
                              [(stamp, self.body(stamp)) for stamp in self.keyframes])

    def _write_shot(self, writer: RecordingWriter, shot: Shot) -> None:
        plan, stamp = self.plan, shot.stamp
        writer.camera_info('/depth/camera_info', stamp, OPTICAL, plan.width, plan.height,
                           self.camera.K, D=[0.0] * 5)
        writer.image('/color/image', stamp, OPTICAL, shot.color, 'rgb8')
        writer.image('/depth/image', stamp, OPTICAL, shot.depth, '32FC1')
        writer.image('/semantic/image', stamp, OPTICAL, shot.labels, 'mono8')
        writer.image('/semantic/truth', stamp, OPTICAL, shot.truth, 'mono8')


def mounting(tilt: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (T_body_mount, T_mount_camera): a camera that looks *tilt* degrees down."""
    T_body_mount, T_mount_camera = np.eye(4), np.eye(4)
    T_body_mount[:3, :3] = rotation(0.0, np.radians(tilt), 0.0)
    T_body_mount[:3, 3] = 0.12, 0.0, -0.08
    T_mount_camera[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]    # REP-103: optical axes
    return T_body_mount, T_mount_camera


def _write_pose(writer: RecordingWriter, stamp: int, T: NDArray[np.float64]) -> None:
    writer.pose('/pose', stamp, MAP, T, 'Odometry', BODY)
    writer.tf(stamp, MAP, BODY, T)
