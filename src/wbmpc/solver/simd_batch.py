"""Compiled code of eight nodes at a time: stage functions, Runge-Kutta steps and their sensitivities.

A block is up to eight nodes from node ``first`` on, one in each lane; lanes beyond them repeat the last one. Blocks called
``lane_…`` hold eight nodes side by side. All nodes of a problem have the same functions: modes and references are parameters.
"""

from __future__ import annotations

import numpy as np

from wbmpc.ocp.transcription import MIN_SOFTNESS
from wbmpc.solver.barriers import BARRIER, CHAIN_C, CHAIN_W, COUNTED, INTERVAL, LANE_COST, barrier_lanes
from wbmpc.solver.compilation import LANES, Floats, Integers, call2, call4, call5, compiled
from wbmpc.solver.memory_layout import (
    AB,
    ARG,
    BASE,
    CHAIN_FIRST,
    CHAIN_NEXT,
    END_BOXES,
    EPS,
    GRID,
    INDEX,
    J1,
    J2,
    LANE_AB,
    LANE_F,
    LANE_J1,
    LANE_J2,
    LANE_J3,
    LANE_J4,
    LANE_NEXT,
    LANE_P,
    LANE_S1,
    LANE_S2,
    LANE_S3,
    LANE_SMALL,
    LANE_U,
    LANE_VALUES,
    LANE_X,
    LANES_COST,
    LANES_DYNAMICS,
    LANES_DYNAMICS_J,
    LANES_EQUALITY,
    LANES_ROWS,
    LG,
    LX,
    LZ,
    NG,
    NP,
    NU,
    NX,
    PACK,
    PATH_BOXES,
    QUATERNIONS,
    RES,
    RK4,
    ROW_GENERAL,
    SLOPES,
    SMALL,
    UNPACK_AB,
    P,
    W,
)
from wbmpc.solver.stages import interval, jump_sensitivity, jumps_after


@compiled
def stage_lanes(o: Integers, function: int, x: int, u: int, r0: int, r1: int, r2: int) -> None:
    """Call a function of eight nodes' (x, u, p, w, h); states, inputs and results at offsets into the memory."""
    base = o[BASE]
    o[ARG], o[ARG + 1], o[ARG + 2] = base + 8 * x, base + 8 * u, base + 8 * o[LANE_P]
    o[ARG + 3], o[ARG + 4] = base + 8 * o[W], base + 8 * (o[LANE_SMALL] + INTERVAL)
    o[RES], o[RES + 1], o[RES + 2] = base + 8 * r0, base + 8 * r1, base + 8 * r2
    call2(o[function], o.ctypes.data + 8 * ARG, o.ctypes.data + 8 * RES)


