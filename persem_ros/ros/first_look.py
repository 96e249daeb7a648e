"""The preflight of a node: the checks of a replay, over the first messages that arrive."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import partial
import logging
from typing import Any

import numpy as np

from persem_ros.inputs.assemble import Assembler
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.intake import INFO, POSE, Station
from persem_ros.inputs.sync.match import CONFIDENCE, DEPTH, DEPTH_CONFIDENCE, LABELS
from persem_ros.inputs.sync.poses import PoseBuffer
from persem_ros.preflight.depth_fit import measured
from persem_ros.preflight.findings import Finding, NOTE, REFUSE
from persem_ros.preflight.look import look
from persem_ros.preflight.sample import Sample, Shot, View
from persem_ros.ros.inbox import Item
from persem_ros.ros.priority import stand_back
from persem_ros.ros.topic import Input
from persem_ros.settings.config import Config
from persem_ros.settings.legend import Legend

log = logging.getLogger(__name__)
FIRSTS = 3          # messages of a role that are decoded to judge it
ENOUGH = 20         # label images whose stamps are compared
SHOTS = 24          # depth images that are compared with each other …
BYTES = 96 << 20    # … of each camera, in so many bytes
ROLES = (LABELS, DEPTH, CONFIDENCE, DEPTH_CONFIDENCE, INFO, POSE)


class FirstLook:
    """
    Looks once, when enough has come, and says what it finds.

    The worker collects and says; it looks on a thread, since comparing depth with depth takes as
    long as mapping five to ten frames.

    Parameters
    ----------
    stations : dict of str to Station
        The cameras, by name.
    decode : callable
        decode(data, typename) gives a message; called on the thread.
    legend : callable
        legend() gives the Legend in force.

    Attributes
    ----------
    findings : list of Finding
        What was found.
    done : bool
        Whether it has looked.

    """

    def __init__(self, stations: dict[str, Station], decode: Callable[[bytes, str], Any],
                 legend: Callable[[], Legend]) -> None:
        """Begin to collect."""
        self._stations, self._decode, self._legend = stations, decode, legend
        self._seen: dict[Input, list[Item]] = {}
        self._thread = ThreadPoolExecutor(1, 'first look', stand_back)
        self._result: Future[list[Finding]] | None = None
        self.findings: list[Finding] = []
        self.done = False

    def take(self, item: Item) -> None:
        """Keep what a message tells, as long as it is one of the first."""
        if self._result is not None or self.done or item.input.role not in ROLES:
            return
        kept = self._seen.setdefault(item.input, [])
        shots = item.input.role == DEPTH and len(kept) < SHOTS and \
            (len(kept) + 1) * len(item.data) <= BYTES
        if len(kept) < FIRSTS or shots:
            kept.append(item)
        elif len(kept) < 50 * ENOUGH:       # stamps are enough of the others
            kept.append(item._replace(data=item.data[:512]))

    def step(self, config: Config, inputs: list[Input]) -> None:
        """Begin to look where enough has come, say what a look has found."""
        if self.done:
            return
        if self._result is None:
            if all(self._enough(one) for one in inputs if one.role in ROLES):
                poses = {name: station.poses.copy() for name, station in self._stations.items()}
                self._result = self._thread.submit(self._look, config, inputs, poses,
                                                   self._legend())
        elif self._result.done():
            self.done, self._seen = True, {}
            self.close()
            self.findings = self._result.result()
            self._say()

    def close(self) -> None:
        """Begin no look; nobody waits for one that is under way."""
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _look(self, config: Config, inputs: list[Input], poses: dict[str, PoseBuffer],
              legend: Legend) -> list[Finding]:
        """Return what is found; on the thread, while nothing is collected any more."""
        views = [self._view(name, poses[name], inputs) for name in self._stations]
        return look(Sample(config, views, live=True, legend=legend))

    def _say(self) -> None:
        """Log the findings."""
        for finding in self.findings:
            quiet = finding.severity == NOTE and not finding.takes      # a node takes nothing
            say = log.error if finding.severity == REFUSE else log.info if quiet else log.warning
            say('%s', finding.text(live=True))

    def _enough(self, one: Input) -> bool:
        return len(self._seen.get(one, ())) >= (ENOUGH if one.role == LABELS else 1)

    def _view(self, name: str, poses: PoseBuffer, inputs: list[Input]) -> View:
        station, seen = self._stations[name], self._seen
        own = {one.role: one for one in inputs
               if one.role in ROLES and (station in one.takers or station.poses in one.takers)}
        items = {role: seen[own[role]] if role in own else [] for role in ROLES}
        stamps = {role: [(stamp, item.arrival) for item in found
                         if (stamp := item.input.stamp_of(item.data)) is not None]
                  for role, found in items.items()}
        return View(name, {role: one.listened for role, one in own.items()},
                    {role: self._decoded(found) for role, found in items.items()},
                    {role: np.array([s for s, _ in rows], np.int64)
                     for role, rows in stamps.items()},
                    {role: np.array([at for _, at in rows], np.int64)
                     for role, rows in stamps.items()}, poses,
                    partial(self._shots, items[DEPTH], items[INFO]))

    def _shots(self, depth: list[Item], infos: list[Item], wanted: Iterable[int],
               config: Config) -> dict[int, Shot]:
        """Return the depth images of some stamps, those that were kept and can be read."""
        found, stamps, assembler = {}, set(wanted), Assembler(config)
        for info in self._decoded(infos):
            with suppress(BadMessage):
                assembler.add_info(info)
        for item in depth[:SHOTS]:
            stamp = item.input.stamp_of(item.data)
            if stamp in stamps:
                with suppress(BadMessage):
                    image, camera = assembler.seen(self._decode(item.data, item.kind))
                    found[stamp] = Shot(measured(image), camera)
        return found

    def _decoded(self, items: list[Item]) -> list[Any]:
        found = []
        for item in items[:FIRSTS]:
            try:
                found.append(self._decode(item.data, item.kind))
            except BadMessage:
                continue
        return found
