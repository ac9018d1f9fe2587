"""Compiled code of one interval of one node: stage functions, Runge-Kutta steps, jumps at events and their derivatives."""

from __future__ import annotations

import numpy as np

from wbmpc.solver.compilation import Floats, Integers, call2, compiled
from wbmpc.solver.memory_layout import (
    ARG,
    BASE,
    DYNAMICS,
    END_BOXES,
    GRID,
    INDEX,
    JUMP,
    JUMP_J,
    JUMPS,
    LX,
    LZ,
    NP,
    NX,
    PATH_BOXES,
    QUATERNIONS,
    RES,
    RK4,
    ROW_TOTAL,
    S1,
    S2,
    SLOPES,
    SMALL,
    P,
    W,
)


@compiled
def stage(o: Integers, function: int, x: int, u: int, p: int, r0: int, r1: int, r2: int) -> None:
    """Call a stage function of (x, u, p, w, h); all arguments are offsets into the memory."""
    base = o[BASE]
    o[ARG], o[ARG + 1], o[ARG + 2] = base + 8 * x, base + 8 * u, base + 8 * p
    o[ARG + 3], o[ARG + 4] = base + 8 * o[W], base + 8 * (o[SMALL] + 2)
    o[RES], o[RES + 1], o[RES + 2] = base + 8 * r0, base + 8 * r1, base + 8 * r2
    call2(o[function], o.ctypes.data + 8 * ARG, o.ctypes.data + 8 * RES)


@compiled
def stage_end(o: Integers, function: int, x: int, p: int, r0: int, r1: int) -> None:
    """Call a stage function of (x, p, w): of the end of the horizon, or of an event."""
    base = o[BASE]
    o[ARG], o[ARG + 1], o[ARG + 2] = base + 8 * x, base + 8 * p, base + 8 * o[W]
    o[RES], o[RES + 1], o[RES + 2] = base + 8 * r0, base + 8 * r1, base + 8 * r1
    call2(o[function], o.ctypes.data + 8 * ARG, o.ctypes.data + 8 * RES)


@compiled
def row_index(o: Integers) -> int:
    """First of the rows' entries in the table: their indices in [x, 1, u]; behind them, whether an event ends an interval."""
    return INDEX + o[PATH_BOXES] + o[END_BOXES] + o[QUATERNIONS]


@compiled
def row_count(o: Integers) -> int:
    """Length of the row table: 0 without rows that have a state of their own."""
    return o[ROW_TOTAL]


@compiled
def jumps_after(o: Integers, k: int) -> bool:
    """Whether an event with a jump of the state ends interval k."""
    return o[JUMPS] > 0 and o[row_index(o) + row_count(o) + k] > 0


@compiled
def normalize(m: Floats, o: Integers, x: int) -> None:
    """Unit length of the quaternions of a state."""
    boxes = o[PATH_BOXES] + o[END_BOXES]
    for s in range(o[QUATERNIONS]):
        q = o[INDEX + boxes + s]
        norm = np.sqrt(m[x + q] ** 2 + m[x + q + 1] ** 2 + m[x + q + 2] ** 2 + m[x + q + 3] ** 2)
        for i in range(q, q + 4):
            m[x + i] /= norm


@compiled
def offset_state(m: Floats, o: Integers, out: int, x: int, f: int, c: float) -> None:
    """out = x + c f."""
    for i in range(o[NX]):
        m[out + i] = m[x + i] + c * m[f + i]


@compiled
def combine(m: Floats, o: Integers, out: int, x: int, k1: int, h: float) -> None:
    """out = x + h (k1 + 2 k2 + 2 k3 + k4) / 6 with the slopes one after the other."""
    lx = o[LX]
    for i in range(o[NX]):
        k = k1 + i
        m[out + i] = m[x + i] + h / 6.0 * (m[k] + 2.0 * m[k + lx] + 2.0 * m[k + 2 * lx] + m[k + 3 * lx])


@compiled
def integrate(m: Floats, o: Integers, x: int, u: int, p: int, h: float, out: int) -> None:
    """One Runge-Kutta step of the state at offset ``x`` to ``out``."""
    lx = o[LX]
    k1 = o[SLOPES]
    middle = k1 + 4 * lx
    stage(o, DYNAMICS, x, u, p, k1, k1, k1)
    offset_state(m, o, middle, x, k1, 0.5 * h)
    stage(o, DYNAMICS, middle, u, p, k1 + lx, k1, k1)
    if o[RK4] == 0:
        offset_state(m, o, out, x, k1 + lx, h)
    else:
        offset_state(m, o, middle, x, k1 + lx, 0.5 * h)
        stage(o, DYNAMICS, middle, u, p, k1 + 2 * lx, k1, k1)
        offset_state(m, o, middle, x, k1 + 2 * lx, h)
        stage(o, DYNAMICS, middle, u, p, k1 + 3 * lx, k1, k1)
        combine(m, o, out, x, k1, h)
    normalize(m, o, out)


@compiled
def interval(m: Floats, o: Integers, k: int, x: int, u: int, out: int) -> None:
    """The state at the end of interval k, after the jump if an event ends it."""
    p, nx = o[P] + k * o[NP], o[NX]
    integrate(m, o, x, u, p, m[o[GRID] + k + 1] - m[o[GRID] + k], out)
    if jumps_after(o, k):
        stage_end(o, JUMP, out, p + o[NP], o[SLOPES], o[SLOPES])
        for i in range(nx):
            m[out + i] = m[o[SLOPES] + i]


@compiled
def jump_sensitivity(m: Floats, o: Integers, x: int, p: int, ab: int) -> None:
    """x = g(x) in place; rows of ab times the Jacobian of g."""
    nx, lx, lz = o[NX], o[LX], o[LZ]
    jacobian, rows, after = o[S1], o[S2], o[SLOPES]
    for i in range(nx * lz):
        m[jacobian + i] = 0.0
    stage_end(o, JUMP_J, x, p, after, jacobian)
    for i in range(nx):
        m[x + i] = m[after + i]
        for c in range(lz):
            m[rows + i * lz + c] = 0.0
        for j in range(nx):
            factor = m[jacobian + i * lx + j]
            for c in range(lz):
                m[rows + i * lz + c] += factor * m[ab + j * lz + c]
    for i in range(nx * lz):
        m[ab + i] = m[rows + i]
        m[jacobian + i] = 0.0
        m[rows + i] = 0.0
