"""The point of a simplex that is nearest to the origin, compiled: of a point, a line, a triangle, a tetrahedron.

A simplex is kept in one array (:class:`Work`): its points, the points of the first solid that they are made of, their weights.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from wbmpc.clearance.compilation import compiled
from wbmpc.kernel.ir import Floats


class Work(IntEnum):
    """Where parts of the array ``work`` begin."""

    POINT = 0  # 4 points
    OWN = 12  # of the first solid, 4 points
    WEIGHT = 24  # 4
    FOUND = 28  # the nearest point
    V = 31  # from the second solid's nearest point to the first one's
    AT = 34  # the first one's nearest point, from its center
    SIZE = 40


#: A tetrahedron that is less high [m] is flat.
FLAT = 1e-9


@compiled
def dot(work: Floats, i: int, j: int) -> float:
    """Of two points of the simplex."""
    return work[3 * i] * work[3 * j] + work[3 * i + 1] * work[3 * j + 1] + work[3 * i + 2] * work[3 * j + 2]


@compiled
def segment(work: Floats, i: int, j: int) -> tuple[float, float]:
    """Weights of the nearest point of a line."""
    ii, ij, jj = dot(work, i, i), dot(work, i, j), dot(work, j, j)
    t = min(max((ii - ij) / max(ii - 2.0 * ij + jj, 1e-300), 0.0), 1.0)
    return 1.0 - t, t


@compiled
def difference(work: Floats, i: int, j: int) -> tuple[float, float, float]:
    """From point ``i`` to point ``j``."""
    return work[3 * j] - work[3 * i], work[3 * j + 1] - work[3 * i + 1], work[3 * j + 2] - work[3 * i + 2]


@compiled
def along(work: Floats, i: int, x: float, y: float, z: float) -> float:
    """A point of the simplex along a direction."""
    return work[3 * i] * x + work[3 * i + 1] * y + work[3 * i + 2] * z


@compiled
def triangle(work: Floats, i: int, j: int, k: int) -> tuple[float, float, float]:
    """Weights of the nearest point of a triangle: of a corner, an edge or its inside, by the signs of areas."""
    bx, by, bz = difference(work, i, j)
    cx, cy, cz = difference(work, i, k)
    b_i, c_i = -along(work, i, bx, by, bz), -along(work, i, cx, cy, cz)
    if b_i <= 0.0 and c_i <= 0.0:
        return 1.0, 0.0, 0.0
    b_j, c_j = -along(work, j, bx, by, bz), -along(work, j, cx, cy, cz)
    if b_j >= 0.0 and c_j <= b_j:
        return 0.0, 1.0, 0.0
    area_k = b_i * c_j - b_j * c_i
    if area_k <= 0.0 and b_i >= 0.0 and b_j <= 0.0:
        t = b_i / max(b_i - b_j, 1e-300)
        return 1.0 - t, t, 0.0
    b_k, c_k = -along(work, k, bx, by, bz), -along(work, k, cx, cy, cz)
    if c_k >= 0.0 and b_k <= c_k:
        return 0.0, 0.0, 1.0
    area_j = b_k * c_i - b_i * c_k
    if area_j <= 0.0 and c_i >= 0.0 and c_k <= 0.0:
        t = c_i / max(c_i - c_k, 1e-300)
        return 1.0 - t, 0.0, t
    area_i = b_j * c_k - b_k * c_j
    if area_i <= 0.0 and c_j >= b_j and b_k >= c_k:
        t = (c_j - b_j) / max(c_j - b_j + b_k - c_k, 1e-300)
        return 0.0, 1.0 - t, t
    whole = max(area_i + area_j + area_k, 1e-300)
    return area_i / whole, area_j / whole, area_k / whole


@compiled
def outside(work: Floats, i: int, j: int, k: int, other: int) -> bool:
    """Whether the origin is on the other side of a face than the fourth point, or the tetrahedron is flat."""
    bx, by, bz = difference(work, i, j)
    cx, cy, cz = difference(work, i, k)
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    level = along(work, i, nx, ny, nz)
    height = along(work, other, nx, ny, nz) - level
    flat = height * height <= FLAT * FLAT * (nx * nx + ny * ny + nz * nz)
    return flat or -level * height < 0.0


@compiled
def face(work: Floats, i: int, j: int, k: int, other: int, minimum: float) -> float:
    """Weights of the nearest point of a face where it is outside and nearer than ``minimum`` [m²], and its distance [m²]; else ``minimum``."""
    if not outside(work, i, j, k, other):
        return minimum
    wi, wj, wk = triangle(work, i, j, k)
    x = wi * work[3 * i] + wj * work[3 * j] + wk * work[3 * k]
    y = wi * work[3 * i + 1] + wj * work[3 * j + 1] + wk * work[3 * k + 1]
    z = wi * work[3 * i + 2] + wj * work[3 * j + 2] + wk * work[3 * k + 2]
    found = x * x + y * y + z * z
    if found < minimum:
        work[Work.WEIGHT + i], work[Work.WEIGHT + j], work[Work.WEIGHT + k] = wi, wj, wk
        work[Work.WEIGHT + other] = 0.0
        return found
    return minimum


@compiled
def set_weights(work: Floats, count: int) -> bool:
    """Set the weights of ``count`` points; False where the origin is inside of the tetrahedron."""
    w = int(Work.WEIGHT)
    if count == 1:
        work[w] = 1.0
    elif count == 2:
        work[w], work[w + 1] = segment(work, 0, 1)
    elif count == 3:
        work[w], work[w + 1], work[w + 2] = triangle(work, 0, 1, 2)
    else:
        minimum = face(work, 0, 1, 2, 3, np.inf)
        minimum = face(work, 0, 1, 3, 2, minimum)
        minimum = face(work, 0, 2, 3, 1, minimum)
        minimum = face(work, 1, 2, 3, 0, minimum)
        return minimum < np.inf
    return True


@compiled
def reduce(work: Floats, count: int) -> int:
    """Keep the points that the nearest one is made of, first, and put it to ``Work.FOUND``: how many they are; 0: the origin is inside."""
    if not set_weights(work, count):
        return 0
    kept = 0
    for a in range(3):
        work[Work.FOUND + a] = 0.0
    for i in range(count):
        weight = work[Work.WEIGHT + i]
        if weight > 0.0:
            work[Work.WEIGHT + kept] = weight
            for a in range(3):
                work[Work.FOUND + a] += weight * work[3 * i + a]
                work[3 * kept + a] = work[3 * i + a]
                work[Work.OWN + 3 * kept + a] = work[Work.OWN + 3 * i + a]
            kept += 1
    return kept