@compiled
def pack(o: Integers, source: int, width: int, out: int, count: int) -> None:
    """``count`` nodes' ``width`` numbers each, from ``source`` on, side by side to ``out``."""
    base = o[BASE]
    call5(o[PACK], base + 8 * source, 8 * width, (width + 7) // 8, base + 8 * out, count - 1)


@compiled
def unpack(o: Integers, function: int, lanes: int, out: int, size: int, count: int) -> None:
    """The entries in ``lanes`` to ``count`` matrices, ``size`` doubles apart."""
    base = o[BASE]
    call4(o[function], base + 8 * lanes, base + 8 * out, 8 * size, count - 1)


@compiled
def load_block(m: Floats, o: Integers, first: int, count: int, x: int, u: int) -> None:
    """States, inputs, parameters and intervals of a block; ``x``, ``u``: where the trajectories are."""
    nx, nu = o[NX], o[NU]
    pack(o, x + first * nx, nx, o[LANE_X], count)
    pack(o, x + (first + 1) * nx, nx, o[LANE_NEXT], count)
    pack(o, u + first * nu, nu, o[LANE_U], count)
    pack(o, o[P] + first * o[NP], o[NP], o[LANE_P], count)
    for i in range(LANES):
        k = first + min(i, count - 1)
        m[o[LANE_SMALL] + INTERVAL + i] = m[o[GRID] + k + 1] - m[o[GRID] + k]
        m[o[LANE_SMALL] + COUNTED + i] = 1.0 if i < count else 0.0


@compiled
def offset_lanes(m: Floats, o: Integers, out: int, x: int, f: int, c: float) -> None:
    """out = x + c h f."""
    h = o[LANE_SMALL] + INTERVAL
    step = c * m[h : h + LANES]
    for i in range(0, LANES * o[NX], LANES):
        m[out + i : out + i + LANES] = m[x + i : x + i + LANES] + step * m[f + i : f + i + LANES]


@compiled
def combine_lanes(m: Floats, o: Integers, out: int, k1: int) -> None:
    """out = x + h (k1 + 2 k2 + 2 k3 + k4) / 6 with the slopes one after the other."""
    h, x, size = o[LANE_SMALL] + INTERVAL, o[LANE_X], LANES * o[NX]
    step = m[h : h + LANES] / 6.0
    for i in range(0, size, LANES):
        a, b, c, d = k1 + i, k1 + i + size, k1 + i + 2 * size, k1 + i + 3 * size
        total = m[a : a + LANES] + 2.0 * m[b : b + LANES] + 2.0 * m[c : c + LANES] + m[d : d + LANES]
        m[out + i : out + i + LANES] = m[x + i : x + i + LANES] + step * total


@compiled
def normalize_lanes(m: Floats, o: Integers, x: int, ab: int) -> None:
    """Unit length of the quaternions of a state; with ``ab`` ≥ 0 the derivative of that onto its rows."""
    size, boxes = LANES * o[LZ], o[PATH_BOXES] + o[END_BOXES]
    for s in range(o[QUATERNIONS]):
        q = x + LANES * o[INDEX + boxes + s]
        row, total = ab + size * o[INDEX + boxes + s], np.full(LANES, 0.0)
        for i in range(q, q + 4 * LANES, LANES):
            total = total + m[i : i + LANES] * m[i : i + LANES]
        inverse = 1.0 / np.sqrt(total)
        for i in range(q, q + 4 * LANES, LANES):
            m[i : i + LANES] = m[i : i + LANES] * inverse
        if ab >= 0:
            for c in range(0, size, LANES):
                along = np.full(LANES, 0.0)
                for i in range(4):
                    a, b = q + LANES * i, row + size * i + c
                    along = along + m[a : a + LANES] * m[b : b + LANES]
                for i in range(4):
                    a, b = q + LANES * i, row + size * i + c
                    m[b : b + LANES] = (m[b : b + LANES] - m[a : a + LANES] * along) * inverse


@compiled
def integrate_lanes(m: Floats, o: Integers, function: int) -> int:
    """Runge-Kutta steps of a block; returns where the ends are. ``function``: the dynamics, or they with their Jacobians, which
    then go to the sensitivities of the steps in ``lane_ab``."""
    size, x, u, k1 = LANES * o[NX], o[LANE_X], o[LANE_U], o[LANE_F]
    middle, end, j1, j2 = k1 + 4 * size, k1 + 5 * size, o[LANE_J1], o[LANE_J2]
    j3, j4 = o[LANE_J3], o[LANE_J4]
    derivative = function == LANES_DYNAMICS_J
    stage_lanes(o, function, x, u, k1, j1, j1)
    offset_lanes(m, o, middle, x, k1, 0.5)
    stage_lanes(o, function, middle, u, k1 + size, j2, j2)
    if o[RK4] == 0:
        if derivative:
            chain(m, o, CHAIN_FIRST, j2, j1, o[LANE_S1], 0.5, 1.0)
        offset_lanes(m, o, end, x, k1 + size, 1.0)
        return end
    if derivative:
        chain(m, o, CHAIN_FIRST, j2, j1, o[LANE_S1], 0.5, 1.0 / 3.0)
    offset_lanes(m, o, middle, x, k1 + size, 0.5)
    stage_lanes(o, function, middle, u, k1 + 2 * size, j3, j3)
    if derivative:
        chain(m, o, CHAIN_NEXT, j3, o[LANE_S1], o[LANE_S2], 0.5, 1.0 / 3.0)
    offset_lanes(m, o, middle, x, k1 + 2 * size, 1.0)
    stage_lanes(o, function, middle, u, k1 + 3 * size, j4, j4)
    if derivative:
        chain(m, o, CHAIN_NEXT, j4, o[LANE_S2], o[LANE_S3], 1.0, 1.0 / 6.0)
    combine_lanes(m, o, end, k1)
    return end


@compiled
def chain(m: Floats, o: Integers, function: int, j: int, s: int, t: int, c: float, weight: float) -> None:
    """t = j + c h j_x s; lane_ab += weight h t, after the first stage's part and the unit matrix by CHAIN_FIRST."""
    base, small = o[BASE], o[LANE_SMALL]
    h = m[small + INTERVAL : small + INTERVAL + LANES]
    m[small + CHAIN_C : small + CHAIN_C + LANES] = c * h
    m[small + CHAIN_W : small + CHAIN_W + LANES] = weight * h
    call5(o[function], base + 8 * j, base + 8 * s, base + 8 * t, base + 8 * o[LANE_AB], base + 8 * (small + CHAIN_C))


@compiled
def linearize_dynamics(m: Floats, o: Integers, first: int, count: int) -> None:
    """[A b B] of a block that is loaded."""
    nx, lx, lz, size = o[NX], o[LX], o[LZ], (o[NX] + 1) * o[LZ]
    end, ab = integrate_lanes(m, o, LANES_DYNAMICS_J), o[AB] + first * size
    normalize_lanes(m, o, end, o[LANE_AB])
    for i in range(nx):
        at, e, x = o[LANE_AB] + LANES * (i * lz + nx), end + LANES * i, o[LANE_NEXT] + LANES * i
        m[at : at + LANES] = m[e : e + LANES] - m[x : x + LANES]
    unpack(o, UNPACK_AB, o[LANE_AB], ab, size, count)
    for lane in range(count):
        if jumps_after(o, first + lane):
            after, own = o[SLOPES] + 5 * lx, ab + lane * size
            for i in range(nx):
                m[after + i] = m[end + LANES * i + lane]
            jump_sensitivity(m, o, after, o[P] + (first + lane + 1) * o[NP], own)
            for i in range(nx):
                m[own + i * lz + nx] = m[after + i] - m[o[LANE_NEXT] + LANES * i + lane]


@compiled
def single_lane(m: Floats, o: Integers, lane: int) -> None:
    """What exact second derivatives of a midpoint step need of one node: Jacobians of both slopes, the state in the middle."""
    for i in range(o[NX] * o[LZ]):
        m[o[J1] + i] = m[o[LANE_J1] + LANES * i + lane]
        m[o[J2] + i] = m[o[LANE_J2] + LANES * i + lane]
    for i in range(o[NX]):
        m[o[SLOPES] + 4 * o[LX] + i] = m[o[LANE_F] + LANES * (4 * o[NX] + i) + lane]


@compiled
def evaluate_rows(m: Floats, o: Integers) -> None:
    """Values of the general rows of a block that is loaded."""
    if o[ROW_GENERAL] > 0:
        stage_lanes(o, LANES_ROWS, o[LANE_X], o[LANE_U], o[LANE_VALUES], o[LANE_VALUES], o[LANE_VALUES])


@compiled
def take_rows_of_lane(m: Floats, o: Integers, lane: int) -> None:
    """Values of one node's general rows into ``small`` from entry 16 on."""
    for j in range(o[ROW_GENERAL]):
        m[o[SMALL] + 16 + j] = m[o[LANE_VALUES] + LANES * j + lane]


@compiled
def gaps(m: Floats, o: Integers, first: int, count: int, x: int, u: int) -> float:
    """Σ |end of the interval − next state| of a block that is loaded from the trajectories ``x``, ``u``."""
    nx, counted, jumped = o[NX], o[LANE_SMALL] + COUNTED, 0.0
    end = integrate_lanes(m, o, LANES_DYNAMICS)
    normalize_lanes(m, o, end, -1)
    total = np.full(LANES, 0.0)
    for i in range(0, LANES * nx, LANES):
        e, n = end + i, o[LANE_NEXT] + i
        total = total + abs(m[e : e + LANES] - m[n : n + LANES])
    for lane in range(count):
        k = first + lane
        if jumps_after(o, k):
            after = o[SLOPES] + 5 * o[LX]
            interval(m, o, k, x + k * nx, u + k * o[NU], after)
            for i in range(nx):
                jumped += abs(m[after + i] - m[x + (k + 1) * nx + i])
            m[counted + lane] = 0.0
    inner = np.where(m[counted : counted + LANES] > 0.0, total, 0.0)
    for lane in range(count):
        m[counted + lane] = 1.0
    return np.sum(inner) + jumped


@compiled
def equality_size(o: Integers) -> int:
    """Doubles between the equality rows of two nodes: [C e D] and Dᵀ."""
    return (o[NG] * o[LZ] + o[NU] * o[LG] + 7) // 8 * 8


@compiled
def cost_and_equalities(m: Floats, o: Integers) -> tuple[float, float]:
    """Path cost and barriers times h, and Σ |equality row| without those that are soft, of a block that is loaded."""
    small, values = o[LANE_SMALL], o[LANE_VALUES]
    counted = m[small + COUNTED : small + COUNTED + LANES] > 0.0
    stage_lanes(o, LANES_COST, o[LANE_X], o[LANE_U], small + LANE_COST, values, values)
    h = m[small + INTERVAL : small + INTERVAL + LANES]
    cost = m[small + LANE_COST : small + LANE_COST + LANES] + 0.0
    if o[PATH_BOXES] > 0:
        barrier_lanes(m, o, False)
        cost = cost + m[small + BARRIER : small + BARRIER + LANES]
    cost = np.where(counted, h * cost, 0.0)
    violation = np.full(LANES, 0.0)
    if o[NG] > 0:
        stage_lanes(o, LANES_EQUALITY, o[LANE_X], o[LANE_U], values, values, values)
        for q in range(o[NG]):
            at = values + LANES * q
            if m[o[EPS] + q] <= MIN_SOFTNESS:
                violation = violation + np.where(counted, abs(m[at : at + LANES]), 0.0)
    return np.sum(cost), np.sum(violation)
