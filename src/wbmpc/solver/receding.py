"""Compiled code of one step of receding-horizon control: shift the last solution, sample references, solve."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from wbmpc.ocp import ModeSchedule, Reference, Transcription
from wbmpc.solver import driver
from wbmpc.solver.compilation import compiled

_LINEAR, _POSE, _HOLD, _POSE_HOLD = range(4)


class Tables(NamedTuple):
    """References and modes over absolute time, flat. One row per reference slot."""

    times: np.ndarray
    values: np.ndarray
    first_time: np.ndarray
    samples: np.ndarray
    first_value: np.ndarray
    width: np.ndarray
    kind: np.ndarray
    place: np.ndarray
    events: np.ndarray
    modes: np.ndarray  # (modes, mode values and switches)
    mode_place: int


def make_tables(problem: Transcription, references: Mapping[str, Reference], schedule: ModeSchedule) -> Tables:
    """Flat tables of all references (by term name) and of the mode schedule."""
    names = [n for n in problem.references.slices if n in references]
    chosen = [references[n] for n in names]
    counts = np.array([r.times.size for r in chosen], dtype=np.int64)
    widths = np.array([r.values.shape[1] for r in chosen], dtype=np.int64)
    ends = lambda sizes: np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64) if sizes.size else sizes
    flat = lambda parts: np.concatenate([p.ravel() for p in parts]) if parts else np.zeros(1)
    return Tables(
        times=flat([r.times for r in chosen]),
        values=flat([r.values for r in chosen]),
        first_time=ends(counts),
        samples=counts,
        first_value=ends(counts * widths),
        width=widths,
        kind=np.array([Reference.KINDS.index(r.kind) for r in chosen], dtype=np.int64),
        place=np.array([problem.node.slices[f"reference.{n}"].start for n in names], dtype=np.int64),
        events=np.array(schedule.events, float),
        modes=problem.mode_tables(schedule),
        mode_place=problem.node.slices["mode"].start,
    )


@compiled
def sample(tables, t, m, out):  # type: ignore[no-untyped-def]
    """References and mode values at time t into the parameter vector at offset ``out`` of ``m``."""
    for s in range(tables.samples.size):
        n, width, place, kind = tables.samples[s], tables.width[s], tables.place[s], tables.kind[s]
        times = tables.times[tables.first_time[s] : tables.first_time[s] + n]
        hold = kind == 2 or kind == 3
        i = np.searchsorted(times, t + (1e-9 if hold else 0.0), side="right") - 1
        fraction = 0.0
        if i < 0:
            i = 0
        elif i < n - 1 and not hold:
            fraction = (t - times[i]) / (times[i + 1] - times[i])
        base = tables.first_value[s] + i * width
        for c in range(width):
            value = tables.values[base + c]
            if fraction > 0.0:
                value += fraction * (tables.values[base + width + c] - value)
            m[out + place + c] = value
        if kind == 1 and fraction > 0.0:
            norm = 0.0
            for c in range(3, 7):
                norm += m[out + place + c] ** 2
            for c in range(3, 7):
                m[out + place + c] /= np.sqrt(norm)
    mode = np.searchsorted(tables.events, t + 1e-9, side="right")
    for c in range(tables.modes.shape[1]):
        m[out + tables.mode_place + c] = tables.modes[mode, c]


@compiled
def sample_all(m, o, tables, t0):  # type: ignore[no-untyped-def]
    """Parameters of all nodes for a horizon that starts at ``t0`` [s]."""
    for k in range(o[driver.N] + 1):
        sample(tables, t0 + m[o[driver.GRID] + k], m, o[driver.P] + k * o[driver.NP])


@compiled
def shift(m, o, delta):  # type: ignore[no-untyped-def]
    """Move the trajectories ``delta`` [s] forward in time; the last values hold beyond the end."""
    n, nx, nu, g = o[driver.N], o[driver.NX], o[driver.NU], o[driver.GRID]
    i = 0
    for k in range(n + 1):
        t = min(m[g + k] + delta, m[g + n])
        while i < n - 1 and m[g + i + 1] <= t:
            i += 1
        a = (t - m[g + i]) / (m[g + i + 1] - m[g + i])
        x = o[driver.X] + i * nx
        for c in range(nx):
            m[o[driver.XT] + k * nx + c] = (1.0 - a) * m[x + c] + a * m[x + nx + c]
    i = 0
    for k in range(n):
        # inputs are constant over an interval: interpolate between the intervals' middles
        t = 0.5 * (m[g + k] + m[g + k + 1]) + delta
        while i < n - 2 and 0.5 * (m[g + i + 1] + m[g + i + 2]) < t:
            i += 1
        a = 0.0
        if n > 1:
            low, high = 0.5 * (m[g + i] + m[g + i + 1]), 0.5 * (m[g + i + 1] + m[g + i + 2])
            a = min(max((t - low) / (high - low), 0.0), 1.0)
        after = nu if n > 1 else 0
        u = o[driver.U] + i * nu
        for c in range(nu):
            m[o[driver.UT] + k * nu + c] = (1.0 - a) * m[u + c] + a * m[u + after + c]
    driver.take(m, o)


@compiled
def receding_solve(m, o, tables, t0, delta, x0, iterations, tolerance, feasibility, smallest, certify, force, log):  # type: ignore[no-untyped-def]
    """Shift by ``delta``, sample at ``t0``, iterate: (status, steps done)."""
    if delta > 0.0:
        shift(m, o, delta)
    sample_all(m, o, tables, t0)
    return driver.solve(m, o, x0, iterations, tolerance, feasibility, smallest, certify, force, log)


@compiled
def simulate(m, o, x, u, h, out):  # type: ignore[no-untyped-def]
    """One Runge-Kutta step of the model with the parameters of node 0."""
    xt, ut, end = o[driver.XT], o[driver.UT], o[driver.F] + 5 * o[driver.LX]
    for i in range(o[driver.NX]):
        m[xt + i] = x[i]
    for i in range(o[driver.NU]):
        m[ut + i] = u[i]
    driver.integrate(m, o, xt, ut, o[driver.P], h, end)
    for i in range(o[driver.NX]):
        out[i] = m[end + i]
