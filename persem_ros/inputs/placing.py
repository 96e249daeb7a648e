"""Where the camera of a match was, and how its depth is seen by the camera of its labels."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.transforms import inverse
from persem_ros.inputs.assemble import OTHER_CAMERA, other_camera_sentence
from persem_ros.inputs.decode import clouds
from persem_ros.inputs.sync.match import DEPTH, LABELS
from persem_ros.inputs.sync.no_pose import mount_sentence, other_frame_sentence
from persem_ros.inputs.sync.poses import NO_MOUNT, OTHER_FRAME, UNSAID
from persem_ros.inputs.sync.track import Lookup

if TYPE_CHECKING:
    from persem_ros.inputs.assemble import Assembler
    from persem_ros.inputs.sync.match import Match
    from persem_ros.inputs.sync.poses import PoseBuffer
    from persem_ros.settings.config import Config

TOO_FAR = 'position too far away'
VOXELS = 1 << 30        # from map.origin, within which a camera can be: voxels have 32 bits
NO_INFO = 'no camera info'
OTHER_INFO = 'camera info of another camera'
NO_TIE_YET = 'no transform between depth and labels'
NO_TIE = 'no transform between cloud and labels'
SAME = 1e-6         # between two matrices of one place, metres


class Placing:
    """
    Looks up the poses of matches.

    Parameters
    ----------
    config : persem_ros.settings.config.Config
        The settings map.origin and memory.voxel_size.
    examples : dict
        Gets one whole sentence for reasons that have one.
    no_mount : callable
        no_mount(reason, sentence) hears that poses do not lead to the camera, yet.
    untied : callable
        untied(frame_id, other): whether frames that nothing ties to each other are to be taken
        as one camera's.

    Attributes
    ----------
    missed : dict
        By reason, what a lookup without a pose was for: the buffer, stamp and frame asked for.

    """

    def __init__(self, config: Config, examples: dict[str, str],
                 no_mount: Callable[[str, str], None],
                 untied: Callable[[str, str], bool]) -> None:
        """Nothing was missed yet."""
        self.config = config
        self.missed: dict[str, tuple[PoseBuffer, int, str]] = {}
        self._examples, self._no_mount, self._untied = examples, no_mount, untied

    def lookup(self, poses: PoseBuffer, assembler: Assembler, match: Match) -> Lookup:
        """
        Return the pose of a match, once its camera is known.

        Where the depth is another camera's, or a LiDAR's, the match learns how these are tied.

        """
        labels, depth = match.items[LABELS], match.items.get(DEPTH)
        info_frame = assembler.frame_id
        if depth is None:       # a labelled cloud
            return self._found(poses, assembler, match.stamp, labels.frame_id)
        if info_frame is None:
            return Lookup(None, False, NO_INFO)
        lidar = depth.msgtype == clouds.TYPE
        given = assembler.given
        frame_id = given or (labels if lidar else depth).frame_id or labels.frame_id or info_frame
        if not given and not lidar and self._of_another(poses, info_frame, depth.frame_id):
            return Lookup(None, True, OTHER_INFO)
        found = self._found(poses, assembler, match.stamp, frame_id)
        if given and not lidar:
            return found
        other = (depth if lidar else labels).frame_id or frame_id
        if found.T is None or other == frame_id and not lidar:
            return found
        tied = self._tied(poses, assembler, match, found, frame_id, other, lidar)
        if tied.T is None or lidar or match.T_labels_depth is None or assembler.knows_labels:
            return tied
        self._examples[OTHER_CAMERA] = other_camera_sentence(
            other, frame_id, match.T_labels_depth)
        return Lookup(None, False, OTHER_CAMERA)

    def _of_another(self, poses: PoseBuffer, info: str, depth: str) -> bool:
        """Return whether static transforms say that a camera info is of another camera."""
        if depth in ('', info) or not info:
            return False
        T = poses.tree.chain(info, depth, None).T
        if T is None or np.abs(T - np.eye(4)).max() <= SAME:
            return False
        self._examples[OTHER_INFO] = (
            f'the camera info is of {info!r}, the depth images are of {depth!r}, which is another '
            'camera by /tf_static: --set topics.camera_info=TOPIC names that of the depth images')
        return True

    def _found(
            self, poses: PoseBuffer, assembler: Assembler, stamp: int, frame_id: str) -> Lookup:
        """Return the pose of a frame; where there is none, remember why."""
        found = poses.lookup(stamp, frame_id)
        if found.reason in (NO_MOUNT, UNSAID):
            self._no_mount(found.reason,
                           mount_sentence(poses, frame_id, assembler.frame_setting))
        elif found.reason == OTHER_FRAME:
            self._examples[OTHER_FRAME] = other_frame_sentence(poses)
        elif found.T is None:
            self.missed[found.reason] = poses, stamp, frame_id
        elif not self._within(found.T):
            self._examples.setdefault(TOO_FAR, (
                f'position {found.T[:3, 3].tolist()} m is too far away for voxels of '
                f'{self.config.memory.voxel_size} m: expected coordinates near map.origin'))
            return Lookup(None, True, TOO_FAR)
        return found

    def _tied(
            self, poses: PoseBuffer, assembler: Assembler, match: Match, found: Lookup,
            frame_id: str, other: str, lidar: bool
    ) -> Lookup:
        """
        Note how the depth of a match is seen by the labels' camera; return the depth's pose.

        *found* is the pose of *frame_id* at the stamp of the match, *other* the frame that TF
        has to tie to it: the LiDAR's, or that of labels whose depth is another camera's.

        """
        assert found.T is not None, 'without a pose there is nothing to tie'
        tie = poses.tie(frame_id, other, match.items[DEPTH].stamp if lidar else match.stamp)
        if tie.T is None and lidar:
            self._examples[NO_TIE] = (
                f'the cloud is in the frame {other!r}, the labels are in {frame_id!r}, and '
                '/tf_static does not connect them')
            return Lookup(None, tie.final, NO_TIE)
        if tie.T is None:
            if not self._untied(frame_id, other):
                return Lookup(None, False, NO_TIE_YET)
            return found        # nothing says that they are two cameras
        then = self._found(poses, assembler, match.items[DEPTH].stamp, frame_id)
        if then.T is None:
            return then
        if lidar:
            match.T_labels_depth = inverse(found.T) @ then.T @ tie.T
            return found
        T = inverse(found.T @ tie.T) @ then.T
        if np.abs(T - np.eye(4)).max() <= SAME:
            return found
        match.T_labels_depth = T
        return then

    def _within(self, T: NDArray[np.float64]) -> bool:
        """Return whether a pose (4, 4) is where voxels can be numbered."""
        away = np.abs(T[:3, 3] - np.array(self.config.map.origin)).max()
        return bool(away < VOXELS * self.config.memory.voxel_size)
