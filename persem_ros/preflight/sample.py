"""What the checks may look at: first messages, stamps, frames, poses; of a recording or live."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from persem_ros.frames import Camera
from persem_ros.inputs.assemble import is_cloud
from persem_ros.inputs.decode import messages
from persem_ros.inputs.sync.poses import PoseBuffer
from persem_ros.settings.config import Config
from persem_ros.settings.legend import Legend

Stamps = NDArray[np.int64]


class Shot(NamedTuple):
    """
    The depth of one instant.

    Attributes
    ----------
    depth : ndarray, shape (H, W), float64
        Metres along the optical axis; 0 is no measurement.
    camera : Camera
        Of the depth image.

    """

    depth: NDArray[np.float64]
    camera: Camera


def no_shots(stamps: Iterable[int], config: Config) -> dict[int, Shot]:
    """Return no depth at all: a node keeps no images for checks."""
    return {}


@dataclass
class View:
    """
    What is known of one camera.

    Attributes
    ----------
    name : str
        The camera's, '' where there is only one.
    topics : dict of str to str
        Topic names by role: 'labels', 'depth', 'camera_info', 'pose' (not with pose.source tf)
        and, where they are used, 'truth' and 'color'.
    firsts : dict of str to list of message
        The first messages of each role that can be decoded and one of the middle, in order.
    stamps : dict of str to ndarray, int64
        Header stamps by role, ns, in the order of arrival.
    times : dict of str to ndarray, int64
        When these messages arrived, by the recorder's clock.
    poses : PoseBuffer
        All poses and transforms of the camera's robot.
    shots : callable
        shots(stamps, config) reads the depth images with these stamps: {stamp: Shot}. Of a node:
        none.
    within : callable
        within(role, kept) gives the firsts of a role among the messages of a mask (N,).
    given : str
        The setting camera.frame, or that of the camera.

    """

    name: str
    topics: Mapping[str, str]
    firsts: Mapping[str, list[Any]]
    stamps: Mapping[str, Stamps]
    times: Mapping[str, Stamps]
    poses: PoseBuffer
    shots: Callable[[Iterable[int], Config], dict[int, Shot]] = no_shots
    within: Callable[[str, NDArray[np.bool_]], list[Any]] = lambda role, kept: []
    given: str = ''

    def frame(self, role: str) -> str:
        """Return the frame that the first message of a role is in, '' where it is not said."""
        firsts = self.firsts.get(role)
        if self.given and not (firsts and is_cloud(firsts[0])):
            return self.given
        return messages.frame_id(firsts[0]) if firsts else ''

    @property
    def image_frame(self) -> str:
        """Return the frame whose place in the map is looked up."""
        return self.frame('depth') or self.frame('labels') or self.frame('camera_info')

    @property
    def frame_setting(self) -> str:
        """Return the name of the setting that says which frame its images are in."""
        return f'cameras.{self.name}.frame' if self.name else 'camera.frame'

    def setting(self, role: str) -> str:
        """Return the name of the setting that says which topic has a role."""
        return f'cameras.{self.name}.topics.{role}' if self.name else f'topics.{role}'


@dataclass
class Sample:
    """
    What the checks look at.

    Attributes
    ----------
    config : Config
        The settings in force; a check later in the order sees what an earlier one took.
    views : list of View
        The cameras.
    live : bool
        Whether a node looks, which has seen the past only and chooses nothing by itself.
    info_frames : dict of str to str
        The frames of all topics with camera infos, by topic, used or not.
    stereo : dict of str to float
        Focal length x baseline, pixels x metres, of the topics with camera infos that say it.
    legend : Legend, optional
        Whose colours the label images may have.
    own_legend : Legend, optional
        What the recorded ids are called: another one where ids follow their names.
    tf : dict of str to dict of str to set of str
        By camera: the frames in the transforms of each namespace that could be its robot's.

    """

    config: Config
    views: list[View]
    live: bool = False
    info_frames: Mapping[str, str] = field(default_factory=dict)
    stereo: Mapping[str, float] = field(default_factory=dict)
    legend: Legend | None = None
    own_legend: Legend | None = None
    tf: Mapping[str, Mapping[str, set[str]]] = field(default_factory=dict)
