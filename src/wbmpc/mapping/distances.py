"""Occupied cells to a grid of distances."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc import checks
from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.kernel.ir import LANES
from wbmpc.mapping.distance_step import signed
from wbmpc.obstacles.shapes import MAX_CELLS, DistanceGrid

#: Cells that a distance may be too large by: half a cell's diagonal, and what linear interpolation adds about a single cell.
ERROR = 1.05


class DistanceTransform:
    """Exact transforms of maps of one ``shape`` (nx, ny, nz) with cells of ``cell`` [m], up to ``farthest`` [m]: memory that is used again."""

    def __init__(self, shape: tuple[int, int, int], cell: float, farthest: float) -> None:
        self._shape, self._cell, self._farthest = shape, cell, farthest
        longest = max(shape)
        self._lines, self._start = np.empty(LANES * longest), np.empty(longest)
        self._apex, self._inner = np.empty(longest, np.int64), np.empty(int(np.prod(shape)))

    def __call__(self, evidence: NDArray[np.int64], occupied: int) -> Array:
        """Distances (nx, ny, nz) [m] of cells' centers to the nearest with at least ``occupied`` evidence (nx, ny, nz), negative in those."""
        out = np.empty(self._shape)
        signed(
            *self._shape, evidence.reshape(-1), occupied, self._cell, self._farthest, self._inner, self._lines, self._apex,
            self._start, out.reshape(-1),
        )  # fmt: skip
        return out


def distance_grid(origin: ArrayLike, cell: float, occupied: ArrayLike) -> DistanceGrid:
    """Distances to ``occupied`` cells (nx, ny, nz: true or false); the first one's center is at ``origin`` (3) [m], they are ``cell`` [m]
    apart. What is solid may be anywhere in a cell: :data:`ERROR` cells are taken off. Raises :class:`InputError` for another shape or what
    is neither true nor false."""
    cells = np.asarray(occupied)
    checks.positive("distance grid", cell=cell)
    if cells.dtype != bool or cells.ndim != 3 or min(cells.shape) < 2 or cells.size > MAX_CELLS:
        raise InputError(
            f"distance grid: 'occupied' needs three dimensions of 2 or more truth values, {MAX_CELLS} at most; "
            f"got {cells.shape} of {cells.dtype}"
        )
    farthest = float(cell * np.linalg.norm(cells.shape))
    values = DistanceTransform(cells.shape, float(cell), farthest)(np.ascontiguousarray(cells, np.int64), 1)
    return DistanceGrid(origin, float(cell), values, error=ERROR * float(cell))
