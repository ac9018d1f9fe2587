"""Which points belong to the robot itself, compiled."""

from __future__ import annotations

from wbmpc.clearance.support_step import beyond
from wbmpc.kernel.ir import Floats, Integers
from wbmpc.mapping.compilation import compiled
from wbmpc.mapping.rays_step import OWN


@compiled
def mark_own(
    n: int, points: Floats, shapes: int, kind: Integers, size: Floats, around: Floats, place: Floats, axes: Floats,
    padding: float, found: Integers,
) -> None:  # fmt: skip
    """``found`` (n) of points (n, 3) that are within ``padding`` [m] of a solid becomes :data:`OWN`. Solids: ``kind`` and ``size`` as in
    :mod:`wbmpc.clearance.support_step`, radius ``around`` their centers ``place`` (s, 3), ``axes`` (s, 3, 3)."""
    for p in range(n):
        for s in range(shapes):
            x, y, z = (
                points[3 * p] - place[3 * s],
                points[3 * p + 1] - place[3 * s + 1],
                points[3 * p + 2] - place[3 * s + 2],
            )
            reach, r = around[s] + padding, 9 * s
            if x * x + y * y + z * z > reach * reach:
                continue
            inside = beyond(
                s, kind, size,
                axes[r] * x + axes[r + 3] * y + axes[r + 6] * z,
                axes[r + 1] * x + axes[r + 4] * y + axes[r + 7] * z,
                axes[r + 2] * x + axes[r + 5] * y + axes[r + 8] * z,
            )  # fmt: skip
            if inside <= padding:
                found[p] = OWN
                break
