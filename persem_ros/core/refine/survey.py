"""The parameters of a large map in memory, fitted beside the mapping (spec section 9, *Flat*)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from persem_ros.core.geometry.kept import fitted_by, Tally
from persem_ros.core.geometry.looks import look, Looks
from persem_ros.core.geometry.relief import Relief
from persem_ros.core.geometry.upright import up_of
from persem_ros.core.memory.pools import CLOCK
from persem_ros.core.refine.gathered import beside_wanted, Gathered
from persem_ros.core.refine.reach import has_relief, surrounded
from persem_ros.core.refine.sweep import next_blocks, Sweep


class Survey:
    """
    A fit of the schedule of section 12.5 to a whole map, in steps that a frame can wait for.

    The first step makes the relief where there is none; the next ones look at refine.sweep voxels
    each, as they are between two frames; the last runs the schedule over what was gathered, beside
    the mapping. A sweep by its parameters follows, to which all that changed until the last step
    is left: so when no frame comes any more, all is as if the map had been refined at once.

    Parameters
    ----------
    memory : core.memory.voxel_memory.VoxelMemory
        It has no pager. Its class volatility is taken anew, its parameters stay until the end.
    settings : persem_ros.settings.config.Refine
        up, geometry and sweep.
    rules : tuple
        core.refine.rules.rules_of() of these.

    Attributes
    ----------
    fitted : bool
        Whether the parameters are there: then comes end().

    """

    def __init__(self, memory: Any, settings: Any, rules: Any) -> None:
        self._memory, self._settings, self._rules = memory, settings, rules
        self._ids, self._observations = memory.voted_ids.copy(), memory.n_observations
        self._order = Sweep(memory.m.blocks, memory.n_blocks)
        self._sweep = self._order       # in the end one of its own
        self._beside = beside_wanted(memory)
        self._gathered = Gathered(settings.geometry)
        self._looks: list[Any] = []     # of each part, later its model
        self._parameters: Any = None
        self.fitted = False
        memory.rho = memory.volatility()
        if not has_relief(memory, settings):
            memory.relief = Relief(memory, up_of(settings.up), settings.geometry.window)

    def outdated(self, rules: Any) -> bool:
        """Return whether it would come to what nobody goes by: settings or classes are others."""
        return bool(rules != self._rules or (self._memory.voted_ids & ~self._ids).any())

    def step(self) -> Callable[[], Any]:
        """Begin the next step, between two frames; return what any thread may do of it."""
        memory = self._memory
        if memory.relief.empty or self._order.order is None:
            return self._prepare
        numbers = next_blocks(self._order, memory.m.blocks, memory.table, self._settings.sweep)
        if len(numbers):
            return partial(self._look, surrounded(memory, self._settings, numbers,
                                                  int(self._beside)))
        self._sweep = Sweep(memory.m.blocks, memory.n_blocks, pressing=True)
        memory.settled = memory.clock
        memory.m.used[CLOCK] += 1
        return self._fit

    def end(self) -> None:
        """Have refinements go by the parameters from now on, and sweep the map by them."""
        memory = self._memory
        memory.geometry, memory.habits, memory.survey = self._parameters, {}, None
        memory.fitted_by, memory.known_ids = fitted_by(self._settings), self._ids
        memory.refined_with, memory.since_rho = self._rules, 0
        memory.rho_of = self._observations
        memory.sweep, memory.tally = self._sweep, Tally()

    def _prepare(self) -> Any:
        self._order.prepare()
        if self._memory.relief.empty:
            self._memory.relief.update(self._memory)
        return self._memory.geometry

    def _look(self, taken: Any) -> Any:
        if taken.refined:
            looks = look(self._memory, taken, self._settings, self._beside, keep=True)
            self._gathered.add(looks)
            self._looks.append(looks)
        return self._memory.geometry

    def _fit(self) -> Any:
        self._sweep.prepare()
        steps = self._gathered.fit(self._models)
        while not self.fitted:
            try:
                next(steps)
            except StopIteration as end:
                self._parameters, self.fitted = end.value, True
        return self._memory.geometry

    def _models(self) -> Any:
        """Yield the model of each part."""
        for k, one in enumerate(self._looks):
            if isinstance(one, Looks):
                one = self._looks[k] = self._gathered.model(one)
            yield one
