"""Compiled code of a controller whose robot keeps its own parts apart: what :class:`wbmpc.mpc.clearance.ClearanceRows` and
:class:`wbmpc.mpc.mpc.MPC` do with rows of :class:`wbmpc.residuals.SelfClearance`, for exported code.

Functions take the controller's loop ``c``, and what it keeps for this, ``w``.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from wbmpc.clearance import compilation as nearest_points
from wbmpc.clearance.own_pairs import Compared, fill, measure
from wbmpc.clearance.plan_step import predict, stop_duration, stop_inputs
from wbmpc.kernel.ir import Floats, Integers
from wbmpc.kernel.library import Library
from wbmpc.mpc.clearance import AGAIN, BRAKING_SOLVES, CLEARER, DEEPER, ENDING, LATER, REACTION, TOLERATED
from wbmpc.solver import compilation, controller, feedback
from wbmpc.solver.controller import (
    Count,
    Loop,
    Value,
    admit,
    conclude,
    follow_last,
    put_trajectories,
    restart,
    start_from,
    stayed_finite,
)
from wbmpc.solver.feedback import Offsets, Plan
from wbmpc.solver.memory_layout import GRID, GRID_BASE, LX, NU, NX, K, N, Setting, U, X
from wbmpc.solver.receding import align, count_until, receding_solve, simulate
from wbmpc.solver.termination import EQUALITY_INFEASIBLE, INPUT_INFEASIBLE, ITERATION_LIMIT

LIBRARY = Library(
    "controller that keeps clear",
    packages=("solver", "kernel", "ocp", "clearance"),
    uses=(compilation.LIBRARY, feedback.LIBRARY, controller.LIBRARY, nearest_points.LIBRARY),
)
compiled = LIBRARY.step


class Guard(IntEnum):
    """Entries of the numbers that are kept from update to update."""

    STOPS_AT = 0  # when the stop ends [s] that the last plan is; infinite: it is none
    SEARCH_AT = 1  # when [s] another plan is sought; infinite: the last one is clear
    SEARCHES = 2  # how many have found none
    MEASURED = 3  # whether there are distances


class Keep(NamedTuple):
    """What pairs and stops need beside the loop."""

    own: Compared
    guard: Floats  # Guard
    own_states: Floats  # (n + 1, those of the robot), of which distances are known
    margins: Floats  # (rows) [m]
    of_a: Integers  # (rows), frames
    of_b: Integers  # (rows)
    above: Integers  # (rows)
    parameters: Floats  # (n + 1, rows, 10)
    work: Floats
    grids: Floats  # (3 (n + 1)) [s], first the nodes of the solve at hand
    grid_table: Integers  # where these are, as the solver's table says of its own
    ahead: Floats  # (n + 1, nx), the last plan at these nodes
    stop_x: Floats  # (n + 1, nx)
    stop_u: Floats  # (n, nu)
    kept_x: Floats  # (n + 1, nx), a plan to come back to
    kept_u: Floats  # (n, nu)
    active: Floats  # (nu), the input when the update begins
    state: Floats  # (nx), room
    rates: Floats  # see stop_duration
    sources: Integers
    state_of: Integers  # see stop_inputs
    barriers: Floats  # of solves from a stop
    tuned: Floats  # settings with these
    reach: float  # [m]
    limited: int  # how many rates
    slot: int  # of the rows' reference
    balances: int  # 1: a robot that falls when it stands


@compiled
def place_nodes(c: Loop, w: Keep, t: float) -> None:
    """The nodes of a solve at ``t``, as the solver will place them."""
    n1, grids = c.o[N] + 1, w.grids
    for k in range(n1):
        grids[k], grids[n1 + k] = c.m[c.o[GRID_BASE] + k], c.m[c.o[GRID_BASE] + k]
    align(grids, w.grid_table, c.numbers, c.integers, t)


@compiled
def look(c: Loop, w: Keep, x: Floats, at: int) -> None:
    """Measure all pairs at states (n + 1, nx) from ``x[at]`` on, unless they are those that were measured last."""
    n1, nx, own, states, same = c.o[N] + 1, c.o[NX], w.own.parts.nx, w.own_states, w.guard[Guard.MEASURED] > 0.0
    for k in range(n1):
        for i in range(own):
            value, to = x[at + k * nx + i], k * own + i
            same = same and value == states[to]
            states[to] = value
    if same:
        return
    measure(n1, w.reach, states, w.own, w.work)
    fill(n1, w.reach, w.margins, w.own, w.of_a, w.of_b, w.above, w.parameters)
    w.guard[Guard.MEASURED] = 1.0


@compiled
def danger(c: Loop, w: Keep, x: Floats, at: int, nodes: Floats, first: int, t: float, until: float) -> float:
    """How near [m] a pair comes much too near before ``until`` [s] in states (n + 1, nx) from ``x[at]`` on, at ``t`` and ``nodes`` from the
    ``first`` on, and nearer than at the first of them; infinite: none does."""
    look(c, w, x, at)
    count, rows, least, found = 0, w.own.parts.rows, np.inf, np.inf
    for k in range(c.o[N] + 1):
        count += 1 if t + nodes[first + k] <= until else 0
    for k in range(max(count, 2)):
        for r in range(rows):
            d, margin = w.own.gaps.distance[k * rows + r], w.margins[r]
            if d < (1.0 - TOLERATED) * margin and d < w.own.gaps.distance[r] - DEEPER and d - margin < least:
                least, found = d - margin, d
    return found


@compiled
def clearance(c: Loop, w: Keep) -> float:
    """The distance [m] of the pair of the iterate that lacks most of its margin."""
    look(c, w, c.m, c.o[X])
    least, found = np.inf, np.inf
    for k in range(c.o[N] + 1):
        for r in range(w.own.parts.rows):
            d = w.own.gaps.distance[k * w.own.parts.rows + r]
            if d - w.margins[r] < least:
                least, found = d - w.margins[r], d
    return found


@compiled
def refresh(c: Loop, w: Keep, t: float, delta: float) -> None:
    """Set all rows for a solve at ``t`` that goes on from a plan which is ``delta`` [s] old."""
    o, numbers, integers, n1, s = c.o, c.numbers, c.integers, c.o[N] + 1, 4 + 6 * w.slot
    place_nodes(c, w, t)
    predict(o[N], o[NX], c.m, o[GRID], c.m, o[X], w.grids, delta, w.ahead)
    look(c, w, w.ahead, 0)
    times, values, width = integers[s], integers[s + 2], integers[s + 3]
    integers[s + 1], integers[s + 4] = n1, 0
    for k in range(n1):
        numbers[times + k] = t + w.grids[k]
        for j in range(width):
            numbers[values + k * width + j] = w.parameters[k * width + j]


@compiled
def run(c: Loop, w: Keep, count: Integers, x: Floats, settings: Floats, t: float, delta: float, passes: int) -> None:
    """``passes`` solves at ``t``, the first one from a plan that is ``delta`` [s] old."""
    for k in range(passes):
        old = delta if k == 0 else 0.0
        refresh(c, w, t, old)
        status, done = receding_solve(c.m, c.o, c.numbers, c.integers, t, old, x, settings, c.log)
        count[Count.STATUS] = status
        count[Count.ITERATIONS] += done


@compiled
def run_from(c: Loop, w: Keep, count: Integers, x: Floats, states: Floats, inputs: Floats, t: float) -> None:
    """Solve from states (n + 1, nx) and inputs (n, nu) of ``t``, with slacks and multipliers that restart and a barrier that falls."""
    start_from(c.m, c.o, states, inputs, False)
    for k in range(BRAKING_SOLVES):
        for i in range(Setting.DETECT_STALL + 1):
            w.tuned[i] = c.settings[i]
        w.tuned[Setting.INITIAL_BARRIER] = max(w.tuned[Setting.INITIAL_BARRIER], w.barriers[k])
        w.tuned[Setting.MAX_BARRIER] = max(w.tuned[Setting.MAX_BARRIER], w.barriers[k])
        w.tuned[Setting.BARRIER] = max(w.tuned[Setting.BARRIER], w.barriers[k])
        w.tuned[Setting.MIN_BARRIER] = max(w.tuned[Setting.MIN_BARRIER], w.barriers[k])
        run(c, w, count, x, settings=w.tuned, t=t, delta=0.0, passes=1)


@compiled
def take_as_result(c: Loop, states: Floats, inputs: Floats) -> None:
    """States and inputs as the result of the last solve, without feedback."""
    put_trajectories(c.m, c.o, states, inputs, False)
    for i in range(c.o[N] * c.o[NU] * c.o[LX]):
        c.m[c.o[K] + i] = 0.0


@compiled
def usable(c: Loop, status: int) -> bool:
    """Whether the iterate of a solve with this status can be a plan."""
    return stayed_finite(c.m, c.o, status) and status != INPUT_INFEASIBLE and status != EQUALITY_INFEASIBLE


@compiled
def braking(c: Loop, w: Keep, x: Floats, t: float, delta: float) -> float:
    """How long [s] a stop from ``x`` takes under the input that the last plan, ``delta`` [s] old, has then. A stop that has begun does not
    take longer."""
    m, o = c.m, c.o
    k = min(count_until(m, o[GRID], o[N] + 1, delta + 1e-9) - 1, o[N] - 1)
    for j in range(o[NU]):
        w.active[j] = m[o[U] + k * o[NU] + j]
    duration = stop_duration(w.limited, w.rates, w.sources, x, w.active)
    if w.guard[Guard.STOPS_AT] < np.inf:
        duration = min(duration, max(w.guard[Guard.STOPS_AT] - t, ENDING))
    return duration


@compiled
def plan_stop(c: Loop, w: Keep, x: Floats, t: float, duration: float) -> None:
    """A stop from ``x`` under the input that :func:`braking` found, in ``stop_x`` and ``stop_u``."""
    n, nx, nu = c.o[N], c.o[NX], c.o[NU]
    place_nodes(c, w, t)
    stop_inputs(n, nu, w.grids, x, w.active, w.state_of, duration, w.stop_u)
    for i in range(nx):
        w.state[i], w.stop_x[i] = x[i], x[i]
    for k in range(n):
        for j in range(nu):
            w.active[j] = w.stop_u[k * nu + j]
        simulate(c.m, c.o, w.state, w.active, 1, w.grids[k + 1] - w.grids[k])
        for i in range(nx):
            w.stop_x[(k + 1) * nx + i] = w.state[i]


@compiled
def solve_clear(c: Loop, w: Keep, count: Integers, x: Floats, t: float, delta: float, passes: int) -> bool:
    """See :meth:`wbmpc.mpc.clearance.ClearanceRows.solve`: whether a stop is the result."""
    m, o = c.m, c.o
    if count[Count.STARTED] == 0 or w.balances > 0:
        w.guard[Guard.STOPS_AT], w.guard[Guard.SEARCH_AT] = np.inf, np.inf
        run(c, w, count, x, settings=c.settings, t=t, delta=delta, passes=passes)
        return False
    duration = braking(c, w, x, t, delta)
    until = t + duration + REACTION
    w.guard[Guard.STOPS_AT] = np.inf
    place_nodes(c, w, t)
    predict(o[N], o[NX], m, o[GRID], m, o[X], w.grids, delta, w.ahead)
    clear = danger(c, w, x=w.ahead, at=0, nodes=w.grids, first=0, t=t, until=until) == np.inf
    if clear:
        run(c, w, count, x, settings=c.settings, t=t, delta=delta, passes=1)
        clear = danger(c, w, x=m, at=o[X], nodes=m, first=o[GRID], t=t, until=until) == np.inf
    if clear:
        return False
    plan_stop(c, w, x, t, duration)
    run_from(c, w, count, x, w.stop_x, w.stop_u, t)
    found = danger(c, w, x=m, at=o[X], nodes=m, first=o[GRID], t=t, until=until)
    place_nodes(c, w, t)
    standing = danger(c, w, x=w.stop_x, at=0, nodes=w.grids, first=0, t=t, until=until)
    if (found == np.inf or (standing < np.inf and standing <= found)) and usable(c, count[Count.STATUS]):
        return False
    take_as_result(c, w.stop_x, w.stop_u)
    w.guard[Guard.STOPS_AT] = t + duration
    return True


@compiled
def search(c: Loop, w: Keep, count: Integers, x: Floats, t: float) -> None:
    """See :meth:`wbmpc.mpc.clearance.ClearanceRows.search_is_due` and ``search``."""
    m, o, guard = c.m, c.o, w.guard
    if w.balances > 0 or guard[Guard.STOPS_AT] < np.inf:
        guard[Guard.SEARCH_AT] = np.inf
        return
    before = danger(c, w, x=m, at=o[X], nodes=m, first=o[GRID], t=t, until=np.inf)
    if before == np.inf:
        guard[Guard.SEARCH_AT] = np.inf
        return
    if guard[Guard.SEARCH_AT] == np.inf:
        guard[Guard.SEARCH_AT], guard[Guard.SEARCHES] = t + LATER, 0.0
    if t < guard[Guard.SEARCH_AT] - 1e-9:
        return
    status = count[Count.STATUS]
    for i in range((o[N] + 1) * o[NX]):
        w.kept_x[i] = m[o[X] + i]
    for i in range(o[N] * o[NU]):
        w.kept_u[i] = m[o[U] + i]
    if int(guard[Guard.SEARCHES]) % 2 == 0:
        run_from(c, w, count, x, w.kept_x, w.kept_u, t)
    else:
        plan_stop(c, w, x, t, braking(c, w, x, t, 0.0))
        run_from(c, w, count, x, w.stop_x, w.stop_u, t)
    found = danger(c, w, x=m, at=o[X], nodes=m, first=o[GRID], t=t, until=np.inf)
    taken = (found == np.inf or found > before + CLEARER) and usable(c, count[Count.STATUS])
    guard[Guard.SEARCH_AT], guard[Guard.SEARCHES] = t + AGAIN, 0.0 if taken else guard[Guard.SEARCHES] + 1.0
    if not taken:
        take_as_result(c, w.kept_x, w.kept_u)
        count[Count.STATUS] = status


@compiled
def iterate(c: Loop, w: Keep, count: Integers, x: Floats, t: float, first: int, period: float) -> bool:
    """As :func:`wbmpc.solver.controller.iterate`."""
    delta = t - c.value[Value.START] if count[Count.STARTED] > 0 else 0.0
    if c.follow[0] > 0:
        follow_last(c.m, c.o, c.numbers, c.integers, c.follow, t, max(delta, period), delta)
    if solve_clear(c, w, count, x, t, delta, first):
        count[Count.STATUS] = ITERATION_LIMIT
        count[Count.BRAKING_PLANS] += 1
    else:
        search(c, w, count, x, t)
    return stayed_finite(c.m, c.o, count[Count.STATUS])


@compiled
def update(
    c: Loop,
    w: Keep,
    plan: Plan,
    offsets: Offsets,
    count: Integers,
    start: Floats,
    room: Floats,
    first: int,
    period: float,
    t: float,
    x: Floats,
) -> int:
    """As :func:`wbmpc.solver.controller.update`."""
    admitted = admit(c, count, start, t, x)
    if admitted < 0:
        return admitted
    started = count[Count.STARTED] > 0
    count[Count.ITERATIONS] = 0
    known = iterate(c, w, count, start, t, first, period)
    if not known and not started:
        restart(c, start, room)
        known = iterate(c, w, count, start, t, first, period)
    count[Count.STARTED], c.value[Value.START] = 1, t
    found = conclude(c, plan, offsets, count, start, room, t, started, known)
    if found == 0:
        c.value[Value.CLEARANCE] = clearance(c, w)
    return found
