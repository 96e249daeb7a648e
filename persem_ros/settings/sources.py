"""Settings of what comes in: topics, poses, pairs, depth, classes."""

from __future__ import annotations

from dataclasses import dataclass

from persem_ros.settings.setting import setting

NO_TABLE = 'none'       # of labels.topic
QOS = ('auto', 'best_effort', 'reliable', 'latched')
_QOS = 'auto', ('auto: reliable while every publisher found offers it, else best_effort; '
                'best_effort matches every publisher; reliable: nothing is lost; latched: '
                'reliable, and the last message of before is asked for')


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
class Frames:
    """Coordinate frames."""

    map: str = setting('map', 'frame in which voxels live', live=False)    # noqa: A003


@dataclass(frozen=True)
class CameraSettings:
    """How camera infos are read."""

    rectified: bool = setting(
        False, 'true: images are rectified, P is used and D ignored; false: K and D', live=False)
    frame: str = setting(
        '', 'frame of labels and depth, where the one that they name is wrong or none; empty: as '
            'the messages say', live=False)


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
class Inputs:
    """What is taken from topics and recordings at all."""

    max_pixels: int = setting(
        64_000_000, 'larger images are refused before they are decoded, as are messages and '
        'chunks that unpack to more than 16 bytes for each', 'pixels', 1, 1 << 32)
