"""Parameters between refinements: estimated on by sweeps, and as plain arrays for map files."""

from __future__ import annotations

from dataclasses import astuple, replace
from typing import Any, Union

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.entries import entries_of
from persem_ros.core.geometry.groups import Cells, cells_from, cells_listed, KINDS, SHAPES
from persem_ros.core.geometry.parameters import correlation, estimate, Parameters, Sums
from persem_ros.core.geometry.posteriors import MOST as MOST_DENSE
from persem_ros.core.geometry.sparse_parameters import (
    estimate_sparse, SparseParameters, SparseSums)
from persem_ros.core.geometry.totals import Numbers
from persem_ros.core.memory.pools import ranges
from persem_ros.settings.heights import canonical

MOST = 2.0 ** 53         # voxels or looks that a sum may come to
LEAST_PI = 1e-12        # section 12.4 adds 1e-9 to each
Any_Parameters = Union[Parameters, SparseParameters]
Arrays = dict[str, NDArray[Any]]


class Tally:
    """
    The sums of a sweep under way (spec section 12.5: one EM round a sweep).

    Attributes
    ----------
    voxels : int
        How many were counted.
    sums : Sums, SparseSums or None

    """

    def __init__(self) -> None:
        self.voxels = 0
        self.sums: Any = None

    def add(self, sums: Union[Sums, SparseSums], voxels: int) -> None:
        """Add the sums of a slice."""
        self.voxels += voxels
        if self.sums is None:
            self.sums = sums
        else:
            self.sums.add(sums)

    def parameters(self, before: Any_Parameters, shrink: float) -> Any_Parameters:
        """
        Return the parameters that follow; those from before where no vote was counted.

        That is also where all votes are for classes that they do not know: max_history had taken
        these from sight when they were fitted.

        """
        counts = (0, 0) if self.sums is None else self.sums.confusion
        if not np.any(counts[1] if isinstance(counts, tuple) else counts):
            return before
        rho = correlation(self.sums, before.rho)
        form = estimate if isinstance(before, Parameters) else estimate_sparse
        return form(self.sums, self.voxels, before.classes, before.cells, rho, shrink)


def in_cells(parameters: Any_Parameters, cells: tuple[Cells, Cells]) -> Any_Parameters:
    """Return the same parameters by the numbers of other cells; what these lack is let go."""
    return within(parameters.arrays(), cells)


def with_cells(parameters: Any_Parameters, cells: tuple[Cells, Cells]) -> Any_Parameters:
    """Return the same parameters by numbers of their cells and of other ones."""
    wider = []
    for own, other in zip(parameters.cells, cells):
        own_cells, others = cells_listed(own), cells_listed(other)
        new = others[Numbers(own_cells).of(others) < 0]
        wider.append(cells_from(np.concatenate([own_cells, new])))
    return in_cells(parameters, (wider[0], wider[1]))


