"""Tables of class names as they come on topics: YAML, JSON of Isaac Sim, vision_msgs/LabelInfo."""

from __future__ import annotations

import json
import re
from typing import Any, NamedTuple

from persem_ros.errors import PersemError
from persem_ros.frames import MAX_ID
from persem_ros.guard.words import short
from persem_ros.inputs.decode.messages import BadMessage, stamp_ns
from persem_ros.settings.legend import Legend
from persem_ros.settings.legend_class import LegendClass
from persem_ros.settings.palette import made_up_colors

STRING = 'std_msgs/msg/String'
LABEL_INFO = 'vision_msgs/msg/LabelInfo'
TYPES = (STRING, LABEL_INFO)
DIGITS = 10                 # of an id, fewer
NO_LABEL = ('background', 'unlabelled', 'unlabeled')
COLOR = re.compile(r'\(?\s*(\d{1,9})\s*,\s*(\d{1,9})\s*,\s*(\d{1,9})\s*(?:,\s*\d{1,9}\s*)?\)?$')
LONGEST = 1 << 24           # characters of a JSON object; the longest of 65 535 names has a third


class Table(NamedTuple):
    """What ids mean from some moment on."""

    legend: Legend
    stamp: int | None       # ns, of the first image that it holds for; None: from its arrival


def table(msg: Any) -> Table:
    """
    Read a table of names.

    Parameters
    ----------
    msg : vision_msgs/LabelInfo or std_msgs/String
        The text is a legend in YAML, or a JSON object of ids (or colours) to names as Isaac Sim
        publishes it: {"2": {"class": "tree"}, "time_stamp": {"sec": 1, "nanosec": 2}}.

    Raises
    ------
    BadMessage
        When it is none of these.

    """
    if hasattr(msg, 'class_map'):
        names = {int(item.class_id): item.class_name for item in msg.class_map}
        return Table(_legend(names, {}), stamp_ns(msg))
    text = msg.data.strip()
    if text.startswith('{'):
        if len(text) > LONGEST:
            raise _unreadable(f'it has {len(text)} characters, more than {LONGEST}')
        try:
            content = json.loads(text)
        except (ValueError, RecursionError) as error:
            content = None if ':' not in text else str(error)
        if isinstance(content, dict) and 'classes' not in content:
            return _of_json(content)
    try:
        return Table(Legend.from_yaml(text), None)
    except PersemError as error:
        raise _unreadable(str(error)) from None


def _of_json(content: dict[str, Any]) -> Table:
    """Read Isaac Sim's object."""
    moment = content.pop('time_stamp', None)
    names: dict[int, str] = {}
    colors: dict[int, tuple[int, int, int]] = {}
    for key, value in content.items():
        name = value.get('class') if isinstance(value, dict) else value
        if isinstance(value, dict) and not isinstance(name, str):
            name = next((text for text in value.values() if isinstance(text, str)), None)
        number, color = str(key).strip(), COLOR.match(str(key).strip())
        if not isinstance(name, str) or not (
                color or number.isdecimal() and len(number) < DIGITS):
            raise _unreadable(f'{short(key)}: {short(value)} is no id with a name')
        at = len(names) if color else int(number)
        names[at] = name
        if color:
            red, green, blue = (min(int(part), 255) for part in color.groups())
            colors[at] = red, green, blue
    stamp = None
    if isinstance(moment, dict):
        parts = [moment.get('sec', 0), moment.get('nanosec', 0)]
        if all(type(part) is int and 0 <= part < 1 << 32 for part in parts):
            stamp = parts[0] * 10**9 + parts[1]
    return Table(_legend(names, colors), stamp)


def _legend(names: dict[int, str], colors: dict[int, tuple[int, int, int]]) -> Legend:
    """Return the legend of {id: name}; ids above 65534 mean "no label" and are left out."""
    rows = {i: name.strip() for i, name in names.items() if 0 <= i <= MAX_ID and name.strip()}
    if not rows:
        raise _unreadable('it names no class')
    made_up = {i: (red, green, blue) for i, (red, green, blue) in zip(
        rows, made_up_colors(list(rows)).tolist())}
    return Legend('', tuple(LegendClass(i, name, colors.get(i, made_up[i]), name,
                                        name.lower() in NO_LABEL)
                            for i, name in sorted(rows.items())))


def _unreadable(why: str) -> BadMessage:
    return BadMessage('not a table of names', f'a table of class names cannot be read: {why}; '
                      'expected vision_msgs/LabelInfo, a JSON object {"id": {"class": "name"}}, '
                      'or a legend in YAML')
