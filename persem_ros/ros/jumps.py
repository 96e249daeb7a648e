"""Says once that a localisation has corrected itself, and which topic would move the map."""

from __future__ import annotations

from collections.abc import Sequence
import logging
from typing import TYPE_CHECKING

from persem_ros.inputs.sync.jump import jumped
from persem_ros.inputs.sync.poses import PoseBuffer

if TYPE_CHECKING:
    from persem_ros.inputs.intake import Taker
    from persem_ros.settings.config import Config

log = logging.getLogger(__name__)
JUMP = 0.3              # m that a localisation goes at once where it jumps, or voxels if larger


class Jumps:
    """
    Looks at transforms of /tf as they come, on the worker's thread.

    Parameters
    ----------
    config : Config
        Where topics.trajectory names a topic there is nothing to say: the map moves with it.

    """

    def __init__(self, config: Config) -> None:
        """Nothing was said yet."""
        self._watching = not config.topics.trajectory

    def look(self, takers: Sequence[Taker], config: Config) -> None:
        """Look at the newest transforms of pose buffers; warn of the first jump."""
        for buffer in takers if self._watching else ():
            assert isinstance(buffer, PoseBuffer)       # it listens to /tf
            said = jumped(buffer, max(JUMP, config.memory.voxel_size))
            if said:
                self._watching = False
                log.warning('%s; topics.trajectory takes the corrected path (nav_msgs/Path) and '
                            'moves the map, persem map move does so afterwards', said)
                return
