"""Farthest points of convex solids, and distances of points to them, compiled.

A solid is a core and a radius about it: a ball is a point, a capsule a line with a radius; the others are cores alone. Kinds are
numbered as in :data:`wbmpc.obstacles.solids.KINDS`.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from wbmpc.clearance.compilation import compiled
from wbmpc.kernel.ir import Floats, Integers


class Kind(IntEnum):
    """Entries of the array ``kind``."""

    SPHERE = 0
    CAPSULE = 1
    ELLIPSOID = 2
    CYLINDER = 3
    BOX = 4
    MESH = 5


class Solids(NamedTuple):
    """A robot's solids, then others."""

    kind: Integers  # Kind
    size: Floats  # (s, 3) [m]
    around: Floats  # (s) [m], radii of the spheres around them
    first: Integers  # (s + 1), where the vertices of each begin
    vertices: Floats  # (v, 3) [m]


@compiled
def core_radius(solids: Solids, s: int) -> float:
    """The radius about a solid's core [m]."""
    if solids.kind[s] == Kind.SPHERE or solids.kind[s] == Kind.CAPSULE:
        return solids.size[3 * s]
    return 0.0


@compiled
def farthest_vertex(s: int, first: Integers, vertices: Floats, x: float, y: float, z: float) -> int:
    """Where the farthest vertex of a mesh along a direction in its axes begins in ``vertices``."""
    found, maximum = 3 * first[s], -np.inf
    for i in range(first[s], first[s + 1]):
        along = vertices[3 * i] * x + vertices[3 * i + 1] * y + vertices[3 * i + 2] * z
        if along > maximum:
            maximum = along
            found = 3 * i
    return found


@compiled
def round_support(k: int, size: Floats, at: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The farthest point of an ellipsoid or a cylinder along a direction, in its axes."""
    if k == Kind.ELLIPSOID:
        sx, sy, sz = x * size[at], y * size[at + 1], z * size[at + 2]
        length = max(np.sqrt(sx * sx + sy * sy + sz * sz), 1e-300)
        return sx * size[at] / length, sy * size[at + 1] / length, sz * size[at + 2] / length
    flat = size[at] / max(np.sqrt(x * x + y * y), 1e-300)
    return x * flat, y * flat, -size[at + 1] if z < 0.0 else size[at + 1]


@compiled
def local_support(solids: Solids, s: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The farthest point of a solid's core along a direction (x, y, z), both in its axes about its center."""
    at, k, size, vertices = 3 * s, solids.kind[s], solids.size, solids.vertices
    if k == Kind.SPHERE:
        return 0.0, 0.0, 0.0
    if k == Kind.CAPSULE:
        return 0.0, 0.0, -size[at + 1] if z < 0.0 else size[at + 1]
    if k == Kind.BOX:
        sx = -size[at] if x < 0.0 else size[at]
        sy = -size[at + 1] if y < 0.0 else size[at + 1]
        return sx, sy, -size[at + 2] if z < 0.0 else size[at + 2]
    if k == Kind.MESH:
        v = farthest_vertex(s, solids.first, vertices, x, y, z)
        return vertices[v], vertices[v + 1], vertices[v + 2]
    return round_support(k, size, at, x, y, z)


@compiled
def support(solids: Solids, s: int, axes: Floats, r: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The same in the world's axes: those of the solid are columns of the matrix that begins at ``axes[r]``."""
    lx, ly, lz = local_support(
        solids, s,
        axes[r] * x + axes[r + 3] * y + axes[r + 6] * z,
        axes[r + 1] * x + axes[r + 4] * y + axes[r + 7] * z,
        axes[r + 2] * x + axes[r + 5] * y + axes[r + 8] * z,
    )  # fmt: skip
    return (
        axes[r] * lx + axes[r + 1] * ly + axes[r + 2] * lz,
        axes[r + 3] * lx + axes[r + 4] * ly + axes[r + 5] * lz,
        axes[r + 6] * lx + axes[r + 7] * ly + axes[r + 8] * lz,
    )


@compiled
def beyond(s: int, kind: Integers, size: Floats, x: float, y: float, z: float) -> float:
    """At most the distance [m] of a point, in a solid's axes about its center, to it; 0 and less inside."""
    at, k = 3 * s, kind[s]
    if k == Kind.SPHERE:
        return np.sqrt(x * x + y * y + z * z) - size[at]
    if k == Kind.CAPSULE or k == Kind.CYLINDER:
        flat, up = np.sqrt(x * x + y * y), max(abs(z) - size[at + 1], 0.0)
        if k == Kind.CAPSULE:
            return np.sqrt(flat * flat + up * up) - size[at]
        flat = max(flat - size[at], 0.0)
        return np.sqrt(flat * flat + up * up)
    dx, dy, dz = max(abs(x) - size[at], 0.0), max(abs(y) - size[at + 1], 0.0), max(abs(z) - size[at + 2], 0.0)
    return np.sqrt(dx * dx + dy * dy + dz * dz)
