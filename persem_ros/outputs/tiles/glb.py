"""Points as a binary glTF 2.0: one draw call, one buffer, fields that others can read."""

from __future__ import annotations

import json
import struct

import numpy as np
from numpy.typing import NDArray
from persem_ros.outputs.tiles.cells import POINT

MAGIC, JSON, BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
U8, U16, F32 = 5121, 5123, 5126
ARRAY_BUFFER, POINTS = 34962, 0
# Attribute, field of POINT, component type, shape, whether 0 … 255 means 0 … 1.
ATTRIBUTES = (('POSITION', 'at', U8, 'VEC3', False), ('COLOR_0', 'color', U8, 'VEC4', True),
              ('_LABEL', 'label', U16, 'SCALAR', False),
              ('_MEASURES', 'confidence', U8, 'VEC4', False),
              ('_LAST_SEEN', 'last', F32, 'SCALAR', False))
OFFSETS = {name: entry[1] for name, entry in (POINT.fields or {}).items()}


def glb(points: NDArray[np.void], size: float, corner: NDArray[np.float64]) -> bytes:
    """
    Return points as the bytes of a .glb.

    Parameters
    ----------
    points : ndarray, shape (n,), POINT
        n > 0.
    size : float
        Edge of a cell, metres.
    corner : ndarray, shape (3,), float64
        Of cell 0 0 0, metres, z up.

    """
    data = points.tobytes()
    at = points['at'][:, :3]
    accessors = []
    for name, field, kind, shape, normalized in ATTRIBUTES:
        accessors.append({
            'bufferView': 0, 'byteOffset': OFFSETS[field], 'componentType': kind,
            'count': len(points), 'type': shape, **({'normalized': True} if normalized else {}),
            **({'min': at.min(axis=0).tolist(), 'max': at.max(axis=0).tolist()}
               if name == 'POSITION' else {})})
    x, y, z = (corner + size / 2).tolist()
    text = json.dumps({
        'asset': {'version': '2.0', 'generator': 'persem_ros'},
        'extensionsUsed': ['KHR_mesh_quantization'],
        'extensionsRequired': ['KHR_mesh_quantization'],
        'scene': 0, 'scenes': [{'nodes': [0]}],
        # Cells to metres, and z up to glTF's y up.
        'nodes': [{'mesh': 0, 'matrix': [size, 0, 0, 0, 0, 0, -size, 0, 0, size, 0, 0,
                                         x, z, -y, 1]}],
        'meshes': [{'primitives': [{'mode': POINTS, 'attributes': {
            name: k for k, (name, *_) in enumerate(ATTRIBUTES)}}]}],
        'accessors': accessors,
        'bufferViews': [{'buffer': 0, 'byteLength': len(data), 'byteStride': POINT.itemsize,
                         'target': ARRAY_BUFFER}],
        'buffers': [{'byteLength': len(data)}]}, separators=(',', ':')).encode()
    text += b' ' * (-len(text) % 4)
    return b''.join([struct.pack('<III', MAGIC, 2, 28 + len(text) + len(data)),
                     struct.pack('<II', len(text), JSON), text,
                     struct.pack('<II', len(data), BINARY), data])
