"""What is said once for a whole recording: static transforms and the legend."""

from dataclasses import dataclass, field
from itertools import islice

from persem_ros.inputs.decode import messages
from persem_ros.inputs.decode.messages import BadMessage


@dataclass
class Latched:
    """
    The content of /tf_static and of the legend topic.

    Attributes
    ----------
    statics : list of (ndarray (4, 4), str, str)
        T_parent_child, parent, child.
    legend : str
        YAML, '' where there is none.
    faults : list of str
        Sentences about what could not be used.

    """

    statics: list = field(default_factory=list)
    legend: str = ''
    faults: list = field(default_factory=list)


def read(source, choice):
    """
    Read static transforms and legend, wherever in the recording they are.

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
    # Counted, so that the search ends with the last of them and not with the recording.
    wanted = islice(source.messages({topic.name for topic in topics}),
                    sum(topic.count for topic in topics))
    for name, kind, _, data in wanted:
        try:
            msg = source.decode(data, kind)
        except BadMessage as fault:
            found.faults.append(f'{name}: a message was not used: {fault}')
            continue
        if name in legends:
            found.legend = msg.data
            continue
        good, faults = messages.transforms(msg)
        found.statics += [pose[1:] for pose in good]
        found.faults += [f'{name}: a transform was not used: {fault}' for fault in faults]
    return found
