"""Exact Euclidean distance transforms, compiled: lower envelopes of parabolas (Felzenszwalb and Huttenlocher), one axis after the other.

Distances are squared and in cells until the end; :data:`NONE` stands for no site, or none that is near enough. Lines without a site, and
lines of sites alone, stay as they are: most lines of the transform of the free cells.
"""

from __future__ import annotations

import numpy as np

from wbmpc.kernel.ir import Floats, Integers
from wbmpc.mapping.compilation import compiled

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
def envelope(n: int, f: Floats, apex: Integers, start: Floats) -> int:
    """The parabolas f[q] + (x - q)² that are lowest somewhere: their ``apex`` and where each one's part begins; how many."""
    k = -1
    for q in range(n):
        if f[q] >= NONE:
            continue
        cut, height = -1e18, f[q] + float(q * q)
        while k >= 0:
            v = apex[k]
            cut = (height - f[v] - float(v * v)) / float(2 * (q - v))
            if cut > start[k]:
                break
            k -= 1
            cut = -1e18
        k += 1
        apex[k], start[k] = q, cut
    return k + 1


@compiled
def line_transform(
    at: int, step: int, n: int, most: float, out: Floats, f: Floats, apex: Integers, start: Floats
) -> None:
    """One line in place: its cells begin at ``at`` and are ``step`` apart; what is more than ``most`` becomes :data:`NONE`."""
    far, near = True, True
    for q in range(n):
        f[q] = out[at + q * step]
        far = far and f[q] >= NONE
        near = near and f[q] == 0.0
    if far or near:
        return
    count, k = envelope(n, f, apex, start), 0
    for q in range(n):
        while k + 1 < count and start[k + 1] < float(q):
            k += 1
        v = apex[k]
        d = f[v] + float((q - v) * (q - v))
        out[at + q * step] = d if d <= most else NONE


@compiled
def transform(
    nx: int, ny: int, nz: int, evidence: Integers, occupied: int, outside: bool, most: float, out: Floats, f: Floats,
    apex: Integers, start: Floats,
) -> None:  # fmt: skip
    """Squared distances ``out`` (nx, ny, nz) to occupied cells, or to free ones (not ``outside``), up to ``most``; ``f``, ``apex``, ``start``:
    room for a line."""
    first_axis(nx * ny, nz, evidence, occupied, outside, out)
    for i in range(nx):
        for k in range(nz):
            line_transform(i * ny * nz + k, nz, ny, most, out, f, apex, start)
    for j in range(ny):
        for k in range(nz):
            line_transform(j * nz + k, ny * nz, nx, most, out, f, apex, start)


@compiled
def signed(
    nx: int, ny: int, nz: int, evidence: Integers, occupied: int, cell: float, farthest: float, inner: Floats, f: Floats,
    apex: Integers, start: Floats, out: Floats,
) -> None:  # fmt: skip
    """Distances ``out`` (nx, ny, nz) [m], at most ``farthest``, to the nearest occupied cell; in those minus that to the nearest free one."""
    most = farthest * farthest / (cell * cell)
    transform(nx, ny, nz, evidence, occupied, True, most, out, f, apex, start)
    transform(nx, ny, nz, evidence, occupied, False, most, inner, f, apex, start)
    for i in range(nx * ny * nz):
        d = np.sqrt(out[i]) - np.sqrt(inner[i])
        out[i] = min(max(cell * d, -farthest), farthest)
