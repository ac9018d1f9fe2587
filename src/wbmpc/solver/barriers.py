"""Compiled code of relaxed barriers on single variables: of one node, and of eight at a time."""

from __future__ import annotations

import numpy as np

from wbmpc.solver.compilation import LANES, Floats, Integers, Vector, compiled
from wbmpc.solver.memory_layout import (
    BOXES,
    INDEX,
    LANE_BARRIER,
    LANE_SMALL,
    LANE_U,
    LANE_X,
    NU,
    NX,
    PATH_BOXES,
)

#: Vectors of ``lane_small``: length of the interval [s], 1 where the lane counts, what the chain rule takes (c, w), cost,
#: barriers.
INTERVAL, COUNTED, CHAIN_C, CHAIN_W, LANE_COST, BARRIER = (8 * i for i in range(6))


@compiled
def barrier_value(m: Floats, o: Integers, start: int, count: int, x: int, u: int) -> float:
    """Σ barrier(h) of boxes ``start`` … ; logarithms of products of h with the same μ."""
    total, product, mu, first = 0.0, 1.0, 0.0, o[NX] + 1
    for r in range(start, start + count):
        i, b = o[INDEX + r], o[BOXES] + 4 * r
        value = m[x + i] if i < first else m[u + i - first]
        h, delta = m[b] * value + m[b + 1], m[b + 3]
        if h > delta:
            if m[b + 2] != mu or product > 1e100 or product < 1e-100:
                total -= mu * np.log(product)
                product, mu = 1.0, m[b + 2]
            product *= h
        else:
            q = (h - 2.0 * delta) / delta
            total += m[b + 2] * (0.5 * (q * q - 1.0) - np.log(delta))
    return total - mu * np.log(product)


@compiled
def add_square(m: Floats, o: Integers, matrix: int, ld: int, i: int, curve: float, slope: float) -> None:
    """Curvature and slope of one variable onto a matrix of the extended node vector."""
    constant = o[NX]
    m[matrix + i * ld + i] += curve
    m[matrix + i * ld + constant] += slope
    if i < constant:
        m[matrix + constant * ld + i] += slope


@compiled
def add_barrier(
    m: Floats, o: Integers, start: int, count: int, x: int, u: int, scale: float, matrix: int, ld: int
) -> None:
    """Gradient and curvature of the boxes, times ``scale``, onto a matrix of the extended node vector."""
    constant = o[NX]
    for r in range(start, start + count):
        i, b = o[INDEX + r], o[BOXES] + 4 * r
        sign, mu, delta = m[b], m[b + 2], m[b + 3]
        h = sign * (m[x + i] if i < constant else m[u + i - constant - 1]) + m[b + 1]
        if h > delta:
            slope, curve = -mu / h, mu / (h * h)
        else:
            slope, curve = mu * (h - 2.0 * delta) / (delta * delta), mu / (delta * delta)
        add_square(m, o, matrix, ld, i, scale * curve * sign * sign, scale * slope * sign)


@compiled
def add_derivatives(m: Floats, o: Integers, variable: int, sign: float, slope: Vector, curve: Vector) -> None:
    """Slope and curvature of one variable onto those of the block."""
    at = o[LANE_BARRIER] + 2 * LANES * variable
    after = at + LANES
    m[at : at + LANES] = m[at : at + LANES] + sign * slope
    m[after : after + LANES] = m[after : after + LANES] + sign * sign * curve


@compiled
def barrier_lanes(m: Floats, o: Integers, derivative: bool) -> None:
    """Σ barrier(h) of a block's nodes into ``lane_small``; with ``derivative`` slope and curvature by variable, too."""
    first, value, product, mu = o[NX] + 1, np.full(LANES, 0.0), np.full(LANES, 1.0), 0.0
    if derivative:
        for i in range(0, 2 * LANES * (first + o[NU]), LANES):
            m[o[LANE_BARRIER] + i : o[LANE_BARRIER] + i + LANES] = np.full(LANES, 0.0)
    for r in range(o[PATH_BOXES]):
        i, b = o[INDEX + r], o[BOXES] + 4 * r
        at = o[LANE_X] + LANES * i if i < first else o[LANE_U] + LANES * (i - first)
        weight, delta = m[b + 2], m[b + 3]
        h = m[b] * m[at : at + LANES] + m[b + 1]
        inside = h > delta
        if weight != mu or not np.all((product > 1e-100) & (product < 1e100)):
            value = value - mu * np.log(product)
            product, mu = np.full(LANES, 1.0), weight
        held = np.where(inside, h, 1.0)
        product = product * held
        inverse = 1.0 / held
        slope, curve = -weight * inverse, weight * inverse * inverse
        if not np.all(inside):
            q = (h - 2.0 * delta) / delta
            value = value + np.where(inside, 0.0, weight * (0.5 * (q * q - 1.0) - np.log(delta)))
            slope = np.where(inside, slope, weight / delta * q)
            curve = np.where(inside, curve, weight / (delta * delta))
        if derivative:
            add_derivatives(m, o, i, m[b], slope, curve)
    out = o[LANE_SMALL] + BARRIER
    m[out : out + LANES] = value - mu * np.log(product)


@compiled
def add_barrier_of_lane(m: Floats, o: Integers, lane: int, matrix: int, ld: int) -> None:
    """One node's slopes and curvatures, times its interval, onto its Hessian."""
    h, constant = m[o[LANE_SMALL] + INTERVAL + lane], o[NX]
    for i in range(constant + 1 + o[NU]):
        at = o[LANE_BARRIER] + 2 * LANES * i + lane
        if i != constant and m[at + LANES] != 0.0:
            add_square(m, o, matrix, ld, i, h * m[at + LANES], h * m[at])