def filled(parameters: Any_Parameters, before: Any_Parameters) -> Any_Parameters:
    """Return parameters that say what those *before* did of cells in which nothing was counted."""
    K = len(parameters.classes)
    if isinstance(parameters, Parameters) and isinstance(before, Parameters):
        groups = [parameters.groups[0]]
        for R, old in zip(parameters.groups[1:], before.groups[1:]):
            R, by_cell = R.copy(), (-1, KINDS * K)
            empty = ~R[:-1].reshape(by_cell).any(axis=1)
            R[:-1].reshape(by_cell)[empty] = old[:-1].reshape(by_cell)[empty]
            groups.append(R)
        return replace(parameters, groups=groups)
    arrays, theirs = parameters.arrays(), before.arrays()
    for name in ('coarse', 'shifted'):
        totals = arrays[f'{name}_totals'].copy()
        empty = ~totals[:-1].reshape(-1, KINDS).any(axis=1)
        totals[:-1].reshape(-1, KINDS)[empty] = \
            theirs[f'{name}_totals'][:-1].reshape(-1, KINDS)[empty]
        more = np.append(empty, False)[theirs[f'{name}_keys'] // (KINDS * K)]
        less = ~np.append(empty, False)[arrays[f'{name}_keys'] // (KINDS * K)]
        keys, values = (np.concatenate([
            arrays[f'{name}_{what}'][less], theirs[f'{name}_{what}'][more]])
            for what in ('keys', 'values'))
        order = np.argsort(keys)
        arrays |= {f'{name}_totals': totals, f'{name}_keys': keys[order],
                   f'{name}_values': values[order]}
    return from_arrays(arrays)


def within(arrays: Arrays, cells: tuple[Cells, Cells]) -> Any_Parameters:
    """
    Return the parameters that arrays() gave, by the numbers of some cells and of these only.

    Parameters
    ----------
    arrays : dict
        Of the whole map; they may lie in files, of which little is read.
    cells : pair of core.geometry.groups.Cells
        They need not be the map's.

    """
    lists = [Numbers(arrays[name]).of(cells_listed(own)) for name, own in zip(
        ('cells', 'shifted_cells'), cells)]
    classes, pi, fine = (np.array(arrays[name]) for name in ('classes', 'pi', 'fine'))
    K, rho = len(classes), float(arrays['rho'][0])
    if 'theta' in arrays:
        groups = [fine]
        for name, number in zip(('coarse', 'shifted'), lists):
            found, known = np.zeros((len(number) * KINDS + 1, K)), number >= 0
            found[:-1].reshape(-1, KINDS, K)[known] = \
                arrays[name][:-1].reshape(-1, KINDS, K)[number[known]]
            groups.append(found)
        return Parameters(classes, cells, pi, np.array(arrays['theta']), groups, rho)
    entries, totals = [], []
    for name, number in zip(('coarse', 'shifted'), lists):
        keys, values, found = _of_cells(arrays, name, number, K)
        entries.append(entries_of(keys, values))
        totals.append(found)
    confusion = entries_of(*(np.array(arrays[f'confusion_{what}']) for what in ('keys', 'values')))
    return SparseParameters(
        classes, cells, pi, rho, confusion, np.array(arrays['rows']), np.array(arrays['f']),
        float(arrays['a'][0]), fine, (entries[0], entries[1]), (totals[0], totals[1]))


def _of_cells(arrays: Arrays, name: str, number: NDArray[np.int64], K: int) -> tuple[
        NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return keys and values of the groups of cells, and their totals; -1 is no cell."""
    listed, size = arrays[f'{name}_keys'], KINDS * K
    begin, end = (np.searchsorted(listed, (number + k) * size) for k in (0, 1))
    rows = ranges(begin, np.where(number >= 0, end - begin, 0))
    own = np.repeat(np.arange(len(number)), np.where(number >= 0, end - begin, 0))
    totals, known = np.zeros(len(number) * KINDS + 1), number >= 0
    totals[:-1].reshape(-1, KINDS)[known] = \
        arrays[f'{name}_totals'][:-1].reshape(-1, KINDS)[number[known]]
    return own * size + np.array(listed[rows]) % size, \
        np.array(arrays[f'{name}_values'][rows]), totals


def from_arrays(arrays: Arrays) -> Any_Parameters:
    """Return the parameters that arrays() gave; sound() says whether they are any."""
    cells = cells_from(arrays['cells']), cells_from(arrays['shifted_cells'])
    classes, pi, rho = arrays['classes'], arrays['pi'], float(arrays['rho'][0])
    if 'theta' in arrays:
        return Parameters(classes, cells, pi, arrays['theta'],
                          [arrays[name] for name in ('fine', 'coarse', 'shifted')], rho)
    entries = {name: entries_of(arrays[f'{name}_keys'], arrays[f'{name}_values'])
               for name in ('confusion', 'coarse', 'shifted')}
    return SparseParameters(
        classes, cells, pi, rho, entries['confusion'], arrays['rows'], arrays['f'],
        float(arrays['a'][0]), arrays['fine'], (entries['coarse'], entries['shifted']),
        (arrays['coarse_totals'], arrays['shifted_totals']))


def fitted_by(settings: Any) -> tuple[Any, ...]:
    """Return what parameters depend on besides the map: the values of refine.up and .geometry."""
    *constants, heights = astuple(settings.geometry)
    return (settings.up, *constants, *filter(None, [canonical(heights)]))   # older maps had none


def parameters_of(memory: Any, settings: Any) -> Any:
    """Return the parameters that a map has for settings (refine), None where it has none."""
    if memory.fitted_by != fitted_by(settings):
        return None
    if memory.geometry is None and memory.habits:
        return from_arrays(memory.habits)
    return memory.geometry


def sound(arrays: Arrays) -> bool:
    """Return whether arrays (of a file from anywhere) are parameters that can be gone by."""
    try:
        K = len(arrays['classes'])
        if 'theta' in arrays and K > MOST_DENSE:
            return False
        groups = [len(arrays[name]) * KINDS + 1 for name in ('cells', 'shifted_cells')]
        shapes = {'classes': (K,), 'pi': (K,), 'rho': (1,), 'cells': (len(arrays['cells']), 2),
                  'shifted_cells': (len(arrays['shifted_cells']), 2), 'fine': (SHAPES, K)}
        if 'theta' in arrays:
            shapes.update(theta=(K, K), coarse=(groups[0], K), shifted=(groups[1], K))
        else:
            shapes.update(rows=(K,), f=(K,), a=(1,), coarse_totals=(groups[0],),
                          shifted_totals=(groups[1],))
            for name, most in (('confusion', K * K), ('coarse', groups[0] * K),
                               ('shifted', groups[1] * K)):
                keys = arrays[f'{name}_keys']
                shapes[f'{name}_keys'] = shapes[f'{name}_values'] = (len(keys),)
                if keys.dtype != np.int64 or len(np.unique(keys)) != len(keys) or \
                        len(keys) and not 0 <= int(keys.min()) <= int(keys.max()) < most:
                    return False
        whole = {'classes': np.uint16, 'known': np.uint16, 'voted': np.uint16,
                 'cells': np.int32, 'shifted_cells': np.int32}
        integers = {*whole, *(name for name in arrays if name.endswith('_keys'))}
        return bool(
            K and set(arrays) == {*shapes, *whole}
            and all(arrays[name].dtype == kind for name, kind in whole.items())
            and all(arrays[name].shape == shape for name, shape in shapes.items())
            and (np.diff(arrays['classes'].astype(int)) > 0).all()
            and all(a.dtype == np.float64 and (a >= 0).all() and (a <= MOST).all()
                    for name, a in arrays.items() if name not in integers)
            and (arrays['pi'] >= LEAST_PI).all())
    except (KeyError, AttributeError, ValueError, TypeError):
        return False
