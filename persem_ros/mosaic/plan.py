"""What a build is of: its recordings, looked at one after the other as a replay does."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.choices import chosen_legend
from persem_ros.core.memory.pools import SIDE
from persem_ros.errors import PersemError
from persem_ros.evaluate.work.manifest import source_hash
from persem_ros.inputs.recording.finding import split
from persem_ros.inputs.recording.recording import Recording
from persem_ros.outputs.results import timing
from persem_ros.preflight.files import as_one
from persem_ros.preflight.look import opened
from persem_ros.settings import config_file
from persem_ros.settings.config import Config
from persem_ros.settings.heights import hinted
from persem_ros.settings.legend import Legend

HIGHEST = 1 << 28           # farther than any block
NO_LEGEND = Legend()


@dataclass(frozen=True)
class Input:
    """
    One recording of a build: a session of its map.

    Attributes
    ----------
    number : int
        Its place, and the number of the session.
    path : str
        'A+B' is one input in two recordings.
    config : Config
        With what the look at it took over.
    names : Legend
        Of the recordings before, whose ids it goes on with; without classes: its own count.
    expected : int
        About how many frames it has.
    said : frozenset of str
        Notes that the user has read.

    """

    number: int
    path: str
    config: Config
    names: Legend
    expected: int
    said: frozenset[str]

    @property
    def name(self) -> str:
        """Return a short name for people."""
        return '+'.join(Path(part).name for part in split(self.path))


@dataclass(frozen=True)
class Plan:
    """
    All that decides on the map.

    Attributes
    ----------
    inputs : tuple of Input
    config : Config
        Of the map.
    legend : Legend
    side : int
        Blocks along a tile's edge.

    """

    inputs: tuple[Input, ...]
    config: Config
    legend: Legend
    side: int

    def identity(self) -> dict[str, Any]:
        """Return the same as JSON: two builds of one identity are one."""
        return {'recordings': [[item.path, *_files(item.path)] for item in self.inputs],
                'settings': config_file.to_yaml(self.config).splitlines(),
                'readings': [config_file.to_yaml(item.config).splitlines()
                             for item in self.inputs],
                'legend': self.legend.to_yaml(), 'tile, blocks': self.side,
                'source': source_hash(), 'versions': {
                    name: version for name, version in timing.versions().items()
                    if name not in ('commit', 'persem_ros')}}


@dataclass(frozen=True, order=True)
class Tile:
    """
    The columns of blocks (x, y, any z) with side * i <= x < side * (i + 1), and so for j and y.

    Columns, because what decides on a label may lie anywhere above and below it.

    """

    i: int
    j: int
    side: int

    @property
    def name(self) -> str:
        """Return a name for files and people."""
        return f'tile {self.i} {self.j}'

    @property
    def low(self) -> tuple[int, int, int]:
        """Return the lowest block index."""
        return self.i * self.side, self.j * self.side, -HIGHEST

    @property
    def high(self) -> tuple[int, int, int]:
        """Return the highest block index."""
        return (self.i + 1) * self.side - 1, (self.j + 1) * self.side - 1, HIGHEST

    def around(self) -> list[Tile]:
        """Return the eight tiles that touch this one."""
        return [Tile(self.i + di, self.j + dj, self.side)
                for di in (-1, 0, 1) for dj in (-1, 0, 1) if di or dj]

    def holds(self, index: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Return which blocks of the given indices (n, 3) lie in it."""
        inside: NDArray[np.bool_] = (index[:, :2] // self.side == (self.i, self.j)).all(axis=1)
        return inside


def tiles_of(index: NDArray[np.int32], side: int) -> list[tuple[int, int]]:
    """Return the places (i, j) of the tiles that hold blocks of the given indices (n, 3)."""
    return [(int(i), int(j)) for i, j in np.unique(index[:, :2] // side, axis=0)]


def planned(paths: Sequence[str | Path], config: Config, tile: float) -> Plan:
    """
    Look at recordings and return the Plan of their map.

    Raises
    ------
    PersemError
        For a recording that a replay would refuse, and for settings that no build can follow.

    """
    side = _side(tile, config)
    _check(config)
    inputs: list[Input] = []
    legend, names = Legend(), NO_LEGEND
    for number, recording in enumerate(_looked_at(paths, config)):
        config = recording.config       # what is decided for one holds for the next
        if names.classes and not config.labels.legend:
            recording.go_on(names)
        else:
            names = NO_LEGEND
        inputs.append(Input(number, '+'.join(str(part.resolve()) for part in split(paths[number])),
                            config, names, recording.expected, frozenset(recording.said)))
        names, legend = recording.legend, chosen_legend(config, recording)
    return Plan(tuple(inputs), hinted(config, legend), legend, side)


def _looked_at(paths: Sequence[str | Path], config: Config) -> Iterator[Recording]:
    """Yield each recording, open, by what was decided for those before (as opened_all does)."""
    for path in paths:
        try:
            recording = opened(path, config)
        except PersemError as error:
            sentence = as_one(paths, config) if len(paths) > 1 else ''
            raise PersemError(f'{error}; {sentence}' if sentence else str(error)) from None
        with recording:
            yield recording
            config = recording.config


def _side(tile: float, config: Config) -> int:
    """Return how many blocks make a tile's edge; refuse what is no size."""
    if not 0 < tile < math.inf:
        raise PersemError(f'--tile {tile:g}: expected metres above 0, such as --tile 64')
    block = SIDE * config.memory.voxel_size
    # Rounded up, unless it is a whole number of blocks but for the rounding of a float.
    side = max(1, math.ceil(tile / block - 1e-6))
    if side > HIGHEST:
        raise PersemError(f'--tile {tile:g}: more than {HIGHEST} blocks of {block:g} m; expected '
                          'metres, such as --tile 64')
    return side


def _check(config: Config) -> None:
    """Refuse settings whose map is not made of tiles, or not begun here."""
    if config.map.path:
        raise PersemError('map.path: a build begins with an empty map; leave it out, and join '
                          'maps with persem map merge')
    if config.memory.clear_after:
        raise PersemError('memory.clear_after needs the frames one after the other; build with '
                          '--set memory.clear_after=0, or use persem replay')


def _files(path: str) -> list[Any]:
    """Return what tells a recording from what lay there before: names, sizes, dates of files."""
    found = []
    for part in map(Path, split(path)):
        for file in sorted(part.rglob('*')) if part.is_dir() else [part]:
            if file.is_file():
                stat = file.stat()
                found.append([str(file.name), stat.st_size, stat.st_mtime_ns])
    return found
