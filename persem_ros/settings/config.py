"""All settings as one: by dotted names, updated, checked (spec section 7)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, TYPE_CHECKING, TypeVar

from persem_ros.errors import PersemError
from persem_ros.guard.words import short
from persem_ros.settings import heights
from persem_ros.settings.mapping import (
    Ema, Geometry, IMAGE_METHODS, Memory, METHODS, Refine, Render)
from persem_ros.settings.products import Grid, Map
from persem_ros.settings.setting import checked, nearest, setting
from persem_ros.settings.sources import (
    CameraSettings, Depth, Frames, Inputs, Labels, NO_TABLE, Points, Pose, Qos, Sync, Topics,
    TrajectorySettings)

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

# Whoever needs settings finds all of them here.
__all__ = ('CameraSettings', 'Config', 'Depth', 'Ema', 'Frames', 'Geometry', 'Grid',
           'IMAGE_METHODS', 'Inputs', 'Labels', 'METHODS', 'Map', 'Memory', 'NO_TABLE', 'Points',
           'Pose', 'Qos', 'Refine', 'Render', 'Sync', 'Topics', 'TrajectorySettings', 'frame_of',
           'nearest', 'settings', 'topics_of', 'updated')

Section = TypeVar('Section', bound='DataclassInstance')


@dataclass(frozen=True)
class Config:
    """All settings; the dotted names are the ROS parameter names."""

    memory: Memory = Memory()
    refine: Refine = Refine()
    camera: CameraSettings = CameraSettings()
    render: Render = Render()
    frames: Frames = Frames()
    pose: Pose = Pose()
    sync: Sync = Sync()
    topics: Topics = Topics()
    trajectory: TrajectorySettings = TrajectorySettings()
    depth: Depth = Depth()
    points: Points = Points()
    qos: Qos = Qos()
    map: Map = Map()    # noqa: A003
    grid: Grid = Grid()
    inputs: Inputs = Inputs()
    ema: Ema = Ema()
    labels: Labels = Labels()
    cameras: tuple[str, ...] = setting(
        ('',), 'names of several cameras; each has cameras.<name>.topics.* and '
        'cameras.<name>.frame; empty: one camera', live=False)
    # By name, filled from cameras.<name>.topics.* and cameras.<name>.frame.
    camera_topics: tuple[tuple[str, Topics], ...] = ()
    camera_frames: tuple[tuple[str, str], ...] = ()


def settings(
        config: DataclassInstance | None = None, prefix: str = ''
) -> Iterator[tuple[str, Any, Mapping[str, Any]]]:
    """
    Yield every setting of *config*, or of one section, as (dotted name, value, metadata).

    The metadata is a mapping with the keys help, unit, low, high, choices and live.

    """
    config = Config() if config is None else config
    for item in fields(config):
        value = getattr(config, item.name)
        if is_dataclass(value) and not isinstance(value, type):
            yield from settings(value, f'{prefix}{item.name}.')
        elif item.metadata:
            yield f'{prefix}{item.name}', value, item.metadata
    if isinstance(config, Config):
        frames, meta = dict(config.camera_frames), CameraSettings.__dataclass_fields__['frame']
        for camera, topics in config.camera_topics:
            yield from settings(topics, f'cameras.{camera}.topics.')
            yield f'cameras.{camera}.frame', frames.get(camera, ''), meta.metadata


def updated(config: Config, values: Mapping[str, Any]) -> Config:
    """
    Return *config* with {dotted name: value} applied.

    Raises
    ------
    PersemError
        For an unknown name (the nearest right one is named), a wrong type or a value out of
        range.

    """
    if 'cameras' in values:
        config = replace(config, cameras=checked('cameras', values['cameras'], ('',), {}))
    frames = dict(config.camera_frames)
    config = replace(config, camera_topics=_camera_topics(config), camera_frames=tuple(
        (camera, frames.get(camera, '')) for camera in config.cameras if camera))
    known = {name: (value, meta) for name, value, meta in settings(config)}
    for name, value in values.items():
        if name == 'cameras':
            continue
        if name not in known:
            raise PersemError(f'unknown setting {short(name)}{nearest(name, known)}; '
                              "'persem config' lists all settings")
        _check_method(name, value)
        value = checked(name, value, *known[name])
        head, *rest = name.split('.')
        config = _with_camera(config, rest, value) if head == 'cameras' else \
            _with(config, [head, *rest], value)
    _check_together(config)
    return config


def topics_of(config: Config, camera: str = '') -> Topics:
    """Return the Topics of one camera ('' where there is only one)."""
    return dict(config.camera_topics).get(camera, config.topics)


def frame_of(config: Config, camera: str = '') -> str:
    """Return the frame that the settings say a camera's images are in, '' for none."""
    return dict(config.camera_frames).get(camera, config.camera.frame)


def _camera_topics(config: Config) -> tuple[tuple[str, Topics], ...]:
    """Topics of every named camera: its own where given, else the shared names below its name."""
    old = dict(config.camera_topics)
    result = []
    for camera in (name for name in config.cameras if name):
        shared = {f.name: f'{camera}/{getattr(config.topics, f.name)}' for f in fields(Topics)
                  if f.name not in ('pose', 'tf', 'trajectory') and getattr(config.topics, f.name)}
        result.append((camera, old.get(camera, replace(config.topics, **shared))))
    return tuple(result)


def _check_method(name: str, value: object) -> None:
    """Refuse methods that label images alone, with what measures them."""
    if name == 'refine.method' and isinstance(value, str) and value in IMAGE_METHODS:
        raise PersemError(f'{name}: {" and ".join(IMAGE_METHODS)} need no map and refine none; '
                          f"'persem replay' measures them with --methods {value}; expected one "
                          f'of {", ".join(METHODS)}')


def _check_together(config: Config) -> None:
    """Refuse values that are fine alone and wrong together."""
    if config.refine.neighbours not in (6, 18, 26):
        raise PersemError(
            f'refine.neighbours: expected 6, 18 or 26, got {config.refine.neighbours}')
    heights.parsed(config.refine.geometry.heights)
    if config.depth.kind == 'disparity' and not config.depth.scale:
        raise PersemError('depth.kind: disparity needs depth.scale, the focal length (pixels) x '
                          'the baseline (m) of the stereo camera')
    named = [camera for camera in config.cameras if camera]
    if config.camera.frame and named:
        raise PersemError('camera.frame: of several cameras each has a frame of its own, expected '
                          f'cameras.{named[0]}.frame (cameras: {", ".join(named)})')
    if config.memory.min_depth >= config.memory.max_depth:
        raise PersemError(
            f'memory.min_depth: expected less than memory.max_depth '
            f'({config.memory.max_depth} m), got {config.memory.min_depth} m')


def _with(config: Section, path: list[str], value: object) -> Section:
    """Return *config* with the setting at *path* replaced."""
    head, *rest = path
    inner = _with(getattr(config, head), rest, value) if rest else value
    return replace(config, **{head: inner})


def _with_camera(config: Config, path: list[str], value: str) -> Config:
    """Return *config* with cameras.<name>.frame or a cameras.<name>.topics.* replaced."""
    camera, _, item = (*path, '')[:3]
    if not item:
        frames = dict(config.camera_frames) | {camera: value}
        return replace(config, camera_frames=tuple(frames.items()))
    topics = tuple((name, replace(old, **{item: value}) if name == camera else old)
                   for name, old in config.camera_topics)
    return replace(config, camera_topics=topics)
