"""Occupied cells to a grid of distances.

Exact Euclidean distance transforms, compiled: lower envelopes of parabolas (Felzenszwalb and Huttenlocher), one axis after the other.

Distances are squared and in cells until the end; :data:`NONE` stands for no site, or none that is near enough. Lines without a site, and
lines of sites alone, stay as they are: most lines of the transform of the free cells.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc import checks
from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.kernel.ir import LANES, Floats, Integers
from wbmpc.mapping.compilation import compiled
from wbmpc.obstacles.shapes import MAX_CELLS, DistanceGrid

#: More than any squared distance [cells²].
NONE = 1e12


@compiled
def first_axis(lines: int, nz: int, evidence: Integers, occupied: int, outside: bool, out: Floats) -> None:
    """Squared distances along the last axis to cells of at least ``occupied`` evidence, or of less (not ``outside``)."""
    for line in range(lines):
        at, last = line * nz, -1
        for k in range(nz):
            if (evidence[at + k] >= occupied) == outside:
                last = k
            out[at + k] = float((k - last) * (k - last)) if last >= 0 else NONE
        last = -1
        for j in range(nz):
            k = nz - 1 - j
            if out[at + k] == 0.0:
                last = k
            if last >= 0:
                out[at + k] = min(out[at + k], float((last - k) * (last - k)))


@compiled
def envelope(n: int, at: int, f: Floats, apex: Integers, start: Floats) -> int:
    """Of the parabolas f[at + q] + (x - q)², q below n, those that are lowest somewhere: their ``apex`` and where each one's part begins; how
    many. Sites between sites are the lowest nowhere but at themselves: they are left out."""
    k = -1
    for q in range(n):
        i = at + q
        inner = f[i] == 0.0 and q > 0 and q + 1 < n
        if f[i] >= NONE or (inner and f[i - 1] == 0.0 and f[i + 1] == 0.0):
            continue
        cut, height = -1e18, f[at + q] + float(q * q)
        while k >= 0:
            v = apex[k]
            cut = (height - f[at + v] - float(v * v)) / float(2 * (q - v))
            if cut > start[k]:
                break
            k -= 1
            cut = -1e18
        k += 1
        apex[k], start[k] = q, cut
    return k + 1


@compiled
def is_plain(n: int, at: int, f: Floats) -> bool:
    """Whether a line stays as it is: all of it zero, or without a site."""
    far, near = True, True
    for q in range(n):
        far = far and f[at + q] >= NONE
        near = near and f[at + q] == 0.0
    return far or near


@compiled
def all_plain(at: int, step: int, n: int, out: Floats) -> bool:
    """The same of :data:`LANES` lines beside each other."""
    low, high = np.full(LANES, NONE), np.full(LANES, 0.0)
    for q in range(n):
        i = at + q * step
        low = np.minimum(low, out[i : i + LANES])
        high = np.maximum(high, out[i : i + LANES])
    plain = False
    if np.all(high == 0.0) or np.all(low >= NONE):
        plain = True
    return plain


@compiled
def transform_lines(
    width: int, at: int, step: int, n: int, maximum: float, out: Floats, f: Floats, apex: Integers, start: Floats
) -> None:
    """Some lines beside each other in place: their cells begin at ``at`` and are ``step`` apart. What is more than ``maximum`` becomes
    :data:`NONE`. They are read and written together: cells of one line are far from each other in memory."""
    if width == LANES and all_plain(at, step, n, out):
        return
    for q in range(n):
        for c in range(width):
            f[c * n + q] = out[at + q * step + c]
    for c in range(width):
        first = c * n
        if is_plain(n, first, f):
            continue
        count, k = envelope(n, first, f, apex, start), 0
        for q in range(n):
            while k + 1 < count and start[k + 1] < float(q):
                k += 1
            if f[first + q] == 0.0:
                continue
            v = apex[k]
            d = f[first + v] + float((q - v) * (q - v))
            out[at + q * step + c] = d if d <= maximum else NONE


@compiled
def transform(
    nx: int, ny: int, nz: int, evidence: Integers, occupied: int, outside: bool, maximum: float, out: Floats, f: Floats,
    apex: Integers, start: Floats,
) -> None:  # fmt: skip
    """Squared distances ``out`` (nx, ny, nz) to occupied cells, or to free ones (not ``outside``), up to ``maximum``; ``f``, ``apex``, ``start``:
    room for :data:`LANES` lines."""
    first_axis(nx * ny, nz, evidence, occupied, outside, out)
    for i in range(nx):
        for k in range(0, nz, LANES):
            transform_lines(min(LANES, nz - k), i * ny * nz + k, nz, ny, maximum, out, f, apex, start)
    for j in range(ny):
        for k in range(0, nz, LANES):
            transform_lines(min(LANES, nz - k), j * nz + k, ny * nz, nx, maximum, out, f, apex, start)


@compiled
def signed(
    nx: int, ny: int, nz: int, evidence: Integers, occupied: int, cell: float, farthest: float, inner: Floats, f: Floats,
    apex: Integers, start: Floats, out: Floats,
) -> None:  # fmt: skip
    """Distances ``out`` (nx, ny, nz) [m], at most ``farthest``, to the nearest occupied cell; in those minus that to the nearest free one."""
    maximum = farthest * farthest / (cell * cell)
    transform(nx, ny, nz, evidence, occupied, True, maximum, out, f, apex, start)
    transform(nx, ny, nz, evidence, occupied, False, maximum, inner, f, apex, start)
    for i in range(nx * ny * nz):
        d = np.sqrt(out[i]) - np.sqrt(inner[i])
        out[i] = min(max(cell * d, -farthest), farthest)


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
