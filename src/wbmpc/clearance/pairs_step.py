"""Nearest points of many pairs of solids at many states, compiled: a robot's against obstacles, and against each other.

Pairs are compared node after node, so that each gap begins with the direction of the node before. Those that are too far by the
spheres around them, or by a solid against a sphere, are not compared.

The gap between two convex solids, compiled: the algorithm of Gilbert, Johnson and Keerthi on their cores.

It begins with the direction that the last call found: that of the same pair at the node before, so that few iterations are left.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.clearance.compilation import compiled
from wbmpc.clearance.simplex_step import Work, reduce
from wbmpc.clearance.support_step import Solids, beyond, core_radius, support
from wbmpc.kernel.ir import Floats, Integers

#: Iterations at most; share of the squared distance that ends them; cores nearer [m] than this touch.
MAX_ITERATIONS, ENOUGH, TOUCH = 40, 1e-7, 1e-6


class Body(NamedTuple):
    """A solid and where it stands: its center begins at ``place[at]``, its axes at ``axes[turn]``."""

    solid: int  # its number
    place: Floats
    at: int
    axes: Floats
    turn: int


@compiled
def add_point(solids: Solids, a: Body, b: Body, work: Floats, count: int) -> float:
    """Put the difference of the cores' farthest points against and along ``Work.V`` to the simplex; how far it is along that."""
    x, y, z = work[Work.V], work[Work.V + 1], work[Work.V + 2]
    ax, ay, az = support(solids, a.solid, a.axes, a.turn, -x, -y, -z)
    bx, by, bz = support(solids, b.solid, b.axes, b.turn, x, y, z)
    own, at = Work.OWN + 3 * count, 3 * count
    work[own], work[own + 1], work[own + 2] = ax, ay, az
    work[at] = ax - bx - (b.place[b.at] - a.place[a.at])
    work[at + 1] = ay - by - (b.place[b.at + 1] - a.place[a.at + 1])
    work[at + 2] = az - bz - (b.place[b.at + 2] - a.place[a.at + 2])
    return work[at] * x + work[at + 1] * y + work[at + 2] * z


@compiled
def take_found(work: Floats, count: int) -> None:
    """Make the simplex' nearest point the one between the solids."""
    for c in range(3):
        work[Work.V + c], work[Work.AT + c] = work[Work.FOUND + c], 0.0
        for i in range(count):
            work[Work.AT + c] += work[Work.WEIGHT + i] * work[Work.OWN + 3 * i + c]


@compiled
def first_direction(a: Body, b: Body, work: Floats) -> None:
    """Where there is none yet: from center to center."""
    v, pa, pb = int(Work.V), a.at, b.at
    if work[v] ** 2 + work[v + 1] ** 2 + work[v + 2] ** 2 > 1e-16:
        return
    x, y, z = a.place[pa] - b.place[pb], a.place[pa + 1] - b.place[pb + 1], a.place[pa + 2] - b.place[pb + 2]
    same = x * x + y * y + z * z < 1e-16
    work[v], work[v + 1], work[v + 2] = x, y, 1.0 if same else z


@compiled
def gap(solids: Solids, a: Body, b: Body, limit: float, work: Floats) -> float:
    """Distance [m] of two solids, or ``limit`` where it is not less; minus infinity where their cores touch: ``AT`` is then where
    cores without a volume do. ``work``: what :class:`~wbmpc.clearance.simplex_step.Work` says; of a distance below ``limit`` ``V`` and ``AT``
    are those of the cores."""
    first_direction(a, b, work)
    radius = core_radius(solids, a.solid) + core_radius(solids, b.solid)
    reach, square, count = limit + radius, np.inf, 0
    for _ in range(MAX_ITERATIONS):
        vv = work[Work.V] ** 2 + work[Work.V + 1] ** 2 + work[Work.V + 2] ** 2
        ahead = add_point(solids, a, b, work, count)
        if ahead > 0.0 and (reach <= 0.0 or ahead * ahead >= vv * reach * reach):
            return limit
        if count > 0 and vv - ahead <= ENOUGH * vv:
            break
        count = reduce(work, count + 1)
        found = work[Work.FOUND] ** 2 + work[Work.FOUND + 1] ** 2 + work[Work.FOUND + 2] ** 2
        if count == 0 or found < TOUCH * TOUCH:
            take_found(work, count)
            for c in range(3):
                work[Work.V + c] = 0.0
            return -np.inf
        if found >= square * (1.0 - 1e-13):
            break
        square = found
        take_found(work, count)
    return min(np.sqrt(square) - radius, limit)


class Gaps(NamedTuple):
    """What is found, by entry: as much as :class:`wbmpc.clearance.table.Found` has."""

    distance: Floats
    normal: Floats
    own: Floats
    other: Floats


