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
    memory.geometry, memory.tally, memory.habits, memory.survey = None, None, {}, None


def due(memory: Any, settings: Any) -> Any:
    """Return whether the volatility has been used for long enough, and by all voxels."""
    return memory.since_rho >= settings.volatility_every and (
        memory.sweep is None or memory.sweep.ended)


def news(memory: Any, settings: Any) -> bool:
    """Return whether parameters have to be fitted anew: there are none, or a class is new."""
    if memory.geometry is None and memory.habits:
        memory.geometry = from_arrays(memory.habits)
    memory.habits = {}
    return memory.geometry is None or memory.fitted_by != fitted_by(settings) or \
        bool((memory.voted_ids & ~memory.known_ids).any())


def fit_anew(memory: Any, settings: Any) -> None:
    """Have the next refinement fit parameters to the classes of today."""
    memory.geometry, memory.known_ids = None, memory.voted_ids.copy()
    memory.fitted_by = fitted_by(settings)


def swept(memory: Any, settings: Any) -> Any:
    """Return whether every voxel has seen the present volatility and settings."""
    return memory.rho is not None and memory.survey is None and \
        memory.refined_with == rules_of(memory, settings) and \
        (memory.sweep is None or memory.sweep.ended)


def pressing(memory: Any) -> bool:
    """Return whether the next refinement is due at once: a survey or its sweep is under way."""
    return memory.survey is not None or memory.sweep is not None and \
        memory.sweep.pressing and not memory.sweep.ended


def at_rest(memory: Any, settings: Any) -> Any:
    """Return whether nothing is left to refine until something is observed or let go."""
    return swept(memory, settings) and memory.rho_of == memory.n_observations and \
        not len(memory.changed_blocks())
