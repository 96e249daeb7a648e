"""Point clouds to points and labels."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.frames import IGNORED
from persem_ros.inputs.decode.messages import BadMessage

TYPE = 'sensor_msgs/msg/PointCloud2'
KINDS = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}
REACH = 1 << 31         # ids beyond this are no ids, and casting them is undefined


def structured(msg: Any) -> NDArray[Any]:
    """
    Return the points of a sensor_msgs/PointCloud2 as a structured array (height, width).

    Raises
    ------
    BadMessage
        Fields outside of their point, data too short, zero size.

    """
    order = '>' if msg.is_bigendian else '<'
    names, formats, offsets = [], [], []
    for field in msg.fields:
        kind = np.dtype(order + KINDS[field.datatype]) if field.datatype in KINDS \
            else None
        count = max(field.count, 1)
        if kind is None or not field.name or field.name in names \
                or field.offset + kind.itemsize * count > msg.point_step:
            raise BadMessage('damaged cloud', f'a point cloud has a field {field.name!r:.60} that '
                             f'does not fit into its point of {msg.point_step} bytes')
        names.append(field.name)
        formats.append(kind if count == 1 else (kind, (count,)))
        offsets.append(field.offset)
    data = np.frombuffer(msg.data, np.uint8)
    height, width = msg.height, msg.width
    if not height * width or not names:
        raise BadMessage('empty cloud', f'a point cloud has {height} x {width} points')
    row = max(msg.row_step, width * msg.point_step)
    if data.size < (height - 1) * row + width * msg.point_step:
        raise BadMessage('data too short', f'a point cloud has {data.size} bytes of data, '
                         f'expected {height} rows of {row}')
    dtype = np.dtype({'names': names, 'formats': formats, 'offsets': offsets,
                      'itemsize': msg.point_step})
    rows = [data[i * row:i * row + width * msg.point_step] for i in range(height)]
    return np.concatenate(rows).view(dtype).reshape(height, width)


def positions(cloud: NDArray[Any]) -> NDArray[np.float64]:
    """Return x y z of a structured cloud (h, w) as (h, w, 3), metres, NaN for no measurement."""
    missing = [axis for axis in 'xyz' if axis not in (cloud.dtype.names or ())]
    if missing:
        raise BadMessage('no position', f'a point cloud has no field {missing[0]!r}, expected '
                         f'x y z; its fields are {", ".join(cloud.dtype.names or ())}')
    several = [axis for axis in 'xyz' if cloud[axis].shape != cloud.shape]
    if several:
        raise BadMessage('field of several values', f'the field {several[0]!r} of a point cloud '
                         'has several values a point, expected one coordinate')
    points = np.stack([cloud[axis].astype(np.float64) for axis in 'xyz'], axis=-1)
    points[~np.isfinite(points).all(axis=-1)] = np.nan
    return points


def labels(cloud: NDArray[Any], field: str) -> NDArray[np.int32]:
    """Return the ids in a *field* of a structured cloud (h, w), int32; -1 for what is none."""
    if field not in (cloud.dtype.names or ()):
        names = [name for name in cloud.dtype.names or () if name not in ('x', 'y', 'z')]
        raise BadMessage('no such field', f'a point cloud has no field {field!r}; the label is '
                         f'in one of: --set points.label_field={" or ".join(names) or "..."}')
    values = cloud[field]
    if values.ndim != cloud.ndim:
        raise BadMessage('field of several values', f'the field {field!r} of a point cloud has '
                         f'{values.shape[-1]} values a point, expected one id')
    if values.dtype.kind == 'f':
        good = np.isfinite(values) & (np.abs(values) < REACH)
        ids = np.where(good, values, IGNORED).astype(np.int64)
        if (ids[good] != values[good]).any():
            raise BadMessage('field of no whole numbers', f'the field {field!r} of a point cloud '
                             'holds fractions, expected ids')
    else:
        ids = values.astype(np.int64)
    return np.where(np.abs(ids) < REACH, ids, IGNORED).astype(np.int32)
