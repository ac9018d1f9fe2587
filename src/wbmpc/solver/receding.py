"""Compiled code of one step of receding-horizon control: move the grid, shift the last solution, sample, solve."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from wbmpc.ocp import ModeSchedule, Reference, Transcription
from wbmpc.ocp.parameters import mode_tables
from wbmpc.solver.compilation import LANES, LIBRARY, Floats, Integers, compiled
from wbmpc.solver.driver import solve
from wbmpc.solver.inequality_table import entry, node_rows
from wbmpc.solver.line_search import take
from wbmpc.solver.memory_layout import (
    ALIGN,
    GRID,
    GRID_BASE,
    GRID_OLD,
    JUMPS,
    LX,
    MULTIPLIERS,
    NP,
    NU,
    NX,
    ROW_L,
    ROW_T,
    ROWS,
    SLOPES,
    STATE,
    UT,
    XT,
    K,
    N,
    P,
    RowField,
    Setting,
    StateField,
    U,
    X,
)
from wbmpc.solver.stages import integrate, row_count, row_index

LINEAR, POSE, HOLD, POSE_HOLD = range(len(Reference.KINDS))


class Tables(NamedTuple):
    """References and modes over absolute time in two flat arrays.

    ``integers``: counts of slots, events and mode values, the offset of the mode in a node's parameters; then per slot: first
    time, samples, first value, width, kind, offset. ``numbers``: events, modes (modes, values), times, values.
    """

    numbers: np.ndarray
    integers: np.ndarray


class TableAddresses:
    """Where the arrays of tables are: looked up once for the same tables, for that takes microseconds of every solve."""

    def __init__(self) -> None:
        self._found: tuple[Tables | None, tuple[int, int]] = (None, (0, 0))

    def of(self, tables: Tables) -> tuple[int, int]:
        """Addresses of numbers and integers."""
        if tables is not self._found[0]:
            self._found = (tables, (tables.numbers.ctypes.data, tables.integers.ctypes.data))
        return self._found[1]


def make_tables(problem: Transcription, references: Mapping[str, Reference], schedule: ModeSchedule) -> Tables:
    """Flat tables of all references (by term name) and of the mode schedule."""
    modes = mode_tables(problem, schedule)
    parts = [np.array(schedule.events, float), modes.ravel()]
    start = sum(p.size for p in parts)
    head = [0, len(schedule.events), modes.shape[1], problem.node.slices["mode"].start]
    slots = []
    for name in problem.references.slices:
        if name in references:
            r = references[name]
            width = r.values.shape[1]
            kind, target = Reference.KINDS.index(r.kind), problem.node.slices[f"reference.{name}"].start
            slots += [start, r.times.size, start + r.times.size, width, kind, target]
            parts += [r.times, r.values.ravel()]
            start += r.times.size * (1 + width)
            head[0] += 1
    return Tables(
        np.ascontiguousarray(np.concatenate([*parts, np.zeros(1)])), np.array([*head, *slots], dtype=np.int64)
    )


def overwrite(tables: Tables, slot: int, reference: Reference) -> None:
    """Put a reference of the same shape and kind over the one that is there."""
    times, count, values, width = tables.integers[4 + 6 * slot : 8 + 6 * slot]
    tables.numbers[times : times + count] = reference.times
    tables.numbers[values : values + count * width] = reference.values.ravel()


@compiled
def count_until(numbers: Floats, first: int, count: int, t: float) -> int:
    """How many of ``count`` sorted numbers from ``first`` on are at most ``t``."""
    low, high = 0, count
    while low < high:
        middle = (low + high) // 2
        if numbers[first + middle] <= t:
            low = middle + 1
        else:
            high = middle
    return low


@compiled
def between(numbers: Floats, a: int, width: int, fraction: float, m: Floats, out: int) -> None:
    """The row of ``width`` numbers from ``a`` on, and that ``fraction`` of what the row behind it has more: to ``out``."""
    b, whole = a + width, width // LANES * LANES
    if fraction == 0.0:
        for c in range(0, whole, LANES):
            m[out + c : out + c + LANES] = numbers[a + c : a + c + LANES]
        for c in range(whole, width):
            m[out + c] = numbers[a + c]
        return
    for c in range(0, whole, LANES):
        first = numbers[a + c : a + c + LANES]
        m[out + c : out + c + LANES] = first + fraction * (numbers[b + c : b + c + LANES] - first)
    for c in range(whole, width):
        m[out + c] = numbers[a + c] + fraction * (numbers[b + c] - numbers[a + c])


@compiled
def sample(numbers: Floats, integers: Integers, t: float, m: Floats, out: int) -> None:
    """References and mode values at time t into the parameter vector at offset ``out`` of ``m``."""
    for slot in range(integers[0]):
        s = 4 + 6 * slot
        times, n, values, width = integers[s], integers[s + 1], integers[s + 2], integers[s + 3]
        kind, target = integers[s + 4], out + integers[s + 5]
        hold = kind >= HOLD
        i = count_until(numbers, times, n, t + (1e-9 if hold else 0.0)) - 1
        fraction = 0.0
        if i < 0:
            i = 0
        elif i < n - 1 and not hold:
            fraction = (t - numbers[times + i]) / (numbers[times + i + 1] - numbers[times + i])
        between(numbers, values + i * width, width, fraction, m, target)
        if kind == POSE and fraction > 0.0:
            norm = 0.0
            for c in range(3, 7):
                norm += m[target + c] ** 2
            for c in range(3, 7):
                m[target + c] /= np.sqrt(norm)
    events, width = integers[1], integers[2]
    mode = count_until(numbers, 0, events, t + 1e-9)
    for c in range(width):
        m[out + integers[3] + c] = numbers[events + mode * width + c]


@compiled
def align(m: Floats, o: Integers, numbers: Floats, integers: Integers, t0: float) -> None:
    """The grid for a horizon that starts at ``t0``: the inner node nearest to an event moves onto it; where
    there are more events than inner nodes, the last ones wait until the horizon has moved on."""
    n, grid, events = o[N], o[GRID], integers[1]
    for k in range(n + 1):
        m[o[GRID_OLD] + k] = m[grid + k]
        m[grid + k] = m[o[GRID_BASE] + k]
    if o[ALIGN] == 0:
        return
    free, left = 1, 0
    for e in range(events):
        t = numbers[e] - t0
        if t > 1e-6 and t < m[grid + n] - 1e-6:
            left += 1
    for e in range(events):
        t = numbers[e] - t0
        if t <= 1e-6 or t >= m[grid + n] - 1e-6:
            continue
        left -= 1
        if free < n and m[grid + free - 1] < t - 1e-9:
            k, maximum = free, max(n - 1 - left, free)  # the events that follow need nodes too
            while k < maximum and abs(m[grid + k + 1] - t) < abs(m[grid + k] - t):
                k += 1
            m[grid + k] = t
            for later in range(k + 1, n):  # a second event may have come close
                if m[grid + later] <= m[grid + later - 1] + 1e-6:
                    m[grid + later] = 0.5 * (m[grid + later - 1] + m[grid + n])
            free = k + 1


def node_times(grid: np.ndarray, aligned: bool, tables: Tables, t0: float) -> np.ndarray:
    """Times (N + 1) [s] of the nodes of a horizon that starts at ``t0``, from its start; ``grid``: the problem's."""
    if not aligned:
        return grid
    size = len(grid)
    m, o = np.concatenate([grid, grid, grid]), np.zeros(max(N, GRID, GRID_BASE, GRID_OLD, ALIGN) + 1, np.int64)
    o[N], o[GRID], o[GRID_BASE], o[GRID_OLD], o[ALIGN] = size - 1, 0, size, 2 * size, 1
    align(m, o, tables.numbers, tables.integers, t0)
    return m[:size]


