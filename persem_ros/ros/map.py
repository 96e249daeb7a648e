"""
The map out: ~/map, ~/map_changes, ~/legend and ~/label_info.

What the worker pays for the map is a copy of the records that changed, 100 000 voxels at a time.
Sorting, colouring and publishing happen on a thread of their own; docs/node.md says what was
measured.

"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
import logging
import time
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.changes import Changes
from persem_ros.outputs.map.mirror import Mirror
from persem_ros.ros.messages import cloud, label_info, LabelInfo
from persem_ros.ros.priority import stand_back
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

if TYPE_CHECKING:
    from persem_ros.core.memory.changes import Changed
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.settings.config import Map
    from persem_ros.settings.legend import Legend
    from rclpy.node import Node

log = logging.getLogger(__name__)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SLICE = 100_000     # voxels that are taken in or told at once
PATIENCE = 1.0      # s that the map may wait for slices that are still to be taken in


class MapOutputs:
    """
    Publishers of the map.

    Parameters
    ----------
    node : rclpy.node.Node
    map_frame : str
        The setting frames.map.
    legend : callable
        legend() gives the one in force.

    """

    def __init__(self, node: Node, map_frame: str, legend: Callable[[], Legend]) -> None:
        """Advertise the topics and publish the legend."""
        self._frame, self._legend = map_frame, legend
        self._map = node.create_publisher(PointCloud2, '~/map', LATCHED)
        self._changes = node.create_publisher(PointCloud2, '~/map_changes', QoSProfile(depth=10))
        self._text = node.create_publisher(String, '~/legend', LATCHED)
        self._info = LabelInfo and node.create_publisher(LabelInfo, '~/label_info', LATCHED)
        self._told: Legend | None = None
        self._thread = ThreadPoolExecutor(1, 'map', stand_back)
        self._job: Future[None] | None = None
        self._listeners = {'map': 0, 'changes': 0}
        self._changes_since = Changes()
        self._mirror: Mirror | None = None
        # When the map began to wait for more slices.
        self._behind_since: float | None = None
        self.publish_legend()

    def publish_legend(self) -> None:
        """Publish the legend in force, where it is another than before."""
        legend = self._legend()
        if legend is self._told:
            return
        self._told = legend
        self._text.publish(String(data=legend.to_yaml()))
        if self._info is not None:
            self._info.publish(label_info(legend))

    @property
    def busy(self) -> bool:
        """Whether the last map is still being published."""
        return self._job is not None and not self._job.done()

    @property
    def waiting(self) -> bool:
        """Whether listeners to the changes are not told everything yet."""
        return self._mirror is not None and self._mirror.waiting

    @property
    def caught_up(self) -> bool:
        """Whether the last look found no more than it took."""
        return self._behind_since is None

    @property
    def whole(self) -> bool:
        """Whether all that had changed at the last look is taken in."""
        return self._mirror is not None and self._mirror.complete

    def wanted(self) -> tuple[set[str], set[str]]:
        """Return which of 'map' and 'changes' somebody listens to, and what is new to somebody."""
        now = {name: out.get_subscription_count()
               for name, out in (('map', self._map), ('changes', self._changes))}
        before, self._listeners = self._listeners, now
        return ({name for name, count in now.items() if count},
                {name for name, count in now.items() if count > before[name]})

    def publish(self, wanted: set[str], new: bool, memory: VoxelMemory, stamp: int,
                centre: NDArray[np.float64], settings: Map) -> set[str]:
        """
        Publish beside the mapping; the worker calls this while nothing is being published.

        Parameters
        ----------
        wanted : set
            'map', 'changes': what is to be published now. The map waits until it is whole, but
            not for longer than PATIENCE: under overload more may change than is taken in. What
            it lacks then is what is farthest from the camera.
        new : bool
            Somebody listens to the changes who did not before.
        memory : VoxelMemory
            The map.
        stamp : int
            Of the last frame, ns.
        centre : ndarray, shape (3,)
            The camera in the map, metres.
        settings : Map
            Crop, cap and least observations.

        Returns
        -------
        set
            What of *wanted* is published.

        """
        if self._mirror is None:
            self._mirror = Mirror(memory.voxel_size, self._legend())
        changed = self._changes_since.take(memory, centre, SLICE)
        if changed.complete:
            self._behind_since = None
        else:
            now = time.monotonic()
            self._behind_since = self._behind_since or now
            if now - self._behind_since < PATIENCE:
                wanted = wanted - {'map'}
        self._job = self._thread.submit(self._publish, self._mirror, wanted, new, changed, stamp,
                                        centre - memory.origin, settings)
        return wanted

    def forget(self) -> None:
        """Forget what was published: nobody listens."""
        self._changes_since.close()
        self._mirror = self._behind_since = None

    def close(self) -> None:
        """Wait for what is being published."""
        self._thread.shutdown()

    def _publish(self, mirror: Mirror, wanted: set[str], new: bool, changed: Changed, stamp: int,
                 centre: NDArray[np.float64], settings: Map) -> None:
        try:
            mirror.update(changed)
            mirror.recolour(self._legend())
            if new:
                mirror.tell_all()
            if 'changes' in wanted:
                points = mirror.difference(centre, SLICE)
                if len(points):
                    self._changes.publish(cloud(stamp, self._frame, points))
            elif not self._listeners['changes']:
                mirror.told()
            if 'map' in wanted:
                self._map.publish(cloud(stamp, self._frame, mirror.shown(centre, settings)))
        except Exception:       # noqa: B902  whatever it is, mapping goes on
            log.exception('the map could not be published')
            self._mirror = None     # begin anew
