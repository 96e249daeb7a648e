"""The map: for every world voxel the history of what was seen there (spec section 2)."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel, split
from persem_ros.core.memory.append import add_observations
from persem_ros.core.memory.blocks import find_voxels, list_voxels, new_table
from persem_ros.core.memory.evidence import read_evidence
from persem_ros.core.memory.frame_table import FrameTable
from persem_ros.core.memory.growth import Growth
from persem_ros.core.memory.pools import (
    BLOCKS, CENTRE, CHUNK, CLOCK, FREE_BLOCKS, FREE_VOXELS, OBSERVATIONS, Store, STORED, VOXELS)
from persem_ros.core.memory.records import release_links
from persem_ros.core.memory.session import Session, Stamps, uuid_of
from persem_ros.core.memory.voxel_table import copy_columns, ordered
from persem_ros.errors import PersemError

if TYPE_CHECKING:
    from persem_ros.core.frame.observe import Observations
    from persem_ros.core.memory.capture import Capture
    from persem_ros.core.memory.changes import Changes
    from persem_ros.core.memory.paging import Pager
    from persem_ros.core.memory.pools import Pools

LAST_T = 2 ** 31 - 1        # histories keep t as int32


class VoxelMemory:
    """
    Voxels in blocks of 8 x 8 x 8, each with its observation history and class evidence.

    One thread adds, reads and begins refinements; a refinement computes beside it on the
    snapshot that it was handed (core.refine.snapshot).

    Parameters
    ----------
    voxel_size : float
        Metres.
    origin : sequence of 3 floats
        Point of the map frame, metres, from which voxels are counted.
    max_history : int
        Newest observations kept for the replay of spec section 3; 0: all. Evidence, observation
        counts and volatility always cover everything.

    """

    def __init__(self, voxel_size: float, origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
                 max_history: int = 0) -> None:
        self.voxel_size = float(voxel_size)
        x, y, z = map(float, origin)
        self.origin = x, y, z
        self.max_history = int(max_history)
        self.keeps_all = False      # max_history bounds only what a refinement reads
        self.session = 0
        self.frames = FrameTable()
        self.seen_ids = np.zeros(65536, np.uint8)   # ids of all counted pixels (section 4)
        # Class volatility of the last full refinement.
        self.rho: NDArray[np.float64] | None = None
        self.refined_with = None    # settings of the last refinement; None: visit all next time
        self.refinements = 0        # under way
        self.captures: set[Capture] = set()     # under way
        self.viewers: set[Changes] = set()      # who wants to know which blocks left
        self.growth: Growth | None = None       # the next hash table, under way
        self.pager: Pager | None = None         # where a store holds the rest of the map
        self.settled = 0            # tick up to which refinements were handed all changes
        self.sweep = None           # core.refine.sweep.Sweep: which blocks saw the present rho
        self.since_rho = 0          # refinements begun since rho was taken
        self.rho_of = -1            # number of observations of which rho was taken
        self.store = Store()
        self.table = new_table(512)
        self.geometry = None        # parameters of the method geometry (core.geometry)
        self.relief: Any = None     # core.geometry.relief.Relief, kept between refinements
        self.survey: Any = None     # core.refine.survey.Survey under way
        self.n_gone = 0             # voxels that moved away so far; 0: no record says gone
        self.some_passed = False    # whether any record of store.passed is in use
        self.voted_ids = np.zeros(65536, np.uint8)      # ids of observations
        # The same as arrays, as a file had them, until needed.
        self.habits: dict[str, NDArray[Any]] = {}
        # refine.up and values of refine.geometry it was fitted with.
        self.fitted_by: tuple[Any, ...] | None = None
        self.tally = None           # core.geometry.kept.Tally of the sweep under way
        self.known_ids = np.zeros(65536, np.uint8)      # those that self.geometry was fitted to
        self.voted_by = -1          # directions that store.voted counts by
        self._stamps = Stamps(self.frames)
        self._next_t = 0

    @property
    def m(self) -> Pools:
        """Return the pools' arrays, for kernels."""
        return self.store.arrays

    @property
    def read_beside(self) -> bool:
        """Return whether other threads may read: no block may leave, no link be used again."""
        return self.refinements > 0 or len(self.captures) > 0

    @property
    def kept_history(self) -> int:
        """Return how many observations of a voxel are kept; 0: all."""
        return 0 if self.keeps_all else self.max_history

    @property
    def n_voxels(self) -> int:
        """Return number of observed voxels."""
        return int(self.m.used[VOXELS] - self.m.used[FREE_VOXELS])

    @property
    def n_numbers(self) -> int:
        """All voxel numbers are below this; equal to n_voxels where nothing was dropped."""
        return int(self.m.used[VOXELS])

    @property
    def n_blocks(self) -> int:
        """All block numbers are below this."""
        return int(self.m.used[BLOCKS])

    @property
    def n_observations(self) -> int:
        """Return number of observations ever added."""
        return int(self.m.used[OBSERVATIONS])

    def add(self, observations: Observations) -> NDArray[np.int64]:
        """
        Append a frame's observations (core.frame.observe.Observations), one of a voxel each.

        Returns
        -------
        ndarray, shape (n,), int64
            The voxel number of each row of observations.voxels, -1 where nothing was observed.
            Numbers are places in memory: they hold until a block leaves it.

        """
        n = len(observations.labels)
        self.make_room(n, n)
        if not self.read_beside:
            release_links(self.m.free, self.m.retired, self.m.used)
        offsets = observations.offsets
        if offsets is None:
            offsets = np.full((n, 3), CENTRE, np.uint8)
        f = self._enter(observations)
        free = self.m.used[FREE_BLOCKS]
        rows = add_observations(self.m, self.table, observations.voxels, observations.labels,
                                observations.confidences, offsets, f, self.kept_history,
                                self.voted_ids)
        if self.m.used[FREE_BLOCKS] != free:
            self.growth = None
        self.seen_ids[observations.ids] = 1
        return rows

    @property
    def clock(self) -> Any:
        """Return the tick of the last change; what changes later bears a larger one."""
        return int(self.m.used[CLOCK])

    def changed_blocks(self) -> Any:
        """Return the numbers of the blocks with changes that no refinement was handed yet."""
        return np.flatnonzero(self.m.stamps['evidence'][:self.n_blocks] > self.settled)

    def find(self, voxels: NDArray[np.int32]) -> NDArray[np.int64]:
        """Return the voxel numbers (n,) int64 of voxel indices (n, 3); -1 for unknown ones."""
        voxels = np.require(voxels, np.int32, 'C').reshape(-1, 3)
        out = np.empty(len(voxels), np.int64)
        split(find_voxels, len(voxels), self.m.blocks, self.table, voxels, out, grain=16384)
        return out

    def new_session(self) -> None:
        """Begin a session: its stamps are new even where they repeat earlier ones."""
        self.session += 1
        self._stamps = Stamps(self.frames, self.session)

    def resume(self, frames: FrameTable, session: int) -> None:
        """Take over the frame table of a saved map; it goes on in the same session."""
        self.frames, self.session = frames.copy(), int(session)
        self._stamps = Stamps(self.frames, self.session)
        self._next_t = int(frames.t.max(initial=-1)) + 1

    def volatility(self) -> NDArray[np.float64]:
        """
        Return rho, shape (65536,), float64: P(the next label differs | this one's is c).

        From two counters per class over all consecutive pairs of all histories; 0 where c
        starts no pair.

        """
        starts = self.m.starts
        return np.divide(self.m.changes, starts, out=np.zeros(65536), where=starts > 0)

    def listing(
            self, blocks: Any = None, present: bool = False
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """
        Return (block, cell, voxel number), each (n,) int64, of voxels, block by block.

        blocks (b,) int64 are the numbers of the blocks, None: all. Where only what is *present*
        is wanted, voxels whose content moved away are left out.

        """
        if blocks is None:
            blocks, size = np.arange(self.n_blocks), self.n_voxels
        else:       # of those that were let go, 'count' has another meaning
            live = self.m.blocks['near'][blocks, 13] > 0
            size = int(self.m.blocks['count'][blocks][live].sum(dtype=np.int64))
        block, cell, number = (np.empty(size, np.int64) for _ in range(3))
        list_voxels(self.m.blocks, blocks, block, cell, number)
        if present and self.n_gone:
            here = self.m.voxels['gone'][number] == 0
            return block[here], cell[here], number[here]
        return block, cell, number

    def voxels(self) -> dict[str, Any]:
        """
        Return the map as columns, sorted by voxel index; without what moved away.

        Returns
        -------
        dict
            voxel (n, 3) int32, label, majority (n,) uint16, confidence (n,) float32 (p_v of the
            label, or its posterior where geometry gave it), observations (n,) uint32, switches
            (n,) uint32, source (n,) uint8, number (n,) int64.

        """
        return ordered(self.columns())

    def columns(self, blocks: Any = None) -> dict[str, Any]:
        """
        Return what voxels() does, unsorted: the part that only the mapping thread may do.

        blocks as in listing().

        One pass over the records, a tenth of what sorting and gathering by column costs.

        """
        return self.columns_of(*self.listing(blocks, present=True))

    def columns_of(self, block: NDArray[np.int64], cell: NDArray[np.int64],
                   number: NDArray[np.int64]) -> dict[str, Any]:
        """Return what columns() does of the voxels of a listing()."""
        n = len(number)
        columns = {'voxel': np.empty((n, 3), np.int32), 'label': np.empty(n, np.uint16),
                   'majority': np.empty(n, np.uint16), 'confidence': np.empty(n, np.float32),
                   'observations': np.empty(n, np.uint32), 'switches': np.empty(n, np.uint32),
                   'source': np.empty(n, np.uint8)}
        split(copy_columns, n, self.m.blocks, self.m.voxels, self.m.spills, self.store.beliefs,
              block, cell, number, *columns.values())
        return {**columns, 'number': number}

    def number(self, voxel: NDArray[np.int32]) -> int:
        """Return the number of one voxel index (i, j, k); refuse one that was never seen."""
        number = int(self.find(np.array([voxel], np.int32))[0])
        if number < 0:
            raise PersemError(f'voxel {tuple(int(i) for i in voxel)} was never observed')
        return number

    def history(
            self, voxel: NDArray[np.int32] | tuple[int, int, int]
    ) -> tuple[NDArray[np.uint16], NDArray[np.float32], NDArray[np.int32]]:
        """Return the stored observations of a voxel: labels uint16, confidences f4, t int32."""
        labels, confidences, f, _ = self.sightings(voxel)
        return labels, confidences, self.frames.here('t')[f]

    def sightings(self, voxel: Any) -> Any:
        """
        Return the stored observations of a voxel, oldest first.

        Returns
        -------
        labels : ndarray, shape (k,), uint16
        confidences : ndarray, shape (k,), float32
        f : ndarray, shape (k,), int32
            Rows of the frame table.
        offsets : ndarray, shape (k, 3), uint8
            Where the points lay in the voxel, 256ths of its edge (Observations.offsets).

        """
        record, links = self.m.voxels[self.number(voxel)], self.m.links
        n, first, link = int(record['n']), int(record['first']), int(record['head'])
        chain = []
        while link:
            chain.append(link - 1)
            link = int(links[link - 1]['next'])
        oldest = max(first, n - self.kept_history) if self.kept_history else first
        skipped = first // CHUNK * CHUNK        # number of the chain's first place
        kept = slice(oldest - skipped, n - skipped)
        return (*(links[name][chain].reshape(-1)[kept] for name in 'csf'),
                self.m.offsets['xyz'][chain].reshape(-1, 3)[kept])

    def changed(self, voxel: NDArray[np.int32]) -> bool:
        """Return whether a voxel's evidence changed since a refinement began."""
        self.number(voxel)
        blocks = self.m.blocks[:self.n_blocks]
        x, y, z = (int(i) for i in voxel)
        here = np.flatnonzero((blocks['index'] == (x >> 3, y >> 3, z >> 3)).all(axis=1))[0]
        return bool(blocks['changed'][here, (x & 7) * 8 + (y & 7)] >> (z & 7) & 1)

    def evidence(self, voxel: NDArray[np.int32]) -> dict[int, float]:
        """Return {class: h_v(class)} of a voxel."""
        v = self.number(voxel)
        classes, sums = np.empty(65536, np.uint16), np.empty(65536)
        n = evidence_of(self.m.voxels, self.m.spills, v, classes, sums)
        return dict(zip(classes[:n].tolist(), sums[:n].tolist()))

    def nbytes(self) -> dict[str, int]:
        """Return {what: bytes in use}, everything included."""
        sizes = self.store.nbytes()
        sizes['frames'] = self.frames.nbytes()
        if self.relief is not None:
            sizes['geometry'] = self.relief.nbytes(self.n_blocks) + self.n_voxels * (
                self.store.voted.itemsize + self.store.beliefs.itemsize)
        sizes['hash table'] = self.table.nbytes
        sizes['classes'] = self.m.starts.nbytes + self.m.changes.nbytes + self.seen_ids.nbytes
        return sizes

    def make_room(self, blocks: int, records: int) -> None:
        """Have the hash table hold *blocks* more, at most half full; refuse too many *records*."""
        self.store.check_room(records)
        needed = self.n_blocks - int(self.m.used[FREE_BLOCKS]) + blocks
        if 3 * needed <= len(self.table):
            return
        full = 2 * needed > len(self.table)
        if self.growth is None or full and 2 * needed > len(self.growth.table):
            self.growth = Growth(2 * needed)
        if self.growth.step(self.m, *([self.n_blocks] if full else [])):
            self.table, self.growth = self.growth.table, None

    def _enter(self, seen: Any) -> Any:
        """Enter the frame of some Observations into the table; return its row f."""
        t = self._stamps.find(seen.stamp)
        if t is None:               # spec section 1: t counts the distinct stamps
            if self._next_t > LAST_T:
                raise PersemError(f'the map has seen as many frames as it can number, {LAST_T + 1}'
                                  '; begin a new one (another map.path, or ~/reset)')
            t, self._next_t = self._next_t, self._next_t + 1
            self._stamps.add(seen.stamp, t)
        sessions = self.frames.sessions
        if self.session not in sessions:
            sessions[self.session] = Session(uuid_of(seen, self.origin, self.voxel_size))
        mounts = sessions[self.session].mounts
        if seen.sensor not in mounts:
            mounts[seen.sensor] = np.eye(4) if seen.T_body_sensor is None else \
                np.array(seen.T_body_sensor, np.float64)
        return self.frames.append(t, self.session, seen.sensor, seen.stamp, seen.T_map_sensor)


@kernel
def evidence_of(voxels, spills, v, classes, sums):
    """Write one voxel's evidence to the front of two arrays; return how much."""
    return read_evidence(voxels[v], spills, classes, sums, 0)


def stored_observations(memory: Any) -> Any:
    """Return the number of observations that the histories hold (all, without a bound)."""
    return int(memory.m.used[STORED])
