"""Compiled code of equality rows g with a softness ε to speak of: g(z) = r with a cost of ½ r² / ε.

The quadratic problem has r eliminated: after a full step r is what the linearized row is. The line search has r as a variable that
moves along its own step, from r = g at the start: as for any SQP the merit then falls along the step. With |g| among the
violations it would not (g ≠ 0 at the solution), and with ½ g² / ε as a cost steps follow a curved valley.
"""

from __future__ import annotations

from wbmpc.ocp.transcription import MIN_SOFTNESS
from wbmpc.solver.barriers import COUNTED
from wbmpc.solver.compilation import LANES, Floats, Integers, compiled
from wbmpc.solver.memory_layout import (
    DU,
    DX,
    EPS,
    LANE_E,
    LANE_SMALL,
    LANE_U,
    LANE_VALUES,
    LANE_X,
    LANES_EQUALITY,
    LANES_EQUALITY_J,
    LX,
    LZ,
    NG,
    NU,
    NX,
    SOFT_RESIDUAL,
    SOFT_RESIDUAL_STEP,
    UNPACK_EQUALITIES,
    E,
    N,
    U,
    X,
)
from wbmpc.solver.simd_batch import equality_size, load_block, stage_lanes, unpack


@compiled
def start_soft_residuals(m: Floats, o: Integers) -> None:
    """r = g at the iterate."""
    for first in range(0, o[N], LANES):
        count = min(LANES, o[N] - first)
        load_block(m, o, first, count, o[X], o[U])
        stage_lanes(o, LANES_EQUALITY, o[LANE_X], o[LANE_U], o[LANE_VALUES], o[LANE_VALUES], o[LANE_VALUES])
        for lane in range(count):
            for q in range(o[NG]):
                m[o[SOFT_RESIDUAL] + (first + lane) * o[NG] + q] = m[o[LANE_VALUES] + LANES * q + lane]


@compiled
def soft_residual_steps(m: Floats, o: Integers) -> tuple[float, float]:
    """Step of r along the directions dx, du; returns the slope of ½ r² / ε, and Σ r² / ε after the step."""
    nx, lz, slope, squares = o[NX], o[LZ], 0.0, 0.0
    for block in range(
        (o[N] - 1) // LANES, -1, -1
    ):  # as the elimination: at the end the buffer has the first node's rows
        first = block * LANES
        count = min(LANES, o[N] - first)
        load_block(m, o, first, count, o[X], o[U])
        stage_lanes(o, LANES_EQUALITY_J, o[LANE_X], o[LANE_U], o[LANE_E], o[LANE_E], o[LANE_E])
        unpack(o, UNPACK_EQUALITIES, o[LANE_E], o[E], equality_size(o), count)
        for lane in range(count):
            k = first + lane
            for q in range(o[NG]):
                row, at = o[E] + lane * equality_size(o) + q * lz, k * o[NG] + q
                ahead = m[row + nx]
                for i in range(nx):
                    ahead += m[row + i] * m[o[DX] + k * o[LX] + i]
                for i in range(o[NU]):
                    ahead += m[row + nx + 1 + i] * m[o[DU] + k * o[NU] + i]
                m[o[SOFT_RESIDUAL_STEP] + at] = ahead - m[o[SOFT_RESIDUAL] + at]
                if m[o[EPS] + q] > MIN_SOFTNESS:
                    slope += m[o[SOFT_RESIDUAL] + at] * m[o[SOFT_RESIDUAL_STEP] + at] / m[o[EPS] + q]
                    squares += ahead * ahead / m[o[EPS] + q]
    return slope, squares


@compiled
def soft_equality_terms(m: Floats, o: Integers, k: int, lane: int, alpha: float) -> tuple[float, float, float]:
    """Of node k, whose equality rows are in ``lane``: (Σ ½ r² / ε, Σ |g − r|, Σ |g|) with r a step of ``alpha`` further."""
    paid, apart, missed = 0.0, 0.0, 0.0
    for q in range(o[NG]):
        if m[o[EPS] + q] > MIN_SOFTNESS:
            g = m[o[LANE_VALUES] + LANES * q + lane]
            r = m[o[SOFT_RESIDUAL] + k * o[NG] + q] + alpha * m[o[SOFT_RESIDUAL_STEP] + k * o[NG] + q]
            paid, apart, missed = paid + 0.5 * r * r / m[o[EPS] + q], apart + abs(g - r), missed + abs(g)
    return paid, apart, missed


@compiled
def soft_equality_terms_of_block(m: Floats, o: Integers, first: int, alpha: float) -> tuple[float, float, float]:
    """As :func:`soft_equality_terms`, of a block that is loaded and whose equality rows have been evaluated."""
    paid, apart, missed = 0.0, 0.0, 0.0
    for lane in range(LANES):
        if m[o[LANE_SMALL] + COUNTED + lane] > 0.0:
            p, a, s = soft_equality_terms(m, o, first + lane, lane, alpha)
            paid, apart, missed = paid + p, apart + a, missed + s
    return paid, apart, missed


@compiled
def take_soft_residuals(m: Floats, o: Integers, alpha: float) -> None:
    """r moves by a step of ``alpha``."""
    for i in range(o[N] * o[NG]):
        m[o[SOFT_RESIDUAL] + i] += alpha * m[o[SOFT_RESIDUAL_STEP] + i]
