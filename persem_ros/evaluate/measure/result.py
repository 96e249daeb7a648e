"""The noun result: what is left of one sequence."""

from __future__ import annotations

from typing import Any, NamedTuple

from numpy.typing import NDArray


class Result(NamedTuple):
    """
    What is left of one sequence.

    Attributes
    ----------
    summary : dict
        JSON: what metrics.json has, with the stages' times and what was left out.
    arrays : dict
        Counts by block, flicker by frame, confusion matrices, pictures.

    """

    summary: dict[str, Any]
    arrays: dict[str, NDArray[Any]]
