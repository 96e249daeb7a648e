"""What is said beside the images of a recording: static transforms and names of classes."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import islice
from typing import Any, TYPE_CHECKING

from persem_ros.inputs.decode import legends as legend_tables, messages
from persem_ros.inputs.decode.messages import BadMessage

if TYPE_CHECKING:
    from persem_ros.inputs.recording.source import Source
    from persem_ros.inputs.recording.topics import Choice


@dataclass
class Latched:
    """
    The content of /tf_static and of the legend topic.

    Attributes
    ----------
    statics : list of (ndarray (4, 4), str, str)
        T_parent_child, parent, child.
    tables : list of persem_ros.inputs.decode.legends.Table
        Names of classes in the order of the recording; those of a topic that changes.
    faults : list of str
        Sentences about what could not be used.
    sources : list of str
        The topic of each static transform.

    """

    statics: list = field(default_factory=list)
    tables: list = field(default_factory=list)
    faults: list = field(default_factory=list)
    sources: list = field(default_factory=list)

    def of(self, topics: Any) -> Any:
        """Return the static transforms of some topics (TopicInfo), as in *statics*."""
        names = {topic.name for topic in topics}
        return [found for found, name in zip(self.statics, self.sources, strict=True)
                if name in names]


def read(source: Source, choice: Choice) -> Latched:
    """
    Read static transforms and names of classes, wherever in the recording they are.

    Parameters
    ----------
    source : persem_ros.inputs.recording.source.Source
        The open recording.
    choice : persem_ros.inputs.recording.topics.Choice
        Its topics.

    Returns
    -------
    Latched
        All of them; where a frame has several parents the last one holds.

    """
    found = Latched()
    topics = choice.tf_static + choice.legends
    legends = {topic.name for topic in choice.legends}
    bad = {}        # topic -> why its first message that was not used was not
    last = {}       # topic -> the message before: some publish the same with every image
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
        good, faults = messages.transforms(msg)
        found.statics += [pose[1:] for pose in good]
        found.sources += [name] * len(good)
        found.faults += [f'{name}: a transform was not used: {fault}' for fault in faults]
    found.faults += bad.values()
    return found
