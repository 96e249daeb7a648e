"""Images that wait for a label image that takes them, in the order of their stamps."""

from __future__ import annotations

from bisect import bisect_left, insort
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from persem_ros.inputs.sync.match import Raw


@dataclass(order=True)
class Waiting:
    """An image that no label image has taken yet."""

    stamp: int
    item: Raw = field(compare=False)
    size: int = field(compare=False)
    arrival: int = field(compare=False)


class WaitingImages:
    """
    Those of one kind.

    Attributes
    ----------
    latest : int or None
        Stamp of the image that arrived last, taken or not.

    """

    def __init__(self) -> None:
        """Start empty."""
        self.latest: int | None = None
        self._images: list[Waiting] = []

    @property
    def oldest(self) -> Waiting | None:
        """Return the image with the smallest stamp, None where none waits."""
        return self._images[0] if self._images else None

    def add(self, image: Waiting) -> bool:
        """Take an image in; return False for a stamp that waits already."""
        if self._at(image.stamp) is not None:
            return False
        insort(self._images, image)
        return True

    def take(self, stamp: int) -> Waiting | None:
        """Give away the image with this very stamp, None where there is none."""
        i = self._at(stamp)
        return None if i is None else self._images.pop(i)

    def take_nearest(self, stamp: int, tolerance: int) -> Waiting | None:
        """Give away the image nearest to a stamp within *tolerance* ns; the earlier of two."""
        images = self._images
        i = bisect_left(images, stamp, key=_stamp)
        near = [j for j in (i - 1, i) if 0 <= j < len(images)
                and abs(images[j].stamp - stamp) <= tolerance]
        best = min(near, key=lambda j: (abs(images[j].stamp - stamp), j), default=None)
        return None if best is None else images.pop(best)

    def drop_oldest(self) -> Waiting:
        """Give away the image with the smallest stamp."""
        return self._images.pop(0)

    def _at(self, stamp: int) -> int | None:
        i = bisect_left(self._images, stamp, key=_stamp)
        return i if i < len(self._images) and self._images[i].stamp == stamp else None


def _stamp(image: Waiting) -> int:
    return image.stamp