class Around(NamedTuple):
    """A robot's solids at n states, and others."""

    frame_of: Integers  # (s)
    place: Floats  # (n, s, 3) [m]
    axes: Floats  # (n, s, 3, 3)
    others: Floats  # (n, o, 3) [m]
    turns: Floats  # (o, 3, 3)
    touching: Integers  # (n · s · o), which pairs touch


@compiled
def place_solids(
    n: int, shapes: int, frames: int, frame_of: Integers, local: Floats, turn: Floats, position: Floats, rotation: Floats,
    place: Floats, axes: Floats,
) -> None:  # fmt: skip
    """Centers ``place`` (n, s, 3) and ``axes`` (n, s, 3, 3) of a robot's solids, at ``local`` (s, 3) and ``turn`` (s, 3, 3) of their frames."""
    for k in range(n):
        for s in range(shapes):
            at, p, r = k * frames + frame_of[s], 3 * (k * shapes + s), 9 * (k * shapes + s)
            for i in range(3):
                place[p + i] = position[3 * at + i]
                for j in range(3):
                    place[p + i] += rotation[9 * at + 3 * i + j] * local[3 * s + j]
                    axes[r + 3 * i + j] = 0.0
                    for c in range(3):
                        axes[r + 3 * i + j] += rotation[9 * at + 3 * i + c] * turn[9 * s + 3 * c + j]


@compiled
def bound(solids: Solids, a: Body, b: Body, limit: float) -> float:
    """A lower bound of the distance [m] of two solids by their enclosing spheres; of ``a`` itself against the sphere of ``b`` where that
    is less than ``limit``."""
    p, q, axes, r = a.at, b.at, a.axes, a.turn
    x, y, z = b.place[q] - a.place[p], b.place[q + 1] - a.place[p + 1], b.place[q + 2] - a.place[p + 2]
    around, reach = solids.around[b.solid], solids.around[a.solid] + solids.around[b.solid] + limit
    square = x * x + y * y + z * z
    if reach <= 0.0 or square >= reach * reach:
        return np.inf
    lx = axes[r] * x + axes[r + 3] * y + axes[r + 6] * z
    ly = axes[r + 1] * x + axes[r + 4] * y + axes[r + 7] * z
    lz = axes[r + 2] * x + axes[r + 5] * y + axes[r + 8] * z
    return beyond(a.solid, solids.kind, solids.size, lx, ly, lz) - around


@compiled
def write_gap(solids: Solids, gaps: Gaps, a: Body, b: Body, d: float, i: int, work: Floats) -> None:
    """Write a gap that has been found to entry ``i``: ``normal`` from ``b`` to ``a``, the nearest points ``own`` and ``other`` in the world."""
    v, at = int(Work.V), int(Work.AT)
    length = np.sqrt(work[v] ** 2 + work[v + 1] ** 2 + work[v + 2] ** 2)
    ra, rb = core_radius(solids, a.solid), core_radius(solids, b.solid)
    gaps.distance[i] = d
    for c in range(3):
        n = work[v + c] / length
        gaps.normal[3 * i + c] = n
        gaps.own[3 * i + c] = a.place[a.at + c] + work[at + c] - ra * n
        gaps.other[3 * i + c] = a.place[a.at + c] + work[at + c] - work[v + c] + rb * n


@compiled
def nearest(
    n: int, shapes: int, frames: int, others_count: int, solids: Solids, gaps: Gaps, around: Around, work: Floats
) -> tuple[int, int]:
    """Of each of n states, ``frames`` and ``others_count`` others, numbered after the robot's ``shapes``: what is nearer than the
    ``distance`` (n, f, o) of ``gaps`` on entry. How many pairs were compared, and how many of them touch: their numbers
    (k · shapes + s) · others_count + o are in ``touching``."""
    frame_of, place, axes, touching = around.frame_of, around.place, around.axes, around.touching
    others, turns, compared, touch = around.others, around.turns, 0, 0
    for o in range(others_count):
        for s in range(shapes):
            b, rb = shapes + o, 9 * o
            for c in range(3):
                work[Work.V + c] = 0.0
            for k in range(n):
                i = (k * frames + frame_of[s]) * others_count + o
                limit = gaps.distance[i]
                pa, ra, pb = 3 * (k * shapes + s), 9 * (k * shapes + s), 3 * (k * others_count + o)
                if bound(solids, Body(b, others, pb, turns, rb), Body(s, place, pa, axes, ra), limit) >= limit:
                    continue
                compared += 1
                d = gap(solids, Body(s, place, pa, axes, ra), Body(b, others, pb, turns, rb), limit, work)
                if d == -np.inf:
                    touching[touch] = (k * shapes + s) * others_count + o
                    touch += 1
                elif d < limit:
                    write_gap(solids, gaps, Body(s, place, pa, axes, ra), Body(b, others, pb, turns, rb), d, i, work)
    return compared, touch
