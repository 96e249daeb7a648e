"""What labels go by everywhere: settings, class volatility, parameters; and when these are new."""

from __future__ import annotations

from typing import Any

from persem_ros.core.geometry.kept import fitted_by, from_arrays
from persem_ros.core.refine.labelled import number_of_ids


def rules_of(memory: Any, settings: Any) -> Any:
    """Return what labels everywhere depend on: settings, and for one method the number of ids."""
    return settings, number_of_ids(memory) if settings.method == 'probabilistic' else 0


def take_rho(memory: Any) -> None:
    """Take the class volatility anew; every voxel has to see it."""
    memory.rho, memory.rho_of = memory.volatility(), memory.n_observations
    memory.refined_with, memory.since_rho = None, 0
    memory.geometry, memory.tally, memory.habits = None, None, {}


def due(memory: Any, settings: Any) -> Any:
    """Return whether the volatility has been used for long enough, and by all voxels."""
    return memory.since_rho >= settings.volatility_every and (
        memory.sweep is None or memory.sweep.ended)


def news(memory: Any, settings: Any) -> bool:
    """Return whether parameters have to be fitted anew: there are none, or a class is new."""
    by = fitted_by(settings)
    if memory.geometry is None and memory.habits:
        memory.geometry = from_arrays(memory.habits)
    memory.habits = {}
    if memory.geometry is not None and memory.fitted_by == by and \
            not (memory.voted_ids & ~memory.known_ids).any():
        return False
    memory.geometry, memory.fitted_by, memory.known_ids = None, by, memory.voted_ids.copy()
    return True


def swept(memory: Any, settings: Any) -> Any:
    """Return whether every voxel has seen the present volatility and settings."""
    return memory.rho is not None and memory.refined_with == rules_of(memory, settings) and \
        (memory.sweep is None or memory.sweep.ended)


def at_rest(memory: Any, settings: Any) -> Any:
    """Return whether nothing is left to refine until something is observed or let go."""
    return swept(memory, settings) and memory.rho_of == memory.n_observations and \
        not len(memory.changed_blocks())
