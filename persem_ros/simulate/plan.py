"""The noun plan: what a flight is like."""

from __future__ import annotations

from dataclasses import dataclass, replace

from persem_ros.errors import PersemError
from persem_ros.simulate.segmenter import Mistakes
from persem_ros.simulate.sensor import DepthErrors, PoseErrors


@dataclass(frozen=True)
class Plan:
    """
    What a flight is like.

    Attributes
    ----------
    seed : int
        The same seed and plan give the same bytes.
    frames : int
        Number of images.
    width, height : int
        Of the images, pixels.
    rate : float
        Images per second.
    altitude : float
        Height of flight above the river plain, metres.
    speed : float
        Metres per second.
    field_of_view : float
        Horizontal, degrees.
    tilt : float
        How far the camera looks below the horizon, degrees; 90: straight down.
    voxel_scale : float
        Factor on the number of voxels that a frame touches: the altitude is multiplied by its
        root.
    mistakes : Mistakes
    depth_errors : DepthErrors
    pose_errors : PoseErrors

    """

    seed: int = 0
    frames: int = 150
    width: int = 480
    height: int = 360
    rate: float = 5.0
    altitude: float = 56.0
    speed: float = 6.0
    field_of_view: float = 70.0
    tilt: float = 60.0
    voxel_scale: float = 1.0
    mistakes: Mistakes = Mistakes()
    depth_errors: DepthErrors = DepthErrors()
    pose_errors: PoseErrors = PoseErrors()

    @property
    def flown_altitude(self) -> float:
        """Return the altitude with the voxel scale in it, metres."""
        return self.altitude * max(self.voxel_scale, 0.0) ** 0.5

    def without_errors(self) -> Plan:
        """Return the same flight with exact labels, depth and poses."""
        return replace(self, mistakes=replace(self.mistakes, difficulty=0.0),
                       depth_errors=replace(self.depth_errors, scale=0.0),
                       pose_errors=PoseErrors())


def check(plan: Plan) -> None:
    """Refuse what cannot be flown."""
    for name, value, low, high, unit in (
            ('seed', plan.seed, 0, 2 ** 32, ''),
            ('frames', plan.frames, 1, 100000, ''),
            ('width', plan.width, 32, 4096, ' pixels'),
            ('height', plan.height, 32, 4096, ' pixels'),
            ('rate', plan.rate, 0.1, 50, ' Hz'),
            ('voxel scale', plan.voxel_scale, 0.01, 100, ''),
            ('height of flight (times the root of the voxel scale)', plan.flown_altitude, 40, 150,
             ' m'),
            ('speed', plan.speed, 0.1, 30, ' m/s'),
            ('field of view', plan.field_of_view, 10, 110, ' degrees'),
            ('tilt', plan.tilt, 25, 90, ' degrees'),
            ('difficulty', plan.mistakes.difficulty, 0, 10, ''),
            ('depth noise', plan.depth_errors.scale, 0, 10, ''),
            ('pose noise', plan.pose_errors.noise, 0, 100, ' m'),
            ('attitude noise', plan.pose_errors.attitude, 0, 45, ' degrees'),
            ('pose drift', plan.pose_errors.drift, 0, 100, ' m'),
            ('loop closure', plan.pose_errors.odometry, 0, 10, '')):
        if not low <= value <= high:
            raise PersemError(f'{name}: expected {low} to {high}{unit}, got {value}')