@compiled
def sample_all(m: Floats, o: Integers, numbers: Floats, integers: Integers, t0: float) -> None:
    """Parameters of all nodes for a horizon that starts at ``t0`` [s], and which intervals end with a jump."""
    for k in range(o[N] + 1):
        sample(numbers, integers, t0 + m[o[GRID] + k], m, o[P] + k * o[NP])
    if o[JUMPS] > 0:
        flags = row_index(o) + row_count(o)
        for k in range(o[N]):
            now = count_until(numbers, 0, integers[1], t0 + m[o[GRID] + k] + 1e-9)
            then = count_until(numbers, 0, integers[1], t0 + m[o[GRID] + k + 1] + 1e-9)
            o[flags + k] = 1 if now != then else 0


@compiled
def mode_at(numbers: Floats, integers: Integers, t: float) -> int:
    """Which mode of the schedule holds at time t [s]."""
    return count_until(numbers, 0, integers[1], t + 1e-9)


@compiled
def shift(m: Floats, o: Integers, numbers: Floats, integers: Integers, t0: float, delta: float) -> None:
    """Move the trajectories ``delta`` [s] forward in time to ``t0`` [s], from the old grid to the grid; the last values hold beyond it.

    Inputs of different modes are not mixed: what an equality of one fixes would keep a share of what it was in the other."""
    n, nx, nu, lx, new, g = o[N], o[NX], o[NU], o[LX], o[GRID], o[GRID_OLD]
    i = 0
    for k in range(n + 1):
        t = min(m[new + k] + delta, m[g + n])
        while i < n - 1 and m[g + i + 1] <= t:
            i += 1
        a = (t - m[g + i]) / (m[g + i + 1] - m[g + i])
        x = o[X] + i * nx
        for c in range(nx):
            m[o[XT] + k * nx + c] = (1.0 - a) * m[x + c] + a * m[x + nx + c]
        if k < n and i > k:  # the gains hold over intervals; backwards in time they stay
            to, source = o[K] + k * nu * lx, o[K] + i * nu * lx
            for c in range(0, nu * lx, LANES):  # rows of gains are padded
                m[to + c : to + c + LANES] = m[source + c : source + c + LANES]
    i = 0
    for k in range(n):
        # inputs are constant over an interval: interpolate between the intervals' middles
        t = 0.5 * (m[new + k] + m[new + k + 1]) + delta
        while i < n - 2 and 0.5 * (m[g + i + 1] + m[g + i + 2]) < t:
            i += 1
        a = 0.0
        if n > 1:
            low, high = 0.5 * (m[g + i] + m[g + i + 1]), 0.5 * (m[g + i + 1] + m[g + i + 2])
            a = min(max((t - low) / (high - low), 0.0), 1.0)
            mode = mode_at(numbers, integers, t0 - delta + m[g + i])
            if mode != mode_at(numbers, integers, t0 - delta + m[g + i + 1]):
                a = 0.0 if mode == mode_at(numbers, integers, t0 + m[new + k]) else 1.0
        after = nu if n > 1 else 0
        u = o[U] + i * nu
        for c in range(nu):
            m[o[UT] + k * nu + c] = (1.0 - a) * m[u + c] + a * m[u + after + c]
    take(m, o)


