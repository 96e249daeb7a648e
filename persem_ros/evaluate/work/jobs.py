"""The tasks of an evaluation side by side; results as they are ready."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TYPE_CHECKING

from persem_ros import workers as side_by_side
from persem_ros.evaluate.work import sequence

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from persem_ros.evaluate.work.task import Task


def results(
        tasks: list[Task], workers: int = 0, scheduler: str = '', frames: list[int] | None = None
) -> Iterator[tuple[int, dict[str, Any], dict[str, NDArray[Any]]]]:
    """
    Yield (place in *tasks*, summary, arrays) as tasks are finished.

    Parameters
    ----------
    tasks : sequence of task.Task
        The work.
    workers, scheduler
        As of persem_ros.workers.Crew, whose refusals pass.
    frames : sequence of int, optional
        Frames to be read by each task, for the progress bar.

    """
    for place, result in side_by_side.results(sequence.evaluate_sequence, tasks, workers,
                                              scheduler, frames, 'evaluating'):
        yield place, *result
