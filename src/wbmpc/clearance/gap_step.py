"""The gap between two convex solids, compiled: the algorithm of Gilbert, Johnson and Keerthi on their cores.

It begins with the direction that the last call found: that of the same pair at the node before, so that few iterations are left.
"""

from __future__ import annotations

import numpy as np

from wbmpc.clearance.compilation import compiled
from wbmpc.clearance.simplex_step import Work, reduce
from wbmpc.clearance.support_step import Solids, core_radius, support
from wbmpc.kernel.ir import Floats

#: Iterations at most; share of the squared distance that ends them; cores nearer [m] than this touch.
MAX_ITERATIONS, ENOUGH, TOUCH = 40, 1e-7, 1e-6


@compiled
def add_point(
    solids: Solids, a: int, b: int, place: Floats, pa: int, axes: Floats, ra: int, others: Floats, pb: int, turns: Floats,
    rb: int, work: Floats, count: int,
) -> float:  # fmt: skip
    """Put the difference of the cores' farthest points against and along ``Work.V`` to the simplex; how far it is along that."""
    x, y, z = work[Work.V], work[Work.V + 1], work[Work.V + 2]
    ax, ay, az = support(solids, a, axes, ra, -x, -y, -z)
    bx, by, bz = support(solids, b, turns, rb, x, y, z)
    own, at = Work.OWN + 3 * count, 3 * count
    work[own], work[own + 1], work[own + 2] = ax, ay, az
    work[at] = ax - bx - (others[pb] - place[pa])
    work[at + 1] = ay - by - (others[pb + 1] - place[pa + 1])
    work[at + 2] = az - bz - (others[pb + 2] - place[pa + 2])
    return work[at] * x + work[at + 1] * y + work[at + 2] * z


@compiled
def take_found(work: Floats, count: int) -> None:
    """Make the simplex' nearest point the one between the solids."""
    for c in range(3):
        work[Work.V + c], work[Work.AT + c] = work[Work.FOUND + c], 0.0
        for i in range(count):
            work[Work.AT + c] += work[Work.WEIGHT + i] * work[Work.OWN + 3 * i + c]


@compiled
def first_direction(place: Floats, pa: int, others: Floats, pb: int, work: Floats) -> None:
    """Where there is none yet: from center to center."""
    v = int(Work.V)
    if work[v] ** 2 + work[v + 1] ** 2 + work[v + 2] ** 2 > 1e-16:
        return
    x, y, z = place[pa] - others[pb], place[pa + 1] - others[pb + 1], place[pa + 2] - others[pb + 2]
    same = x * x + y * y + z * z < 1e-16
    work[v], work[v + 1], work[v + 2] = x, y, 1.0 if same else z


@compiled
def gap(
    solids: Solids, a: int, b: int, place: Floats, pa: int, axes: Floats, ra: int, others: Floats, pb: int, turns: Floats,
    rb: int, limit: float, work: Floats,
) -> float:  # fmt: skip
    """Distance [m] of solids ``a`` and ``b``, or ``limit`` where it is not less; minus infinity where their cores touch.

    Their centers and axes begin at ``place[pa]``, ``axes[ra]`` and ``others[pb]``, ``turns[rb]``. ``work``: what
    :class:`~wbmpc.clearance.simplex_step.Work` says; of a distance below ``limit`` ``V`` and ``AT`` are those of the cores.
    """
    first_direction(place, pa, others, pb, work)
    radius = core_radius(solids, a) + core_radius(solids, b)
    reach, square, count = limit + radius, np.inf, 0
    for _ in range(MAX_ITERATIONS):
        vv = work[Work.V] ** 2 + work[Work.V + 1] ** 2 + work[Work.V + 2] ** 2
        ahead = add_point(
            solids, a, b, place=place, pa=pa, axes=axes, ra=ra, others=others, pb=pb, turns=turns, rb=rb, work=work, count=count
        )  # fmt: skip
        if ahead > 0.0 and (reach <= 0.0 or ahead * ahead >= vv * reach * reach):
            return limit
        if count > 0 and vv - ahead <= ENOUGH * vv:
            break
        count = reduce(work, count + 1)
        found = work[Work.FOUND] ** 2 + work[Work.FOUND + 1] ** 2 + work[Work.FOUND + 2] ** 2
        if count == 0 or found < TOUCH * TOUCH:
            for c in range(3):
                work[Work.V + c] = 0.0
            return -np.inf
        if found >= square * (1.0 - 1e-13):
            break
        square = found
        take_found(work, count)
    return min(np.sqrt(square) - radius, limit)
