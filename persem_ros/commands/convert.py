"""persem convert: data sets on disk become recordings."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from argparse import _SubParsersAction, ArgumentParser, Namespace

    from persem_ros.settings.legend import Legend

NO_CHECK = 'do not reproject depth images to check their unit, the axes and the world'


def add_parser(subparsers: _SubParsersAction[Any]) -> None:
    """Add the sub-command with one parser per kind of data set."""
    parser = subparsers.add_parser(
        'convert', help='make a recording from a data set on disk',
        description='Makes a rosbag2 recording, with the topics that persem replay reads, from a '
                    'data set on disk.')
    kinds = parser.add_subparsers(metavar='KIND', required=True)
    _add_frames(kinds)
    _add_uavscenes(kinds)
    _add_forest(kinds)


def _add_frames(kinds: _SubParsersAction[Any]) -> None:
    """Add persem convert frames."""
    parser = kinds.add_parser(
        'frames', help='folders of label, depth, pose and colour files',
        description="Patterns hold one '*', which stands for the frame; relative ones start at "
                    'DIR. Without them the usual layouts are looked for: 7-Scenes '
                    '(frame-*.depth.png, ...), ScanNet (depth/, label/, pose/), TUM (depth/, '
                    'groundtruth.txt).')
    parser.add_argument('dir', metavar='DIR', help='the data set')
    parser.add_argument('out', metavar='OUT', help='the recording to write')
    files = parser.add_argument_group('files')
    for what, text in (('labels', 'label images: one channel of class ids'),
                       ('depth', 'depth images: 16-bit or floating-point'),
                       ('pose', 'pose files, or one trajectory file (TUM, KITTI, EuRoC .csv, '
                                'SceneNN .log, ARKitScenes .traj)'),
                       ('color', 'colour images'), ('truth', 'label images of true ids')):
        files.add_argument(f'--{what}', metavar='PATTERN', default='', help=text)
    files.add_argument('--intrinsics', metavar='FILE', default='',
                       help='matrix or "fx fy cx cy" of the depth images as text, a ROS '
                            'calibration, or fx,fy,cx,cy itself')
    meaning = parser.add_argument_group('what they mean')
    meaning.add_argument('--depth-unit', metavar='UNIT', default='',
                         help='m, cm, mm or units per metre (default: integers mm, floats m, a '
                              'TUM folder 5000)')
    meaning.add_argument('--depth-invalid', metavar='N,N', default='0,65535',
                         help='stored integers without a measurement (default: %(default)s)')
    meaning.add_argument('--stamps', metavar='HOW', default='auto',
                         help='names, rate or a text file of "stamp name" (default: names where '
                              'they are stamps, else rate)')
    meaning.add_argument('--rate', metavar='HZ', type=float, default=30.0,
                         help='stamp = number in the name / rate (default: %(default)s)')
    meaning.add_argument('--start', metavar='S', type=float, default=1.0,
                         help='stamp of number 0 (default: %(default)s; 0 means "latest" to tf)')
    meaning.add_argument('--tolerance', metavar='S', type=float, default=0.02,
                         help='largest difference of stamps in a frame (default: %(default)s)')
    meaning.add_argument('--pose-is', choices=('camera-to-world', 'world-to-camera'),
                         default='camera-to-world', help='what a pose maps (default: %(default)s)')
    meaning.add_argument('--axes', choices=('opencv', 'opengl', 'ned'), default='opencv',
                         help="the camera's axes in the poses: opencv right down forward, opengl "
                              'right up back, ned forward right down (default: %(default)s)')
    meaning.add_argument('--world', choices=('enu', 'ned', 'opencv'), default='enu',
                         help="the world's axes: ned (z down) and opencv (y down, z forward) are "
                              'turned to z up (default: %(default)s)')
    meaning.add_argument('--no-check', action='store_true', help=NO_CHECK)
    meaning.add_argument('--legend', metavar='NAME', default='',
                         help='a shipped legend or a YAML file, goes to /semantic/legend')
    _add_writing(parser)
    parser.set_defaults(run=run_frames)


def _add_uavscenes(kinds: _SubParsersAction[Any]) -> None:
    """Add persem convert uavscenes."""
    parser = kinds.add_parser(
        'uavscenes', help='a run of the UAVScenes data set',
        description='Reads the released folders (interval1 or interval5, doubled wrappers, run '
                    'folders directly under ROOT). Depth comes from the LiDAR scans, or from '
                    '--depth. Ids without a name become 255.')
    parser.add_argument('root', metavar='ROOT', help='the folder that holds the unpacked archives')
    parser.add_argument('run_name', metavar='RUN', help='for example AMtown01')
    parser.add_argument('out', metavar='OUT', help='the recording to write')
    parser.add_argument('--interval', type=int, choices=(1, 5),
                        help='where both are there (default: the one that is, else 5)')
    parser.add_argument('--predictions', metavar='DIR', default='',
                        help="label images of a segmenter, named like the data set's (default: "
                             'the true labels are the input)')
    parser.add_argument('--depth', metavar='DIR', default='',
                        help='depth images, named like the camera images')
    parser.add_argument('--depth-unit', metavar='UNIT', default='',
                        help='of --depth: m, cm, mm or units per metre')
    parser.add_argument('--depth-invalid', metavar='N,N', default='0,65535',
                        help='stored integers without a measurement (default: %(default)s)')
    parser.add_argument('--no-check', action='store_true',
                        help='do not reproject images of --depth to check their unit')
    parser.add_argument('--lidar', metavar='N', type=int, default=0,
                        help='depth from the N scans before and after as well (default: 0)')
    parser.add_argument('--calibration', metavar='FILE', default='',
                        help="the data set's calibration_results.py (default: looked for in ROOT)")
    parser.add_argument('--camera', choices=('sampleinfos', 'calibration'), default='sampleinfos',
                        help='intrinsics: P3x3, which the poses were solved with, or those of '
                             '--calibration with their distortion (default: %(default)s)')
    parser.add_argument('--scale', type=float, default=1.0,
                        help='resize all images, for example 0.25 (default: %(default)s)')
    parser.add_argument('--no-color', action='store_true', help='leave the colour images out')
    parser.add_argument('--legend', metavar='NAME', default='uavscenes',
                        help='goes to /semantic/legend (default: %(default)s)')
    _add_writing(parser)
    parser.set_defaults(run=run_uavscenes)


def _add_forest(kinds: _SubParsersAction[Any]) -> None:
    """Add persem convert forest."""
    parser = kinds.add_parser(
        'forest', help='a sequence of the Forest Inspection data set',
        description='Reads a sequence of the synthetic part (labels/, color/, depth/, '
                    'airsim_rec.txt) or of the real one, WildUAV (img/, depth/, metadata/). The '
                    'label images are coded by colour. What the data set does not document is an '
                    'option; the depth images are reprojected to see whether it fits.')
    parser.add_argument('root', metavar='ROOT', help='the folder that holds the sequences')
    parser.add_argument('run_name', metavar='SEQ', help='for example seq1')
    parser.add_argument('out', metavar='OUT', help='the recording to write')
    files = parser.add_argument_group('files, looked for where not given')
    for what in ('labels', 'depth', 'color', 'pose'):
        files.add_argument(f'--{what}', metavar='PATTERN', default='',
                           help="path with one '*' below SEQ" +
                           (', or a trajectory file' if what == 'pose' else ''))
    files.add_argument('--predictions', metavar='DIR', default='',
                       help='label images of a segmenter (ids or colours; default: the true '
                            'labels are the input)')
    meaning = parser.add_argument_group('what they mean')
    meaning.add_argument('--depth-unit', metavar='UNIT', default='',
                         help='m, cm, mm or units per metre (default: floats m, integers mm)')
    meaning.add_argument('--depth-coding', choices=('plain', 'rgb24'), default='plain',
                         help='rgb24: R + 256 G + 65536 B of 2^24 - 1, times 1000 m (default: '
                              '%(default)s)')
    meaning.add_argument('--depth-is', choices=('planar', 'ray'), default='planar',
                         help='along the optical axis, or the distance (default: %(default)s)')
    meaning.add_argument('--intrinsics', metavar='FILE', default='',
                         help='matrix or fx,fy,cx,cy (default: of the metadata, else of --fov)')
    meaning.add_argument('--fov', metavar='DEG', type=float, default=90.0,
                         help="horizontal field of view (default: %(default)s, AirSim's)")
    meaning.add_argument('--pose-is', choices=('camera-to-world', 'world-to-camera'),
                         default='camera-to-world', help='what a pose maps (default: %(default)s)')
    meaning.add_argument('--axes', choices=('opencv', 'opengl', 'ned'), default='',
                         help="the camera's axes in the poses (default: ned, AirSim's; opencv "
                              'for metadata)')
    meaning.add_argument('--world', choices=('enu', 'ned', 'opencv'), default='',
                         help="the world's axes (default: ned, AirSim's; enu for metadata)")
    meaning.add_argument('--pitch', metavar='DEG', type=float, default=0.0,
                         help='of the camera on the vehicle, whose pose airsim_rec.txt has: -90 '
                              'is straight down (default: %(default)s)')
    meaning.add_argument('--rate', metavar='HZ', type=float, default=10.0,
                         help='where names are no stamps (default: %(default)s)')
    meaning.add_argument('--start', metavar='S', type=float, default=1.0,
                         help='stamp of number 0 (default: %(default)s)')
    meaning.add_argument('--scale', type=float, default=1.0,
                         help='resize all images, for example 0.25 (default: %(default)s)')
    meaning.add_argument('--no-check', action='store_true', help=NO_CHECK)
    meaning.add_argument('--legend', metavar='NAME', default='forest',
                         help='ids of the colours; goes to /semantic/legend (default: '
                              '%(default)s)')
    _add_writing(parser)
    parser.set_defaults(run=run_forest)


def _add_writing(parser: ArgumentParser) -> None:
    """Add what all kinds share: the part to convert, and how to write it."""
    group = parser.add_argument_group('what to write')
    group.add_argument('--frames', metavar='A:B', default='',
                       help='only frames A to B - 1, counted from 0')
    group.add_argument('--every', metavar='N', type=int, default=1, help='every N-th frame')
    group.add_argument('--max-pixels', metavar='N', type=int, default=64_000_000,
                       help='larger images are refused before they are decoded (default: '
                            '%(default)s)')
    group.add_argument('--storage', choices=('mcap', 'sqlite3'), default='mcap',
                       help='default: %(default)s')
    group.add_argument('--compress', action='store_true', help='Zstandard compression')
    group.add_argument('--force', action='store_true', help='replace the recording OUT')


def run_frames(args: Namespace) -> None:
    """Convert folders of files."""
    _bound(args)
    from persem_ros.convert.frames.convert import convert_frames
    from persem_ros.convert.frames.layout import FramesOptions
    options = FramesOptions(
        **{name: getattr(args, name) for name in (
            'labels', 'depth', 'pose', 'color', 'truth', 'intrinsics', 'depth_unit', 'stamps',
            'rate', 'start', 'tolerance', 'axes', 'world', 'frames', 'every')},
        depth_invalid=_integers('--depth-invalid', args.depth_invalid), direction=args.pose_is,
        check=not args.no_check)
    summary = convert_frames(args.dir, args.out, options, _legend(args), storage=args.storage,
                             compress=args.compress, force=args.force)
    print(f'{args.out}: {summary}')


def run_uavscenes(args: Namespace) -> None:
    """Convert a run of UAVScenes."""
    _bound(args)
    from persem_ros.convert.uavscenes.convert import convert_uavscenes, UavscenesOptions
    options = UavscenesOptions(
        **{name: getattr(args, name) for name in (
            'interval', 'predictions', 'depth', 'depth_unit', 'lidar', 'calibration', 'camera',
            'scale', 'frames', 'every')},
        depth_invalid=_integers('--depth-invalid', args.depth_invalid), color=not args.no_color,
        check=not args.no_check)
    summary = convert_uavscenes(args.root, args.run_name, args.out, options, _legend(args),
                                storage=args.storage, compress=args.compress, force=args.force)
    print(f'{args.out}: {summary}')


def run_forest(args: Namespace) -> None:
    """Convert a sequence of Forest Inspection."""
    _bound(args)
    from persem_ros.convert.forest.convert import convert_forest
    from persem_ros.convert.forest.layout import ForestOptions
    options = ForestOptions(
        **{name: getattr(args, name) for name in (
            'labels', 'depth', 'color', 'pose', 'predictions', 'depth_unit', 'depth_coding',
            'depth_is', 'intrinsics', 'fov', 'axes', 'world', 'pitch', 'rate', 'start', 'scale',
            'frames', 'every')},
        direction=args.pose_is, check=not args.no_check)
    summary = convert_forest(args.root, args.run_name, args.out, options, _legend(args),
                             storage=args.storage, compress=args.compress, force=args.force)
    print(f'{args.out}: {summary}')


def _bound(args: Namespace) -> None:
    """Set the bound of --max-pixels."""
    from persem_ros.errors import PersemError
    from persem_ros.guard import limits
    if args.max_pixels < 1:
        raise PersemError(f'--max-pixels {args.max_pixels}: expected 1 or more')
    limits.use(args.max_pixels)


def _legend(args: Namespace) -> Legend | None:
    """Return the Legend that --legend names, None where it names none."""
    from persem_ros.settings.legend_files import load_legend
    return load_legend(args.legend) if args.legend else None


def _integers(flag: str, text: str) -> tuple[int, ...]:
    """Return 'N,N' as integers."""
    from persem_ros.errors import PersemError
    try:
        return tuple(int(word) for word in text.split(',') if word.strip())
    except ValueError:
        raise PersemError(f'{flag} {text}: expected integers with commas') from None
