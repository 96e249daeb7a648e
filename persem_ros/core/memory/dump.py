"""A whole memory as plain arrays: what a map file holds (spec section 8)."""

from __future__ import annotations

from dataclasses import dataclass, field as field_of
from typing import Any, Optional

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.frame_table import FrameTable
from persem_ros.core.memory.pools import SIDE


@dataclass(frozen=True, eq=False)
class Blocks:
    """
    Some blocks with their voxels.

    Blocks are sorted by index, voxels by cell within their block.

    Attributes
    ----------
    block_index : ndarray, shape (B, 3), int32
    block_start : ndarray, shape (B + 1,), int64
        Block b's voxels are rows block_start[b] : block_start[b + 1] of the columns below.
    cell : ndarray, shape (n,), uint16
    observations, switches : ndarray, shape (n,), uint32
    label, majority, last, first_label : ndarray, shape (n,), uint16
    source, dirty, gone : ndarray, shape (n,), uint8
    posterior : ndarray, shape (n,), float32
        Of the label, where the method geometry gave it; 0: none.
    passed : ndarray, shape (n,), uint32
        Looks through the voxel since its last observation (core.frame.clear).
    passed_at : ndarray, shape (n,), int64
        Second of the newest one's stamp; 0 where there is none.
    evidence_start : ndarray, shape (n + 1,), int64
    evidence_class : ndarray, uint16
    evidence_sum : ndarray, float64
        In order of appearance.
    history_start : ndarray, shape (n + 1,), int64
    history_label : ndarray, uint16
    history_confidence : ndarray, float32
    history_frame : ndarray, int32
        Rows of the frame table.
    history_offset : ndarray, shape (., 3), uint8
        Where the points lay in the voxel, 256ths of its edge.

    """

    block_index: np.ndarray
    block_start: np.ndarray
    cell: np.ndarray
    observations: np.ndarray
    switches: np.ndarray
    label: np.ndarray
    majority: np.ndarray
    last: np.ndarray
    first_label: np.ndarray
    source: np.ndarray
    dirty: np.ndarray
    gone: np.ndarray
    posterior: np.ndarray
    passed: np.ndarray
    passed_at: np.ndarray
    evidence_start: np.ndarray
    evidence_class: np.ndarray
    evidence_sum: np.ndarray
    history_start: np.ndarray
    history_label: np.ndarray
    history_confidence: np.ndarray
    history_frame: np.ndarray
    history_offset: np.ndarray

    def voxels(self) -> NDArray[np.int64]:
        """Return the indices of the voxels, (n, 3) int64."""
        cell = self.cell.astype(np.int64)
        corner = np.repeat(self.block_index.astype(np.int64) * SIDE, np.diff(self.block_start),
                           axis=0)
        return corner + np.stack([cell >> 6, cell >> 3 & 7, cell & 7], axis=1)


@dataclass(frozen=True, eq=False)
class MemoryDump(Blocks):
    """
    Everything that a VoxelMemory knows: its blocks, and what goes by the whole map.

    Attributes
    ----------
    voxel_size : float
    origin : tuple of 3 floats
    max_history, session : int
    starts, changes : ndarray, shape (65536,), int64
        Class volatility's counters.
    seen_ids : ndarray, shape (65536,), uint8
    rho : ndarray, shape (65536,), float64, or None
    frames : core.memory.frame_table.FrameTable
    habits : dict of str to ndarray
        The parameters of the method geometry (core.geometry.kept), and with them known, voted,
        uint16: the ids that there were when they were fitted, and all that there are; {}: none.
    fitted_by : tuple or None
        The values of refine.up and refine.geometry that they were fitted with.

    """

    voxel_size: float
    origin: tuple[float, float, float]
    max_history: int
    session: int
    starts: NDArray[np.int64]
    changes: NDArray[np.int64]
    seen_ids: NDArray[np.uint8]
    rho: NDArray[np.float64] | None
    frames: FrameTable
    habits: dict[str, NDArray[Any]] = field_of(default_factory=dict)
    fitted_by: Optional[tuple[Any, ...]] = None
