"""Parameters between refinements: estimated on by sweeps, and as plain arrays for map files."""

from __future__ import annotations

from dataclasses import astuple, replace
from typing import Any, Union

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.dense import MOST as MOST_DENSE
from persem_ros.core.geometry.entries import entries_of, listed
from persem_ros.core.geometry.groups import Cells, cells_from, cells_listed, KINDS, SHAPES
from persem_ros.core.geometry.parameters import correlation, estimate, Parameters, Sums
from persem_ros.core.geometry.sparse import estimate_sparse, SparseParameters, SparseSums

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
        """Return the parameters that follow; those from before where nothing was counted."""
        if not self.voxels:
            return before
        rho = correlation(self.sums, before.rho)
        form = estimate if isinstance(before, Parameters) else estimate_sparse
        return form(self.sums, self.voxels, before.classes, before.cells, rho, shrink)


def in_cells(parameters: Any_Parameters, cells: tuple[Cells, Cells]) -> Any_Parameters:
    """Return the same parameters by the numbers of other cells; what these lack is let go."""
    K, lists = len(parameters.classes), []
    for old, new in zip(parameters.cells, cells):
        places = {tuple(at): k for k, at in enumerate(cells_listed(new).tolist())}
        lists.append(np.array([places.get(tuple(at), -1) for at in cells_listed(old).tolist()],
                              np.int64))
    if isinstance(parameters, Parameters):
        groups = [parameters.groups[0]]
        for R, new, moved in zip(parameters.groups[1:], cells, lists):
            found = np.zeros((new.number * KINDS + 1, K))
            stays = np.flatnonzero(moved >= 0)
            found[:-1].reshape(new.number, KINDS, K)[moved[stays]] = \
                R[:-1].reshape(len(moved), KINDS, K)[stays]
            groups.append(found)
        return replace(parameters, cells=cells, groups=groups)
    entries, totals = [], []
    for counted, new, moved in zip(parameters.groups, cells, lists):
        keys, values = listed(counted)
        at = np.append(moved, -1)[keys // (K * KINDS)]      # the last: of unknown cells
        keys, values = (at * K * KINDS + keys % (K * KINDS))[at >= 0], values[at >= 0]
        entries.append(entries_of(keys, values))
        totals.append(np.bincount(keys // K, values, new.number * KINDS + 1))
    return replace(parameters, cells=cells, groups=tuple(entries), totals=tuple(totals))


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


def parameters_of(memory: Any, settings: Any) -> Any:
    """Return the parameters that a map has for settings (refine), None where it has none."""
    if memory.fitted_by != (settings.up, *astuple(settings.geometry)):
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
