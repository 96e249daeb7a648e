"""A look into the first messages of topics, before anything is read in order."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from typing import Any, TYPE_CHECKING

from persem_ros.inputs.decode import pose_messages
from persem_ros.inputs.decode.messages import BadMessage

if TYPE_CHECKING:
    from persem_ros.inputs.recording.source import Source

TRIED = 10          # messages of a topic that are decoded to find a good one


def first_messages(source: Source, names: set[str]) -> dict[str, Any]:
    """
    Return the first message of each topic that can be decoded.

    Parameters
    ----------
    source : Source
        The open recording.
    names : set of str
        Topics.

    Returns
    -------
    dict
        Messages by topic; a topic is left out of which none of the first TRIED can be decoded.

    """
    found: dict[str, Any] = {}
    for name in sorted(names):      # one search each: it ends where the topic begins
        for _, kind, _, data in islice(source.messages({name}), TRIED):
            try:
                found[name] = source.decode(data, kind)
            except BadMessage:
                continue
            break
    return found


def links(source: Source, names: set[str]) -> Iterator[tuple[str, str]]:
    """Yield (parent, child) of the transforms of some topics, as they are recorded."""
    for _, kind, _, data in source.messages(names):
        with suppress(BadMessage):
            for _, _, parent, child in pose_messages.transforms(source.decode(data, kind))[0]:
                yield parent, child
