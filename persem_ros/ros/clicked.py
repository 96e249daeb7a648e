"""
Why is this red? A clicked_point (RViz: Publish Point) is answered on two topics.

~/explanation has the sentences of `persem map query`; ~/explanation_marker shows the voxel and
the rays from which it was seen, coloured by what they said.

"""

from __future__ import annotations

from dataclasses import replace
import logging
from typing import Any, TYPE_CHECKING

from geometry_msgs.msg import Point, PointStamped
import numpy as np
from numpy.typing import NDArray
from persem_ros.core.refine.explain import explain, quickly
from persem_ros.inputs.decode.messages import frame_id, stamp_ns
from persem_ros.outputs.map.explanation import explanation, names, Surroundings
from persem_ros.ros.messages import header
from std_msgs.msg import ColorRGBA, String
from visualization_msgs.msg import Marker, MarkerArray

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory

log = logging.getLogger(__name__)
AROUND = 2              # voxels around a click that are tried where nothing was seen
RAYS = 200              # the newest observations that are drawn
NOT_YET = ('the method geometry has not labelled this voxel yet: ask again after the next '
           'refinement')


class ClickedPoint:
    """
    Answers clicks.

    Parameters
    ----------
    node : rclpy.node.Node
        Has the worker, the legend in force (colors()) and the inputs, whose pose buffers tie the
        frame of a click to the map.

    """

    def __init__(self, node: Any) -> None:
        """Subscribe and advertise."""
        self._node = node
        self._text = node.create_publisher(String, '~/explanation', 10)
        self._markers = node.create_publisher(MarkerArray, '~/explanation_marker', 10)
        node.create_subscription(PointStamped, 'clicked_point', self._clicked, 10)

    def _clicked(self, msg: Any) -> None:
        """Have the worker, which owns the map, answer between two frames."""
        self._node.worker.call(self._answered, msg)

    def _answered(self, msg: Any) -> None:
        """Publish the answer to a click."""
        worker = self._node.worker
        memory, config = worker.memory, worker.config
        point, why = self._in_map(msg, config.frames.map)
        voxel = None if point is None else voxel_near(memory, point)
        if point is None or voxel is None:
            if point is not None:
                why = (f'nothing was observed within {AROUND} voxels of {_words(point)} m in '
                       f'{config.frames.map}')
            self._text.publish(String(data=why))
            self._markers.publish(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]))
            return
        legend, settings, notes = self._node.colors(), config.refine, ''
        if not quickly(memory, voxel, settings):
            settings, notes = replace(settings, method='majority'), f'\n{NOT_YET}'
        trace = explain(memory, voxel, settings)
        around = Surroundings(memory.voxel_size, memory.origin, config.frames.map, memory.frames,
                              config.refine if not notes else settings, legend)
        self._text.publish(String(data=explanation(around, voxel, trace) + notes))
        self._markers.publish(MarkerArray(markers=markers(
            memory, voxel, legend, header(stamp_ns(msg), config.frames.map))))

    def _in_map(self, msg: Any, map_frame: str) -> tuple[NDArray[np.float64] | None, str]:
        """Return a click in the map frame, map.origin taken off, or None and why."""
        point = np.array([msg.point.x, msg.point.y, msg.point.z])
        frame = frame_id(msg)
        if not np.isfinite(point).all():
            return None, f'clicked_point: expected three finite numbers, got {_words(point)}'
        if frame in ('', map_frame):
            return point, ''
        for buffer in self._node.inputs.pose_buffers:
            for stamp in (stamp_ns(msg), buffer.newest(frame)):
                found = None if stamp is None else buffer.tie(map_frame, frame, stamp)
                if found is not None and found.T is None and buffer.child and \
                        buffer.tree.connected(buffer.child, frame):
                    found = buffer.lookup(stamp, frame)
                if found is not None and found.T is not None:
                    origin = np.array(self._node.worker.memory.origin)
                    return found.T[:3, :3] @ point + found.T[:3, 3] - origin, ''
        return None, (f'clicked_point: its frame {frame!r} is not connected to {map_frame!r} by '
                      f'/tf or the poses; choose {map_frame} as the fixed frame of RViz')


def voxel_near(memory: VoxelMemory, point: NDArray[np.float64]) -> NDArray[np.int32] | None:
    """Return the observed voxel at a point (map.origin taken off), or the nearest around it."""
    place = point / memory.voxel_size
    if not (np.abs(place) < 2 ** 31 - 16).all():
        return None
    reach = np.arange(-AROUND, AROUND + 1)
    offsets = np.stack(np.meshgrid(reach, reach, reach, indexing='ij'), axis=-1).reshape(-1, 3)
    around = (np.floor(place).astype(np.int64) + offsets).astype(np.int32)
    there = around[memory.find(around) >= 0]
    if not len(there):
        return None
    within = (np.floor(place) == there).all(axis=1)
    away = np.where(within, -1.0, np.linalg.norm(there + 0.5 - place, axis=1))
    return there[int(np.argmin(away))]


def markers(memory: VoxelMemory, voxel: NDArray[np.int32], legend: Any, head: Any) -> list[Any]:
    """Return the voxel, its text and the rays from which it was seen as Markers."""
    label = int(memory.m.voxels[memory.number(voxel)]['label'])
    labels, _, frames, offsets = memory.sightings(voxel)
    labels, frames, offsets = labels[-RAYS:], frames[-RAYS:], offsets[-RAYS:]
    size, origin = memory.voxel_size, np.array(memory.origin)
    centre = (voxel + 0.5) * size
    eyes = memory.frames.here('placed')[frames, :3, 3] - origin
    ends = (voxel + (offsets + 0.5) / 256) * size
    # Who looks at the map stands as far away as the sensor did: a share of that is to be seen.
    away = float(np.median(np.linalg.norm(eyes - ends, axis=1))) if len(eyes) else 0.0
    cube = _marker(head, 0, Marker.CUBE, [1.1 * size] * 3, _color(legend, label, 0.8), centre)
    text = _marker(head, 1, Marker.TEXT_VIEW_FACING, [0.0, 0.0, max(size, 0.04 * away)],
                   ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0),
                   centre + [0.0, 0.0, size + 0.03 * away])
    n = int(memory.m.voxels[memory.number(voxel)]['n'])
    text.text = f'{names(legend)(label)}, {n} observations'
    rays = _marker(head, 2, Marker.LINE_LIST, [max(0.05 * size, 0.004 * away), 0.0, 0.0],
                   ColorRGBA(a=1.0), None)
    for c, eye, end in zip(labels.tolist(), eyes, ends):
        rays.points += [_point(eye), _point(end)]
        rays.colors += [_color(legend, c, 1.0)] * 2
    return [cube, text, rays]


def _marker(head: Any, number: int, kind: int, scale: list[float], color: Any,
            place: Any) -> Any:
    """Return a Marker of the explanation."""
    marker = Marker(header=head, ns='explanation', id=number, type=kind, action=Marker.ADD,
                    color=color)
    marker.scale.x, marker.scale.y, marker.scale.z = (float(x) for x in scale)
    marker.pose.orientation.w = 1.0
    if place is not None:
        marker.pose.position = _point(place)
    return marker


def _point(xyz: Any) -> Any:
    return Point(x=float(xyz[0]), y=float(xyz[1]), z=float(xyz[2]))


def _color(legend: Any, label: int, alpha: float) -> Any:
    red, green, blue = (v / 255 for v in legend.color(label))
    return ColorRGBA(r=red, g=green, b=blue, a=alpha)


def _words(point: NDArray[np.float64]) -> str:
    return ' '.join(f'{x:.2f}' for x in point)