@compiled
def shift_multipliers(m: Floats, o: Integers, delta: float) -> None:
    """Move multipliers of the path as :func:`shift` does states: a limit that is active until some time stays so until then. Slacks follow
    from the iterate.

    Those of rows that follow the last command stay: the bound is as wide at a node as it was at that node, and multipliers of wider ones
    farther ahead would hardly resist. All stay after a pause of a whole horizon."""
    n, new, g, i = o[N], o[GRID], o[GRID_OLD], 0
    if delta >= m[g + n] - m[g]:
        return
    _, boxes, general = node_rows(o, 0)
    for k in range(n):
        t = min(m[new + k] + delta, m[g + n])
        while i < n - 1 and m[g + i + 1] <= t:
            i += 1
        if i >= k:  # backwards in time they stay
            a = (t - m[g + i]) / (m[g + i + 1] - m[g + i])
            inner = a > 0.0 and i < n - 1
            to, source, after = o[ROW_L] + k * o[ROWS], o[ROW_L] + i * o[ROWS], o[ROWS] if inner else 0
            for j in range(0, boxes + general, LANES):
                own, here, there = to + j, source + j, source + j + after
                moves = m[entry(o, RowField.MOVES, j) : entry(o, RowField.MOVES, j) + LANES] > 0.0
                moved = (1.0 - a) * m[here : here + LANES] + a * m[there : there + LANES]
                m[own : own + LANES] = np.where(moves, moved, m[own : own + LANES])


