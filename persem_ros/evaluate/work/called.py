"""A recording's ids under the names of a taxonomy: as in a replay under labels.legend."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, TYPE_CHECKING

from numpy.typing import NDArray
from persem_ros.inputs.decode.legends import Table
from persem_ros.inputs.names import filled
from persem_ros.settings.legend import Legend
from persem_ros.settings.legend_files import load_legend

if TYPE_CHECKING:
    import numpy as np
    from persem_ros.inputs.recording.recording import Recording


class Called(NamedTuple):
    """
    What a recording's ids are for an evaluation.

    Attributes
    ----------
    legend : Legend
        What the recording calls its classes, under the ids that the evaluation counts.
    new : ndarray, shape (65536,), int32, or None
        The id that counts for each of the recording's, -1 for none; None: they stay.
    said : str
        How the names of the taxonomy and of the recording differ, '' where they do not.

    """

    legend: Legend
    new: NDArray[np.int32] | None = None
    said: str = ''

    def beside(self, legend: Legend) -> Legend:
        """Return a legend with the recording's names of ids that it does not have."""
        more = [item for item in self.legend.classes if item.id not in legend.ids]
        return Legend(legend.title, (*legend.classes, *more))


def called(recording: Recording, labels: str) -> Called:
    """
    Return what becomes of a recording's ids where *labels* names the classes.

    Parameters
    ----------
    recording : Recording
        Open.
    labels : str
        Taxonomy: a shipped legend or a file; '': none.

    Raises
    ------
    PersemError
        For a legend that does not exist or cannot be read.

    """
    theirs = recording.legend
    given = load_legend(labels) if labels else Legend()
    same = {(item.id, item.name) for item in given.classes}
    if not given.classes or all((item.id, item.name) in same for item in theirs.classes):
        return Called(theirs)
    names = filled(recording.config, given, [Table(theirs, None)], whose='--labels')
    new = names.at(0, 1)[1]
    if new is not None:
        theirs = Legend(theirs.title, tuple(replace(item, id=int(new[item.id]))
                                            for item in theirs.classes if new[item.id] >= 0))
    return Called(theirs, new, names.difference())
