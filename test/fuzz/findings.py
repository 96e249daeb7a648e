"""
Inputs that once crashed, hung, filled memory or ended in an internal error, as code.

FINDINGS is {name: (kind, what makes the input, words of the refusal)}; '' where it is accepted.
What makes a map is called with a path that holds a whole one and changes it; what makes a
recording gets {file name: bytes} of a whole one in 'mcap' or 'sqlite3' and returns another.

"""

from contextlib import closing, suppress
import sqlite3
import struct

import bags
import cv2
import numpy as np
from persem_ros.outputs.recording.messages import MessageFactory
from rosbags.typesys import get_typestore, Stores
from tampering import renew

PNG = b'\x89PNG\r\n\x1a\n'
HUGE = struct.pack('>I4sIIBBBBB', 13, b'IHDR', 60000, 45000, 8, 0, 0, 0, 0)


def _compressed(form, data):
    store = get_typestore(Stores.ROS2_JAZZY)
    make = MessageFactory(store.types)
    message = make.compressed(1, 'camera', form, bytes(data))
    kind = 'sensor_msgs/msg/CompressedImage'
    return kind, bytes(store.serialize_cdr(message, kind))


def _long_chunk():
    png = cv2.imencode('.png', np.zeros((6, 8), np.uint8))[1].tobytes()
    return _compressed('mono8; png compressed', png[:33] + b'\xff' * 8 + png[41:])


def _camera_info(**fields):
    store = get_typestore(Stores.ROS2_JAZZY)
    info = MessageFactory(store.types).camera_info(1, 'camera', 16, 12, bags.K)
    for name, value in fields.items():
        setattr(info, name, value)
    kind = 'sensor_msgs/msg/CameraInfo'
    return kind, bytes(store.serialize_cdr(info, kind))