@compiled
def receding_solve(
    m: Floats,
    o: Integers,
    numbers: Floats,
    integers: Integers,
    t0: float,
    delta: float,
    x0: Floats,
    settings: Floats,
    log: Floats,
) -> tuple[int, int]:
    """Shift by ``delta``, sample at ``t0``, iterate: (status, steps done)."""
    align(m, o, numbers, integers, t0)
    if delta > 0.0:
        shift(m, o, numbers, integers, t0, delta)
        # contradictory limits show in multipliers that grow at their nodes
        if row_count(o) > 0 and o[MULTIPLIERS] == 0 and settings[Setting.KEEP_SLACKS] == 0.0:
            shift_multipliers(m, o, delta)
    m[o[STATE] + StateField.BLOCKED_TIME] += delta
    sample_all(m, o, numbers, integers, t0)
    return solve(m, o, x0, settings, log)


@compiled
def events_without_node(m: Floats, o: Integers, numbers: Floats, integers: Integers, t0: float) -> int:
    """See :func:`wbmpc.solver.events.events_without_node`."""
    n, events, base, count = o[N], integers[1], o[GRID_BASE], 0
    if o[ALIGN] == 0 and o[JUMPS] == 0:
        return 0
    last = -1
    for e in range(events):
        t = numbers[e] - t0
        if o[ALIGN] > 0:
            again = e > 0 and numbers[e] == numbers[max(e - 1, 0)]
            count += 1 if t > 1e-6 and t < m[base + n] - 1e-6 and not again else 0
            continue
        now = 0
        for k in range(n + 1):  # an event on a node belongs to the interval before
            now += 1 if t0 + m[base + k] + 1e-9 < numbers[e] else 0
        count += 1 if e > 0 and now == last and now > 0 and now <= n else 0
        last = now
    return max(count - (n - 1), 0) if o[ALIGN] > 0 else count


@compiled
def forget(m: Floats, o: Integers) -> None:
    """Discard slacks and multipliers: the next solve initializes them."""
    state = o[STATE]
    m[state + StateField.MAX_STEP], m[state + StateField.INFEASIBLE_SOLVES] = 0.0, 0.0
    m[state + StateField.BLOCKED_RESIDUAL], m[state + StateField.BLOCKED_TIME] = 0.0, 0.0
    m[state + StateField.CONVERGED], m[state + StateField.BARRIER] = 0.0, 0.0
    for i in range((o[N] + 1) * o[ROWS]):
        m[o[ROW_T] + i], m[o[ROW_L] + i] = 0.0, 0.0


@LIBRARY.step
def simulate(m: Floats, o: Integers, x: Floats, u: Floats, count: int, h: float) -> None:
    """``count`` Runge-Kutta steps of the state x, in place, each under the next nu numbers of u, with the parameters of node 0."""
    xt, ut, end = o[XT], o[UT], o[SLOPES] + 5 * o[LX]
    for k in range(count):
        for i in range(o[NX]):
            m[xt + i] = x[i]
        for i in range(o[NU]):
            m[ut + i] = u[k * o[NU] + i]
        integrate(m, o, xt, ut, o[P], h, end)
        for i in range(o[NX]):
            x[i] = m[end + i]
