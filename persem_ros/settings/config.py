"""Every setting once: name, default, unit, range and help text (spec section 7)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
import difflib
import math
from typing import Any, TYPE_CHECKING, TypeVar

from persem_ros.errors import PersemError
from persem_ros.guard.words import short
from persem_ros.settings import heights

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

METHODS = ('majority', 'unweighted', 'recency', 'consensus', 'probabilistic',
           'trust', 'context', 'history', 'context_history', 'persem', 'geometry')
IMAGE_METHODS = ('raw2d', 'ema2d')
NO_TABLE = 'none'       # of labels.topic
QOS = ('auto', 'best_effort', 'reliable', 'latched')
ONE: dict[type, str] = {float: 'a number', int: 'a whole number', bool: 'true or false',
                        str: 'text'}
MANY: dict[type, str] = {float: 'numbers', int: 'whole numbers', str: 'texts'}
_QOS = 'auto', ('auto: reliable while every publisher found offers it, else best_effort; '
                'best_effort matches every publisher; reliable: nothing is lost; latched: '
                'reliable, and the last message of before is asked for')
Section = TypeVar('Section', bound='DataclassInstance')


def setting(
        default: Any, text: str, unit: str = '', low: float | None = None,
        high: float | None = None, choices: tuple[str, ...] | None = None, live: bool = True
) -> Any:
    """
    Declare one setting.

    Parameters
    ----------
    default : bool, int, float, str or tuple
        The value where nothing else is given; its type is the setting's type.
    text : str
        The sentence shown in help texts, documentation and ROS parameter descriptions.
    unit : str
        Unit of the value, empty where it has none.
    low, high : number, optional
        Inclusive range of the value.
    choices : tuple of str, optional
        The only values allowed.
    live : bool
        False where a change while mapping would make the map inconsistent.

    """
    return field(default=default, metadata={
        'help': text, 'unit': unit, 'low': low, 'high': high, 'choices': choices, 'live': live})


@dataclass(frozen=True)
class Memory:
    """Which pixels are remembered, and how finely."""

    voxel_size: float = setting(0.5, 'edge of a voxel', 'm', 1e-3, 1e3, live=False)
    min_depth: float = setting(0.1, 'nearer measurements are ignored', 'm', 0.0, 1e5)
    max_depth: float = setting(200.0, 'farther measurements are ignored', 'm', 0.0, 1e5)
    stride: int = setting(
        1, 'integrate every n-th pixel of every n-th row; 0: auto, as many as leave a voxel three '
        'pixels wide at the median depth', 'pixels', 0, 64)
    min_pixels: int = setting(1, 'pixels that make an observation of a voxel', 'pixels', 1, 10000)
    ignore_labels: tuple[int, ...] = setting((255, 65535), 'ids that are not observations')
    dynamic_labels: tuple[int, ...] = setting(
        (-1,), 'ids of things that move: never integrated, passed through unchanged; -1: none')
    max_history: int = setting(
        0, 'newest observations that a refinement reads per voxel; 0: all', 'observations', 0,
        1 << 20, live=False)
    max_voxels: int = setting(
        0, 'voxels kept in memory: where there are more, the farthest blocks go (node, and '
        'replays into attached maps); 0: all',
        'voxels', 0, 1 << 32)
    keep_radius: float = setting(
        0.0, 'blocks of voxels farther from the camera are forgotten (node); 0: none', 'm', 0.0,
        1e6)
    clear_after: int = setting(
        0, 'looks through a voxel, in as many seconds and since it was last observed, after which '
        'what stood there has moved away (and a tenth of its observations, where those are more); '
        '0: never', 'looks', 0, 1 << 20)
    clear_margin: float = setting(
        1.5, 'how far behind a voxel all that is measured must lie to look through it', 'voxels',
        0.0, 1000.0)
    clear_slope: float = setting(
        0.02, 'and how much more for each metre of distance', 'm/m', 0.0, 10.0)
    clear_range: float = setting(
        30.0, 'voxels farther along the optical axis are not looked through', 'm', 0.0, 1e5)


@dataclass(frozen=True)
class Geometry:
    """The method geometry; lengths are in voxels, so that one set serves all resolutions."""

    directions: int = setting(
        8, 'bins of viewing directions along half an axis: looks from one bin are one vote; '
        '0: every look is one', '', 0, 32)
    window: int = setting(20, 'columns around one whose lowest voxels make its ground', 'voxels',
                          0, 1000)
    cell: int = setting(32, 'edge of the areas that have habits of their own', 'voxels', 2, 4096)
    weight: float = setting(0.5, 'weight of what shapes and areas say; 0: none', '', 0.0, 100.0)
    smoothing: float = setting(6.0, 'weight of what the neighbours say (lambda); 0: none', '',
                               0.0, 100.0)
    prior: float = setting(60.0, 'voxels that a group of places must outweigh', 'voxels', 1e-3,
                           1e9)
    shrink: float = setting(0.1, "share of all looks that the classes' confusions must outweigh",
                            '', 1e-6, 1e3)
    rounds: int = setting(3, 'rounds in which the parameters are fitted', '', 1, 100)
    groups: str = setting('both', 'which groups of places have habits: shapes anywhere, kinds in '
                          'areas, or both (an ablation)', choices=('both', 'shapes', 'cells'))
    heights: str = setting(
        '', "heights above the ground that classes keep to, as '3 -2 2; 5 4 inf': id, lowest, "
        "highest; empty: those of the legend (its key height, in metres); 'none': none", 'voxels')


@dataclass(frozen=True)
class Refine:
    """How the memory makes up its mind."""

    method: str = setting('persem', 'labelling method', choices=METHODS)
    min_observations: int = setting(
        3, 'observations that make a voxel recurrent; fewer are not refined', 'observations', 1,
        1 << 20)
    neighbours: int = setting(26, 'neighbourhood of a voxel: 6, 18 or 26')
    eta: float = setting(0.3, "share of the neighbours' history in the anchor (eta)", '', 0.0, 1.0)
    lambda_volatility: float = setting(
        1.0, 'how strongly a volatile class is distrusted (lambda_v)', '', 0.0, 100.0)
    lambda_disagreement: float = setting(
        0.5, 'how strongly a surprise is distrusted (lambda_s)', '', 0.0, 100.0)
    lambda_gap: float = setting(
        0.01, 'how strongly a gap in time is distrusted (lambda_t)', '1/frame', 0.0, 100.0)
    gamma: float = setting(0.95, 'decay of replayed evidence (gamma)', '', 0.0, 1.0)
    tau_replay: float = setting(0.1, 'margin of a trust proposal (tau_replay)', '', 0.0, 1e6)
    tau_context: float = setting(0.1, 'margin of its verification (tau_context)', '', 0.0, 1.0)
    lambda_recency: float = setting(
        0.05, 'decay of the methods recency and consensus (lambda_r)', '1/frame', 0.0, 100.0)
    beta: float = setting(0.5, 'bonus of the method consensus (beta)', '', 0.0, 100.0)
    period: float = setting(1.0, 'time between refinements', 's', 0.01, 3600.0)
    volatility_every: int = setting(
        10, 'refinements, at least, before the class volatility is taken anew; all voxels have '
        'seen the last one by then (node, --causal)', '', 1, 1 << 20)
    sweep: int = setting(
        100_000, 'voxels that a refinement visits, beside those that changed, until all have '
        'seen the class volatility in force (node, --causal)', 'voxels', 1, 1 << 30)
    up: str = setting('z', 'axis of the map that points up (geometry)',
                      choices=('x', 'y', 'z', '-x', '-y', '-z'))
    geometry: Geometry = Geometry()


@dataclass(frozen=True)
class CameraSettings:
    """How camera infos are read."""

    rectified: bool = setting(
        False, 'true: images are rectified, P is used and D ignored; false: K and D', live=False)
    frame: str = setting(
        '', 'frame of labels and depth, where the one that they name is wrong or none; empty: as '
            'the messages say', live=False)


@dataclass(frozen=True)
class Render:
    """How refined label images are filled."""

    fill: str = setting(
        'input', "a pixel that the map does not know: the frame's own label or the ignored id",
        choices=('input', 'unknown'))


@dataclass(frozen=True)
class Frames:
    """Coordinate frames."""

    map: str = setting('map', 'frame in which voxels live', live=False)    # noqa: A003


@dataclass(frozen=True)
class Pose:
    """Where poses come from."""

    source: str = setting('topic', 'poses from a topic or from /tf', choices=('topic', 'tf'),
                          live=False)
    type: str = setting(    # noqa: A003
        'auto', 'type of the pose topic',
        choices=('auto', 'PoseStamped', 'PoseWithCovarianceStamped', 'Odometry',
                 'TransformStamped', 'VehicleOdometry'), live=False)
    child_frame: str = setting(
        '', 'frame that the poses place in the map; empty: as the messages say', live=False)
    max_gap: float = setting(0.5, 'widest gap between two poses that is interpolated', 's',
                             0.0, 3600.0)
    max_speed: float = setting(
        100.0, 'poses that jump faster than this are not interpolated', 'm/s', 0.0, 1e6)
    hold: tuple[str, ...] = setting(
        ('',), 'frames whose transform in /tf is held: the newest sample not later than the '
        'stamp serves until the next, whatever its age; empty: none', live=False)
    extrinsic: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        'camera in the child frame of the pose (pose.source=tf: in the frame of the images): x y '
        'z qx qy qz qw; all 0: from /tf_static',
        live=False)
    max_ahead: float = setting(
        1.5, 'poses that are farther ahead of a depth image when it arrives are of another clock: '
        'refused (node); 0: never', 's', 0.0, 3600.0)


@dataclass(frozen=True)
class Sync:
    """How label and depth images are paired."""

    tolerance: float = setting(0.02, 'largest difference of stamps in a pair', 's', 0.0, 60.0)
    offset_labels: float = setting(
        0.0, 'added to the stamps of label images: negative where they are stamped when the '
        'network was done', 's', -1e9, 1e9, live=False)
    max_wait: float = setting(1.0, 'how long a frame waits for what is missing', 's', 0.0, 600.0)
    hold: float = setting(
        0.2, 'how long a frame waits for earlier ones of other cameras (node)', 's', 0.0, 60.0)
    queue: float = setting(
        2.0, 'images that wait for longer to be mapped are dropped, the oldest first (node)', 's',
        0.01, 3600.0)
    queue_bytes: int = setting(
        1 << 30, 'bound of the images that wait, also for their partners (node)', 'bytes', 1 << 16,
        1 << 40)


@dataclass(frozen=True)
class Topics:
    """Names of the input topics."""

    labels: str = setting('semantic/image', 'label images', live=False)
    depth: str = setting('depth/image', 'depth images', live=False)
    camera_info: str = setting('depth/camera_info', 'intrinsics of the depth images', live=False)
    pose: str = setting('pose', 'poses of the camera or body', live=False)
    tf: str = setting(
        '', 'transforms, /r1/tf, with /r1/tf_static; empty: /tf, in a replay those of the '
        "camera's namespace", live=False)
    truth: str = setting('semantic/truth', 'true label images (replay only)', live=False)
    color: str = setting('color/image', 'colour images (report and overlay only)', live=False)
    labels_info: str = setting(
        'semantic/camera_info', 'intrinsics of the label images, where they are of another camera '
        'than the depth', live=False)
    points: str = setting(
        '', 'point clouds (PointCloud2): labelled ones in place of images, or with '
        'depth.source=cloud those of a LiDAR in place of depth images; empty: none', live=False)
    confidence: str = setting(
        '', 'confidence images of the segmenter, one value per label: mono8, mono16 (0 to the '
        'largest value) or 32FC1 (0 to 1); empty: none', live=False)
    depth_confidence: str = setting(
        '', 'confidence images of the depth, for depth.min_confidence; empty: none', live=False)
    trajectory: str = setting(
        '', 'corrected poses of what the pose topic places (nav_msgs/Path, each with its stamp), '
        'as SLAM publishes them after a loop closure: the map moves with them; empty: none',
        live=False)


@dataclass(frozen=True)
class TrajectorySettings:
    """What becomes of corrected trajectories."""

    period: float = setting(
        10.0, 'time between two moves of the map, at least (node)', 's', 0.1, 3600.0)


@dataclass(frozen=True)
class Depth:
    """How the numbers of a depth image become metres along the optical axis."""

    scale: float = setting(
        0.0, 'metres per unit of the depth images, 0.001 for millimetres; 0: by encoding (16UC1 '
        'and mono16: millimetres, 32FC1 and 64FC1: metres)', 'm', 0.0, 1e6, live=False)
    kind: str = setting(
        'z', 'what is measured: z, along the optical axis, or ray, the radial distance from the '
        'camera (AirSim DepthPerspective, Isaac Sim distance_to_camera, Hypersim), or disparity, '
        'pixels between two rectified images: metres are depth.scale / value, with depth.scale '
        'the focal length (pixels) x the baseline (m)', choices=('z', 'ray', 'disparity'),
        live=False)
    source: str = setting(
        'image', 'where depth comes from: image, from topics.depth, or cloud, from the LiDAR '
        'cloud of topics.points, projected into the label images', choices=('image', 'cloud'),
        live=False)
    min_confidence: float = setting(
        0.0, 'depth pixels whose value in topics.depth_confidence is lower are not used; a '
        'negative number -c is for cameras whose values grow with doubt (ZED, OAK): values above '
        'c are not used; 0: all are used', "the camera's own", -1e6, 1e6)


@dataclass(frozen=True)
class Points:
    """Point clouds in."""

    label_field: str = setting('label', 'field of labelled clouds that holds the class id',
                               live=False)
    splat: int = setting(
        3, 'width of the square with which a LiDAR point hides what is behind it in the label '
        'image', 'pixels', 1, 99)


@dataclass(frozen=True)
class Qos:
    """Quality of service of the subscriptions (node)."""

    labels: str = setting(*_QOS, choices=QOS, live=False)
    depth: str = setting(*_QOS, choices=QOS, live=False)
    camera_info: str = setting(*_QOS, choices=QOS, live=False)
    pose: str = setting(*_QOS, choices=QOS, live=False)
    color: str = setting(*_QOS, choices=QOS, live=False)
    queue: int = setting(20, 'images of a topic that the middleware keeps; fifty times as many '
                         'camera infos and poses', 'messages', 1, 10000, live=False)


@dataclass(frozen=True)
class Map:
    """The map as a whole."""

    path: str = setting('', 'map file to load and save (.persem); empty: none')
    load: bool = setting(False, 'load map.path at the start (node; a replay always does)',
                         live=False)
    save: bool = setting(False, 'save to map.path at the end (node)')
    attached: bool = setting(
        False, 'map.path is the living map, memory holds a part of it; implies load and save, '
        'and nothing is ever forgotten', live=False)
    checkpoint: float = setting(10.0, 'time between two checkpoints of an attached map (node)',
                                's', 0.1, 3600.0)
    rate: float = setting(0.5, 'how often ~/map is published where it changed (node); 0: never',
                          'Hz', 0.0, 50.0)
    max_voxels: int = setting(0, 'voxels in ~/map (node: 2 000 000); 0: all', 'voxels', 0,
                              1 << 32)
    show: str = setting(
        'nearest', 'which voxels ~/map shows where map.max_voxels does not do: the nearest or the '
        'most observed ones (node)', choices=('nearest', 'observed'))
    min_observations: int = setting(1, 'voxels with fewer are left out of ~/map (node)',
                                    'observations', 1, 1 << 20)
    crop: float = setting(
        0.0, 'voxels farther from the camera are left out of ~/map (node); 0: none', 'm', 0.0, 1e6)
    on_time_jump: str = setting(
        'keep', 'what becomes of the map when time goes back, as in a recording that loops (node)',
        choices=('keep', 'reset'))
    origin: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0),
        'point of the map frame that is subtracted from all positions (UTM coordinates)', 'm',
        live=False)
    crs: str = setting(
        '', 'coordinate reference system of exported files, EPSG:25832; empty: none; persem map '
        'georeference enters it into a map file')
    georeference: tuple[float, float, float, float] = setting(
        (0.0, 0.0, 0.0, 0.0),
        'where the map frame lies in map.crs: east, north and up of its origin (m), and its turn '
        'counter-clockwise (degrees)')


@dataclass(frozen=True)
class Grid:
    """The map as a cost map for vehicles on the ground."""

    resolution: float = setting(
        0.0, 'edge of a cell of the grid; 0: that of a voxel, finer is not possible', 'm', 0.0,
        1e3)
    step: float = setting(
        0.3, 'what is higher above the ground than this, and lower than grid.height, is an '
        'obstacle whatever its class', 'm', 0.0, 1e3)
    height: float = setting(2.0, 'what is higher above the ground than this is no obstacle', 'm',
                            0.0, 1e4)
    window: int = setting(20, 'columns around one whose lowest voxels make its ground', 'voxels',
                          0, 1000)
    min_observations: int = setting(2, 'voxels with fewer are left out of the grid',
                                    'observations', 1, 1 << 20)
    tie: str = setting(
        'highest', 'the cost of a cell whose columns of voxels differ in theirs',
        choices=('highest', 'lowest', 'unknown'))
    labels: str = setting('top', 'class of a cell in the grid of classes: that of the top-most '
                          'voxel or of the ground', choices=('top', 'ground'))
    rate: float = setting(1.0, 'how often ~/grid is published where it changed (node); 0: never',
                          'Hz', 0.0, 50.0)


@dataclass(frozen=True)
class Inputs:
    """What is taken from topics and recordings at all."""

    max_pixels: int = setting(
        64_000_000, 'larger images are refused before they are decoded, as are messages and '
        'chunks that unpack to more than 16 bytes for each', 'pixels', 1, 1 << 32)


@dataclass(frozen=True)
class Ema:
    """Image-space smoothing, a baseline."""

    alpha: float = setting(0.7, 'share of the past in the smoothed image (alpha)', '', 0.0, 1.0)


@dataclass(frozen=True)
class Labels:
    """The names and colours of the classes."""

    legend: str = setting(
        '', 'legend: a shipped name (town, uavscenes, forest, cityscapes) or a YAML file; '
        "empty: the recording's own, else made-up colours", live=False)
    topic: str = setting(
        'semantic/legend', 'names of the classes: YAML or JSON text (String), or '
        'vision_msgs/LabelInfo, latched or not; ids follow their names when it changes; none: '
        'no names are read, ids stay as they are',
        live=False)
    channel: str = setting(
        '', 'how colour images hold ids: in one channel, r, g, b or a, or as the colours of the '
        "legend; empty: the legend's colours where they fit, else the one channel that differs",
        choices=('', 'r', 'g', 'b', 'a', 'legend'), live=False)
    divisor: int = setting(
        0, 'instance-coded ids: class = id // divisor (1000 for class * 1000 + instance); 0: ids '
        'are classes', '', 0, 1 << 30, live=False)
    fit: str = setting(
        'exact', 'how label images of another aspect ratio than the depth show its view: exact: '
        'they are refused; stretch: all of it, distorted; crop: its middle; letterbox: all of it, '
        'between borders', choices=('exact', 'stretch', 'crop', 'letterbox'), live=False)


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
        config = replace(config, cameras=_checked('cameras', values['cameras'], ('',), {}))
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
        value = _checked(name, value, *known[name])
        head, *rest = name.split('.')
        config = _with_camera(config, rest, value) if head == 'cameras' else \
            _with(config, [head, *rest], value)
    _check_together(config)
    return config


def nearest(name: object, known: Iterable[object]) -> str:
    """Return ", did you mean 'x'?" for the name in *known* that is nearest, or ''."""
    word = str(name)[:200] if isinstance(name, (str, int, float)) else ''
    words = [str(k) for k in known]
    near = difflib.get_close_matches(word, words, n=1, cutoff=0.5)
    if not near:
        tail = word.rpartition('.')[2]
        near = [k for k in words if k.rpartition('.')[2] == tail][:1]
    return f', did you mean {near[0]!r}?' if near else ''


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


def _checked(name: str, value: Any, default: Any, meta: Mapping[str, Any]) -> Any:
    """Return *value* in the type of *default*, or refuse it."""
    kind = type(default)
    if hasattr(value, 'tolist'):    # NumPy's numbers and arrays; nothing here imports it
        value = value.tolist()
    if kind is tuple:
        value = [value] if isinstance(value, (str, int, float)) else value
        inner = type(default[0])
        try:
            result = tuple(_checked(name, item, default[0], {}) for item in value)
        except TypeError:
            raise PersemError(f'{name}: expected a list of {MANY[inner]}, for example '
                              f'{list(default)}, got {short(value)}') from None
        if name in ('map.origin', 'map.georeference', 'pose.extrinsic') and \
                len(result) != len(default):
            raise PersemError(f'{name}: expected {len(default)} numbers, got {len(result)}')
        return result or default[:0]
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind or (kind is float and not math.isfinite(value)):
        raise PersemError(f'{name}: expected {_words(kind, default, meta)}, got {short(value)}')
    if name == 'refine.method' and value in IMAGE_METHODS:
        raise PersemError(f'{name}: {" and ".join(IMAGE_METHODS)} need no map and refine none; '
                          f"'persem replay' measures them with --methods {value}; expected one "
                          f'of {", ".join(METHODS)}')
    if meta.get('choices') and value not in meta['choices']:
        raise PersemError(f'{name}: expected one of {", ".join(meta["choices"])}, '
                          f'got {short(value)}{nearest(value, meta["choices"])}')
    low, high = meta.get('low'), meta.get('high')
    if (low is not None and value < low) or (high is not None and value > high):
        unit = f' {meta["unit"]}' if meta.get('unit') else ''
        raise PersemError(f'{name}: expected {low} to {high}{unit}, got {short(value)}')
    return value


def _words(kind: type, default: object, meta: Mapping[str, Any]) -> str:
    """Return what a value should be, in words: a number (m), for example 0.5."""
    unit = f' ({meta["unit"]})' if meta.get('unit') else ''
    if kind in (bool, str):
        return ONE[kind]
    return f'{ONE[kind]}{unit}, for example {default!r}'


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