def _cloud(**fields):
    store = get_typestore(Stores.ROS2_JAZZY)
    points = np.zeros(5, [('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('label', '<u2')])
    cloud = MessageFactory(store.types).cloud(1, 'camera', points)
    for name, value in fields.items():
        setattr(cloud.fields[0], name, value)
    kind = 'sensor_msgs/msg/PointCloud2'
    return kind, bytes(store.serialize_cdr(cloud, kind))


def _sql(*statements):
    def change(path):
        with closing(sqlite3.connect(path)) as db:
            for statement in statements:
                db.executescript(statement)
            db.commit()
        with suppress(sqlite3.OperationalError):    # a view may be endless
            renew(path)
    return change


def _column(name, kind, value):
    def change(path):
        with closing(sqlite3.connect(path)) as db:
            for key, data in list(db.execute(f'SELECT rowid, {name} FROM blocks')):
                data = np.full_like(np.frombuffer(data, kind), value).tobytes()
                db.execute(f'UPDATE blocks SET {name} = ? WHERE rowid = ?', (data, key))
            db.commit()
        renew(path)
    return change


TWICE = ('CREATE TABLE b AS SELECT * FROM blocks; DROP TABLE blocks; '
         'ALTER TABLE b RENAME TO blocks; INSERT INTO blocks SELECT * FROM blocks; '
         "UPDATE about SET value = 2 * value WHERE name IN ('blocks', 'voxels', 'observations')")
ENDLESS = ('ALTER TABLE frames RENAME TO was; CREATE VIEW frames AS WITH RECURSIVE n(i) AS '
           '(SELECT 1 UNION ALL SELECT i FROM n) SELECT was.* FROM was, n')

NULL = ('CREATE TABLE m (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB); '
        'INSERT INTO m SELECT id, topic_id, timestamp, NULL FROM messages; '
        'DROP TABLE messages; ALTER TABLE m RENAME TO messages')


def _lengths(files):
    """Return an mcap file whose first record says that it has 2^64 - 1 bytes, without its end."""
    name = next(name for name in files if name.endswith('.mcap'))
    data = files[name]
    return {name: data[:9] + b'\xff' * 8 + data[17:-300]}


def _short_index(files):
    """Return an mcap file whose last index of a chunk says of itself that it is longer."""
    name = next(name for name in files if name.endswith('.mcap'))
    data = bytearray(files[name])
    at = data.rindex(b'\x08', 0, data.rindex(b'\x0b'))
    while int.from_bytes(data[at + 1:at + 9], 'little') > 500:      # not the record itself
        at = data.rindex(b'\x08', 0, at)
    data[at + 9 + 32:at + 9 + 36] = b'\xff' * 4
    return {name: bytes(data)}


def _salvage(files):
    """Return an mcap file without index in which a chunk says that it unpacks to 4 GiB."""
    name = next(name for name in files if name.endswith('.mcap'))
    data = bytearray(files[name])
    at = data.index(b'\x06', 8)
    data[at + 25:at + 33] = struct.pack('<Q', 1 << 32)
    return {name: bytes(data[:-200])}


def _rows(statement):
    def change(files, folder):
        name = next(name for name in files if name.endswith('.db3'))
        path = folder / name
        path.write_bytes(files[name])
        with closing(sqlite3.connect(path)) as db:
            db.executescript(statement)
            db.commit()
        return files | {name: path.read_bytes()}
    return change


def _metadata(text):
    return lambda files: files | {'metadata.yaml': text.encode()}


BOMB = 'a: &a [x, x, x, x, x, x, x, x, x]\n' + ''.join(
    f'{c}: &{c} [{", ".join(["*" + chr(ord(c) - 1)] * 9)}]\n' for c in 'bcdefghi')
HEAD = '/**:\n  ros__parameters:\n    '
NOTHING = np.zeros(9)

FINDINGS = {
    'a chunk of 4 GiB in a PNG of 87 bytes': ('cdr', _long_chunk, 'cut off'),
    'a PNG of 2.7 billion pixels': (
        'cdr', lambda: _compressed('mono8; png compressed', PNG + HUGE), 'inputs.max_pixels='),
    'an RVL image of 2.7 billion pixels': (
        'cdr', lambda: _compressed('16UC1; compressedDepth rvl',
                                   bytes(12) + struct.pack('<II', 60000, 45000) + bytes(16)),
        'inputs.max_pixels='),
    'a camera without a lens': ('cdr', lambda: _camera_info(k=NOTHING, p=np.zeros(12)), 'K'),
    'a camera whose lens is nowhere': (
        'cdr', lambda: _camera_info(k=NOTHING + np.nan, p=np.zeros(12) + np.nan), 'K'),
    'a text of 4 GiB in a message': (
        'cdr', lambda: ('std_msgs/msg/String', b'\0\1\0\0' + b'\xff' * 4 + b'abc\0'),
        'cannot be deserialized'),
    'a cloud with three x a point': ('cdr', lambda: _cloud(count=3), 'expected one coordinate'),
    'a cloud with 4 billion x a point': ('cdr', lambda: _cloud(count=2 ** 32 - 1), 'fit into'),
    'a legend of a billion values': ('legend', lambda: 'classes:\n' + BOMB, 'alias'),
    'a legend that holds itself': ('legend', lambda: '&a {classes: [*a]}', 'alias'),
    'a legend of 5000 levels': ('legend', lambda: 'classes: ' + '[' * 5000, '32 levels'),
    'an id of 6000 digits': (
        'legend', lambda: 'classes: [{id: ' + '9' * 6000 + ', name: a}]', 'file: '),
    'an id that is no number': ('legend', lambda: 'classes: [{id: !!int "", name: a}]',
                                'not YAML that can be read'),
    'a legend of dates': ('legend', lambda: 'classes: [{id: 1, name: 2001-13-45}]',
                          'not YAML that can be read'),
    'settings that hold themselves': ('settings', lambda: '/**: &a {ros__parameters: *a}',
                                      'alias'),
    'a setting that holds itself': ('settings', lambda: HEAD + 'memory: &a {voxel_size: *a}',
                                    'alias'),
    'a setting of 5000 levels': ('settings', lambda: HEAD + 'memory: ' + '{a: ' * 5000,
                                 '32 levels'),
    'a setting that is no time': ('settings', lambda: HEAD + 'memory.voxel_size: !!timestamp x',
                                  'memory.voxel_size'),
    'a setting of 12 000 digits': (
        'settings', lambda: HEAD + 'memory.stride: ' + '9' * 12_000, 'more than 10000 characters'),
    'a block twice': ('map', _sql(TWICE), 'a block twice'),
    'evidence whose shares are 0': ('map', _column('evidence_sum', '<f8', 5e-324), 'evidence'),
    'frames beyond the frame table': ('map', _column('history_frame', '<i4', 2_000_000_000),
                                      'frames of a history'),
    'confidences that are none': ('map', _column('history_confidence', '<f4', np.nan),
                                  'confidences'),
    'more observations than 32 bits hold': ('map', _column('observations', '<u4', 2 ** 32 - 2),
                                            'observations'),
    'a table of frames that never ends': ('map', _sql(ENDLESS), 'no plain table'),
    'nanoseconds of 6000 digits': (
        'track', lambda: ('a.csv', '#timestamp [ns],x,y,z,q_w,q_x,q_y,q_z\n' + '9' * 6000
                          + ',0,0,0,1,0,0,0\n'), '19 digits'),
    'a fix of 30 digits': ('track', lambda: ('fixes.csv', '9' * 30 + ',48,11,500\n'),
                           'expected a line a fix'),
    'an array whose header is no Python': (
        'picture', lambda: ('a.npy', b'\x93NUMPY\1\0\6\0{(\n\n\n\n' + bytes(64)), 'not an image'),
    'a picture of one number': ('picture', lambda: ('a.pgm', b'P5 1'), 'not an image'),
    'a text for a size': ('map', _sql("UPDATE about SET value = 'x' WHERE name = 'voxel_size'"),
                          'voxel_size'),
    'no size': ('map', _sql("DELETE FROM about WHERE name = 'voxel_size'"), 'voxel_size'),
    'no frames': ('map', _sql('DELETE FROM frames'), 'damaged'),
    'a frame without a pose': ('map', _sql('UPDATE frames SET T_map_sensor = NULL'), 'damaged'),
    'a name with NUL': (
        'map', _sql("UPDATE frames SET sensor = 'a' || char(0) || 'b'"), 'damaged'),
    'a legend in a map that holds itself': (
        'map', _sql("UPDATE about SET value = '&a {classes: [*a]}' WHERE name = 'legend'"),
        'alias'),
    'a record of 2^64 bytes': ('mcap', _lengths, 'cannot be read'),
    'a chunk of 4 GiB': ('mcap', _salvage, ''),
    'an index longer than its record': ('mcap', _short_index, ''),
    'metadata of a billion values': ('mcap', _metadata(BOMB), ''),
    'metadata that holds itself': ('mcap', _metadata('&a {rosbag2_bagfile_information: *a}'), ''),
    'messages of NULL': ('sqlite3', _rows(NULL), ''),
    'messages of text': ('sqlite3', _rows("UPDATE messages SET data = 'text'"), ''),
    'a topic of bytes': ('sqlite3', _rows("UPDATE topics SET name = x'00ff'"), ''),
    'times of text': ('sqlite3', _rows("UPDATE messages SET timestamp = 'now'"), '')}
