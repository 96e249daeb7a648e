"""What is said beside the images of a recording: static transforms and names of classes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.inputs.decode import legends as legend_tables, pose_messages
from persem_ros.inputs.decode.messages import BadMessage

if TYPE_CHECKING:
    from persem_ros.inputs.decode.legends import Table
    from persem_ros.inputs.recording.source import Source, TopicInfo
    from persem_ros.inputs.recording.topics import Choice

Static = tuple[NDArray[np.float64], str, str]       # T_parent_child, parent, child


@dataclass
class Latched:
    """
    The content of /tf_static and of the legend topic.

    Attributes
    ----------
    statics : list
        T_parent_child (4, 4), parent, child.
    tables : list
        Names of classes in the order of the recording; those of a topic that changes.
    faults : list
        Sentences about what could not be used.
    sources : list
        The topic of each static transform.

    """

    statics: list[Static] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    sources: list[str] = field(default_factory=list)

    def of(self, topics: Iterable[TopicInfo]) -> list[Static]:
        """Return the static transforms of some topics, as in *statics*."""
        names = {topic.name for topic in topics}
        return [found for found, name in zip(self.statics, self.sources, strict=True)
                if name in names]


def read(source: Source, choice: Choice) -> Latched:
    """
    Read static transforms and names of classes, wherever in the recording they are.

    Parameters
    ----------
    source : Source
        The open recording.
    choice : Choice
        Its topics.

    Returns
    -------
    Latched
        All of them; where a frame has several parents the last one holds.

    """
    found = Latched()
    topics = choice.tf_static + choice.legends
    legends = {topic.name for topic in choice.legends}
    bad: dict[str, str] = {}        # topic -> why its first message that was not used was not
    # Topic -> the message before: some publish the same with every image.
    last: dict[str, bytes] = {}
    # Counted, so that the search ends with the last of them and not with the recording.
    wanted = islice(source.messages({topic.name for topic in topics}),
                    sum(topic.count for topic in topics))
    for name, kind, _, data in wanted:
        try:
            if name in legends:
                if last.get(name) != data:
                    found.tables.append(legend_tables.table(source.decode(data, kind)))
                last[name] = bytes(data)
                continue
            msg = source.decode(data, kind)
        except BadMessage as fault:
            bad.setdefault(name, f'{name}: a message was not used: {fault}')
            continue
        good, faults = pose_messages.transforms(msg)
        found.statics += [pose[1:] for pose in good]
        found.sources += [name] * len(good)
        found.faults += [f'{name}: a transform was not used: {fault}' for fault in faults]
    found.faults += bad.values()
    return found
