"""
The map out: ~/map, ~/map_changes, ~/legend and ~/label_info.

What the worker pays for the map is a copy of the voxels' records. Sorting, colouring and
publishing happen on a thread of their own; docs/node.md says what was measured.

"""

from concurrent.futures import ThreadPoolExecutor
import logging

import numpy as np
from persem_ros.core.jit import work_alone
from persem_ros.core.memory.voxel_memory import ordered
from persem_ros.outputs.map.cloud import map_points, POINT
from persem_ros.ros.messages import cloud, label_info, LabelInfo
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

log = logging.getLogger(__name__)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
COMPARED = ('label', 'observations', 'source')


class MapOutputs:
    """
    Publishers of the map.

    Parameters
    ----------
    node : rclpy.node.Node
    map_frame : str
        The setting frames.map.
    legend : callable
        legend() gives the persem_ros.settings.legend.Legend in force.

    """

    def __init__(self, node, map_frame, legend):
        """Advertise the topics and publish the legend."""
        self._frame, self._legend = map_frame, legend
        self._map = node.create_publisher(PointCloud2, '~/map', LATCHED)
        self._changes = node.create_publisher(PointCloud2, '~/map_changes', QoSProfile(depth=10))
        self._text = node.create_publisher(String, '~/legend', LATCHED)
        self._info = LabelInfo and node.create_publisher(LabelInfo, '~/label_info', LATCHED)
        self._told = None
        self._thread = ThreadPoolExecutor(1, 'map', work_alone)
        self._job = None
        self._listeners = {'map': 0, 'changes': 0}
        self._alive = node.context.ok
        self._known = Known()
        self.publish_legend()

    def publish_legend(self):
        """Publish the legend in force, where it is another than before."""
        legend = self._legend()
        if legend is self._told:
            return
        self._told = legend
        self._text.publish(String(data=legend.to_yaml()))
        if self._info is not None:
            self._info.publish(label_info(legend))

    @property
    def busy(self):
        """Whether the last map is still being published."""
        return self._job is not None and not self._job.done()

    def wanted(self):
        """Return which of 'map' and 'changes' somebody listens to, and what is new to somebody."""
        now = {name: out.get_subscription_count()
               for name, out in (('map', self._map), ('changes', self._changes))}
        before, self._listeners = self._listeners, now
        return ({name for name, count in now.items() if count},
                {name for name, count in now.items() if count > before[name]})

    def publish(self, wanted, columns, voxel_size, stamp, centre, settings):
        """
        Publish the map beside the mapping.

        Parameters
        ----------
        wanted : set of str
            'map', 'changes'.
        columns : dict
            VoxelMemory.columns().
        voxel_size : float
            Metres.
        stamp : int
            Of the last frame, ns.
        centre : ndarray, shape (3,)
            The camera in the map, metres, map.origin taken off.
        settings : persem_ros.settings.config.Map
            Crop, cap and least observations.

        """
        self._job = self._thread.submit(self._publish, wanted, columns, voxel_size, stamp, centre,
                                        settings)

    def forget(self):
        """Let the next changes be told from nothing known (nobody listened meanwhile)."""
        self._known = Known()

    def close(self):
        """Wait for what is being published."""
        self._thread.shutdown()

    def _publish(self, wanted, columns, voxel_size, stamp, centre, settings):
        try:
            columns = ordered(columns)
            if 'changes' in wanted:
                changed, gone = self._known.update(columns)
                points = np.zeros(len(changed['voxel']) + len(gone), POINT)
                points[len(gone):] = self._points(changed, voxel_size)
                for axis, name in enumerate('xyz'):     # observations stay 0: removed
                    points[name][:len(gone)] = (gone[:, axis] + 0.5) * voxel_size
                if len(points):
                    self._changes.publish(cloud(stamp, self._frame, points))
            if 'map' in wanted:
                shown = selection(columns, voxel_size, centre, settings)
                self._map.publish(cloud(stamp, self._frame, self._points(shown, voxel_size)))
        except Exception:       # noqa: B902  whatever it is, mapping goes on
            log.exception('the map could not be published')

    def _points(self, columns, voxel_size):
        return map_points(columns, voxel_size, self._legend())


class Known:
    """What was last told of each voxel, so that the next message holds only what differs."""

    def __init__(self):
        """Know nothing."""
        self._voxel = np.zeros((0, 3), np.int32)
        self._told = {name: np.zeros(0, np.uint32) for name in COMPARED}

    def update(self, columns):
        """Return the columns of new and changed voxels, and the indices (m, 3) of lost ones."""
        number = columns['number']
        size = max(len(self._voxel), int(number.max()) + 1 if len(number) else 0)
        voxel = np.zeros((size, 3), np.int32)
        voxel[number] = columns['voxel']
        told = {}
        for name in COMPARED:
            told[name] = np.zeros(size, np.uint32)
            told[name][number] = columns[name]
        old = len(self._voxel)
        moved = np.zeros(size, bool)        # a voxel's number is now another voxel's
        moved[:old] = (voxel[:old] != self._voxel).any(axis=1)
        differs = moved.copy()
        differs[old:] = True
        for name in COMPARED:
            differs[:old] |= told[name][:old] != self._told[name]
        lost = self._voxel[(self._told['observations'] > 0)
                           & (moved[:old] | (told['observations'][:old] == 0))]
        self._voxel, self._told = voxel, told
        rows = differs[number]
        lost = lost[~_among(lost, columns['voxel'])]
        return {name: column[rows] for name, column in columns.items()}, lost


def selection(columns, voxel_size, centre, settings):
    """Return the columns of the voxels that ~/map shows, in their order."""
    rows = columns['observations'] >= settings.min_observations
    if settings.crop > 0:
        offset = (columns['voxel'] + 0.5) * voxel_size - centre
        rows &= np.einsum('ij,ij->i', offset, offset) <= settings.crop ** 2
    chosen = np.flatnonzero(rows)
    if 0 < settings.max_voxels < len(chosen):
        counts = columns['observations'][chosen].astype(np.int64)
        most = np.argsort(-counts, kind='stable')[:settings.max_voxels]
        chosen = np.sort(chosen[most])
    return {name: column[chosen] for name, column in columns.items()}


def _among(voxels, others):
    """Return which rows of *voxels* (n, 3) occur in *others* (m, 3)."""
    if not len(voxels) or not len(others):
        return np.zeros(len(voxels), bool)
    row = np.dtype((np.void, 12))
    return np.isin(np.ascontiguousarray(voxels).view(row).ravel(),
                   np.ascontiguousarray(others).view(row).ravel())
