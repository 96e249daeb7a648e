"""Recordings that somebody spoiled: a message altered or left out, stamps out of order."""

import bags
from persem_ros.outputs.recording.writer import RecordingWriter

IMAGE = 'sensor_msgs/msg/Image'


def written(path, change, frames=5, storage='mcap', poses=True):
    """Write a recording whose messages change(kind, i, message) may alter, or drop by None."""
    def put(out, topic, at, kind, i, message):
        message = change(kind, i, message)
        if message is not None:
            out.message(topic, at, IMAGE if kind in ('labels', 'depth', 'truth')
                        else 'sensor_msgs/msg/CameraInfo', message)

    with RecordingWriter(path, storage=storage) as out:
        for i in range(frames):
            at = bags.stamp(i)
            if poses:
                out.pose('pose', at, 'map', bags.pose(i))
            put(out, 'depth/camera_info', at, 'info', i,
                out.make.camera_info(at, 'camera', 16, 12, bags.K))
            put(out, 'depth/image', at, 'depth', i,
                out.make.image(at, 'camera', bags.depth(i), '32FC1'))
            put(out, 'semantic/image', at, 'labels', i,
                out.make.image(at, 'camera', bags.labels(i), 'mono16'))
            put(out, 'semantic/truth', at, 'truth', i,
                out.make.image(at, 'camera', bags.labels(i), 'mono16'))
    return path


def spoiled(**fields):
    """Return a change that gives label and depth images other fields in frames 1 and 3."""
    def change(kind, i, msg):
        if (kind, i) in (('labels', 1), ('depth', 3)):
            for name, value in fields.items():
                setattr(msg, name, value(msg) if callable(value) else value)
        return msg
    return change


def sequence(path, stamps, poses=None):
    """Write label and depth images with the given header stamps, recorded one after another."""
    with RecordingWriter(path) as out:
        for i, at in enumerate(stamps):
            log = bags.stamp(i)
            at = bags.stamp(at)
            for topic, array, encoding in (('depth/image', bags.depth(i), '32FC1'),
                                           ('semantic/image', bags.labels(i), 'mono16')):
                out.message(topic, log, IMAGE, out.make.image(at, 'camera', array, encoding))
            for shift in (-0.5, 0.5):
                out.message('pose', log, *out.make.pose(
                    at + round(shift * bags.STEP), 'map', bags.pose(i)))
            out.message('depth/camera_info', log, 'sensor_msgs/msg/CameraInfo',
                        out.make.camera_info(at, 'camera', 16, 12, bags.K))
    return path
