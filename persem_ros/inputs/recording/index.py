"""Where the messages of an input are and what their stamps say: the order in which it is read."""

from array import array
from collections.abc import Collection, Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray
from persem_ros.inputs.recording.source import Source
from persem_ros.inputs.recording.stamps import stamp_of


class Index:
    """
    All messages of some topics, unread: 21 bytes each.

    Messages are sorted by their header stamps, whatever their log times and wherever they lie
    in the files: labels computed a day later and recorded then come beside their depth. A message
    whose type has no header keeps its place before the next one of *followed*, or else before the
    next one with a header, in its file.

    Parameters
    ----------
    source : Source
        The open input.
    names : collection of str
        Topics.
    followed : collection of str
        Topics to which what has no stamp belongs: a legend to the labels that come after it.

    Attributes
    ----------
    topics : list of (str, str)
        Names and types, by the numbers in *topic*.
    stamp : ndarray, shape (N,), int64
        Nanoseconds.
    topic : ndarray, shape (N,), uint16
        Number of the topic.

    """

    def __init__(self, source: Source, names: Collection[str],
                 followed: Collection[str] = ()) -> None:
        self._source = source
        numbers: dict[tuple[str, str], int] = {}
        stamps, topics, files, places = array('q'), array('H'), array('H'), array('q')
        fresh: list[int] = []       # without a stamp so far
        waiting: list[int] = []     # with that of a topic that is not followed
        file = -1
        for head in source.heads(names):
            if head.file != file:
                fresh, waiting, file = [], [], head.file
            stamp = stamp_of(head.msgtype, head.start)
            if stamp is None:
                fresh.append(len(stamps))
                stamp = head.time
            elif fresh or waiting:
                follows = head.topic in followed
                for i in fresh + waiting if follows else fresh:
                    stamps[i] = stamp
                fresh, waiting = [], [] if follows else waiting + fresh
            stamps.append(stamp)
            topics.append(numbers.setdefault((head.topic, head.msgtype), len(numbers)))
            files.append(head.file)
            places.append(head.place)
        self.topics = list(numbers)
        self.stamp: NDArray[np.int64] = np.frombuffer(stamps, np.int64)
        self.topic: NDArray[np.uint16] = np.frombuffer(topics, np.uint16)
        self._file: NDArray[np.uint16] = np.frombuffer(files, np.uint16)
        self._place: NDArray[np.int64] = np.frombuffer(places, np.int64)

    def counts(self) -> dict[str, int]:
        """Return the number of messages by topic."""
        found: dict[str, int] = {}
        for (name, _), n in zip(self.topics, np.bincount(self.topic, minlength=len(self.topics))):
            found[name] = found.get(name, 0) + int(n)
        return found

    def between(self, names: Collection[str], first: int | None, last: int | None) -> int:
        """Return the number of messages of topics with stamps from *first* to *last*, ns."""
        stamps = self._stamps(names)
        if first is not None:
            stamps = stamps[stamps >= first]
        return int(np.count_nonzero(stamps <= last) if last is not None else len(stamps))

    def span(self, names: Collection[str]) -> tuple[int, int]:
        """Return the smallest and largest stamp of topics, ns; (0, 0) without any."""
        stamps = self._stamps(names)
        return (int(stamps.min()), int(stamps.max())) if len(stamps) else (0, 0)

    def _stamps(self, names: Collection[str]) -> NDArray[np.int64]:
        numbers = [n for n, (name, _) in enumerate(self.topics) if name in names]
        return self.stamp[np.isin(self.topic, numbers)]

    def ordered(self, shifts: Mapping[str, int], ranks: Mapping[str, int],
                first: int | None = None, last: int | None = None,
                bounded: Iterable[str] = ()) -> Iterator[tuple[str, str, int, bytes]]:
        """
        Read messages in the order of their stamps.

        Parameters
        ----------
        shifts : mapping of str to int
            Topics to be read, and by how much each is shifted: what is added to its stamps, ns.
        ranks : mapping of str to int
            Which topic comes first at one stamp, the smallest.
        first, last : int, optional
            Bounds of the shifted stamps of *bounded* topics; of all others only *last* holds.
        bounded : iterable of str
            Topics.

        Yields
        ------
        topic, type : str
        key : int
            The shifted stamp: never smaller than the one before.
        data : bytes
            The serialized message, b'' where it cannot be read.

        """
        unknown = np.iinfo(np.int64).min
        shift = np.array([shifts.get(name, unknown) for name, _ in self.topics], np.int64)
        rank = np.array([ranks.get(name, 0) for name, _ in self.topics], np.int64)
        inside = set(bounded)
        cut = np.array([name in inside for name, _ in self.topics], bool)
        if not len(self.stamp):
            return
        chosen = np.flatnonzero(shift[self.topic] != unknown)
        key = self.stamp[chosen] + shift[self.topic[chosen]]
        keep = np.ones(len(chosen), bool)
        if first is not None:
            keep &= (key >= first) | ~cut[self.topic[chosen]]
        if last is not None:
            keep &= key <= last
        chosen, key = chosen[keep], key[keep]
        order = np.lexsort((rank[self.topic[chosen]], key))
        for at, i in zip(key[order].tolist(), chosen[order].tolist()):
            name, kind = self.topics[self.topic[i]]
            yield name, kind, at, self._source.read(int(self._file[i]), int(self._place[i]))
