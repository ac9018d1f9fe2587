"""Points of one scan into the evidence of an occupancy map, compiled.

Evidence of a cell is a whole number: a scan with a point in it adds :data:`HIT`, one whose rays only pass through it takes :data:`MISS` off,
each once; it stays between 0 and :data:`MAX_EVIDENCE`. So what moves away is gone after some scans.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.kernel.ir import Floats, Integers
from wbmpc.mapping.compilation import compiled

HIT, MISS, MAX_EVIDENCE = 3, 1, 6
#: Evidence from which on a cell is occupied.
OCCUPIED = 3
#: What a point of a scan is: no return (its ray clears alone), solid, part of the robot (its ray clears but for the last bit).
FREE, SOLID, OWN = 0, 1, 2


class Cells(NamedTuple):
    """Cells of a map: ``evidence``, the last scan that changed each (``mark``), and when it was ``seen`` last [s]."""

    nx: int
    ny: int
    nz: int
    lowest: int  # the layer from which on points count
    evidence: Integers
    mark: Integers
    seen: Floats


@compiled
def cell_of(cells: Cells, x: float, y: float, z: float) -> int:
    """The cell with a point (in cells from the corner of the first one); -1 outside of the map."""
    if not (x >= 0.0 and y >= 0.0 and z >= 0.0 and x < cells.nx and y < cells.ny and z < cells.nz):
        return -1
    return (int(x) * cells.ny + int(y)) * cells.nz + int(z)


@compiled
def add_hits(cells: Cells, n: int, points: Floats, kind: Integers, time: float, scan: int) -> int:
    """Add the solid ones of points (n, 3, in cells) that are in layer ``lowest`` or above. How many."""
    evidence, mark, seen, count = cells.evidence, cells.mark, cells.seen, 0
    for p in range(n):
        if kind[p] != SOLID or points[3 * p + 2] < cells.lowest:
            continue
        at = cell_of(cells, points[3 * p], points[3 * p + 1], points[3 * p + 2])
        if at >= 0:
            count += 1
            if mark[at] != 2 * scan + 1:
                mark[at] = 2 * scan + 1
                evidence[at] = min(evidence[at] + HIT, MAX_EVIDENCE)
                seen[at] = time
    return count


@compiled
def span(start: float, ahead: float, size: float, low: float, high: float) -> tuple[float, float]:
    """The part of [low, high] in which ``start + s · ahead`` is within [0, size]."""
    if abs(ahead) < 1e-12:
        return (low, high) if 0.0 <= start < size else (1.0, 0.0)
    a, b = (0.0 - start) / ahead, (size - start) / ahead
    return max(low, min(a, b)), min(high, max(a, b))


@compiled
def next_wall(place: float, ahead: float, index: int) -> float:
    """The share of a ray, from ``place`` on, at which it leaves cell ``index`` along one axis."""
    if abs(ahead) < 1e-12:
        return 1e18
    return (float(index + 1) - place) / ahead if ahead > 0.0 else (float(index) - place) / ahead


@compiled
def clear_ray(
    cells: Cells, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, end: float, scan: int
) -> None:
    """Take evidence off the cells that a ray from (ox, oy, oz) to share ``end`` of (dx, dy, dz) passes, but for the last one."""
    nx, ny, nz, evidence, mark = cells.nx, cells.ny, cells.nz, cells.evidence, cells.mark
    low, high = span(ox, dx, float(nx), 0.0, end)
    low, high = span(oy, dy, float(ny), low, high)
    low, high = span(oz, dz, float(nz), low, high)
    if low >= high:
        return
    inside = low + 1e-9
    x, y, z = ox + inside * dx, oy + inside * dy, oz + inside * dz
    i = min(max(int(np.floor(x)), 0), nx - 1)
    j = min(max(int(np.floor(y)), 0), ny - 1)
    k = min(max(int(np.floor(z)), 0), nz - 1)
    tx, ty, tz = next_wall(ox, dx, i), next_wall(oy, dy, j), next_wall(oz, dz, k)
    sx, sy, sz = 1.0 / max(abs(dx), 1e-12), 1.0 / max(abs(dy), 1e-12), 1.0 / max(abs(dz), 1e-12)
    while min(tx, min(ty, tz)) < end:
        at = (i * ny + j) * nz + k
        if mark[at] < 2 * scan:
            mark[at] = 2 * scan
            evidence[at] = max(evidence[at] - MISS, 0)
        if tx <= ty and tx <= tz:
            i += 1 if dx > 0.0 else -1
            tx += sx
        elif ty <= tz:
            j += 1 if dy > 0.0 else -1
            ty += sy
        else:
            k += 1 if dz > 0.0 else -1
            tz += sz
        if i < 0 or j < 0 or k < 0 or i >= nx or j >= ny or k >= nz:
            return


@compiled
def add_scan(
    cells: Cells, n: int, points: Floats, kind: Integers, ox: float, oy: float, oz: float, reach: float, keep: float, time: float,
    scan: int,
) -> int:  # fmt: skip
    """Add points (n, 3) that were seen from (ox, oy, oz), all in cells: hits, then what their rays pass, up to ``reach`` and, before
    the robot itself, ``keep``. ``scan``: its number, from 1 on. How many hits there were in the map."""
    count = add_hits(cells, n, points, kind, time, scan)
    for p in range(n):
        dx, dy, dz = points[3 * p] - ox, points[3 * p + 1] - oy, points[3 * p + 2] - oz
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        end = min(1.0, reach / max(length, 1e-9))
        if kind[p] == OWN:
            end -= keep / max(length, 1e-9)
        if end > 0.0:
            clear_ray(cells, ox, oy, oz, dx, dy, dz, end, scan)
    return count


@compiled
def settle(columns: int, nz: int, lowest: int, oldest: float, evidence: Integers, seen: Floats) -> None:
    """Forget cells whose last hit was before ``oldest`` [s]; what stands in the ``lowest`` layer goes on below it, to the floor."""
    for column in range(columns):
        at = column * nz
        for k in range(lowest, nz):
            if evidence[at + k] > 0 and seen[at + k] < oldest:
                evidence[at + k] = 0
        for k in range(lowest):
            evidence[at + k] = evidence[at + lowest]
