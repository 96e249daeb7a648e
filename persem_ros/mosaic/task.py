"""What all work on one tile has in common: kernels at hand, its time, a tick at its end."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
import time
from typing import Any

from persem_ros.core.warmup import warm_up

Work = Callable[[Any], dict[str, Any]]


def timed(work: Work) -> Callable[..., dict[str, Any]]:
    """Return work(task) as Crew.results wants it; its result tells the seconds, too."""
    @wraps(work)
    def done(task: Any, tick: Callable[..., Any] | None = None) -> dict[str, Any]:
        warm_up(False)
        began = time.perf_counter()
        result = work(task)
        if tick is not None:
            tick()
        return {**result, 'seconds': round(time.perf_counter() - began, 3)}
    return done
