"""Compiled code of a whole receding-horizon controller: what :class:`wbmpc.mpc.mpc.MPC` does with numbers, for exported code.

It works on the solver's memory, on tables of references and modes with room for as many samples as was decided when they were made,
and on arrays of its own: the active plan, ``count`` and ``value`` (:class:`Count`, :class:`Value`).
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from wbmpc.kernel.ir import Floats, Integers
from wbmpc.kernel.library import Library
from wbmpc.solver import compilation, feedback
from wbmpc.solver.feedback import CUT, Offsets, Plan, evaluate, hold, interval, plan_rows, planned_state
from wbmpc.solver.memory_layout import (
    GRID,
    LX,
    NP,
    NU,
    NX,
    STATE,
    K,
    N,
    P,
    Setting,
    StateField,
    U,
    W,
    X,
)
from wbmpc.solver.receding import count_until, events_without_node, forget, receding_solve
from wbmpc.solver.settings import THRESHOLDS
from wbmpc.solver.termination import DIVERGED, EQUALITY_INFEASIBLE, INPUT_INFEASIBLE, NOT_FINITE

LIBRARY = Library(
    "controller",
    packages=("solver", "kernel", "ocp"),
    modules=("wbmpc.solver.controller_data",),
    uses=(compilation.LIBRARY, feedback.LIBRARY),
)
compiled = LIBRARY.step

#: Rejected plans in a row from which on the next solve goes on from the rejected one. Rows that move fast reject up to three, and
#: then the plan before is where to start from; after more it is so old that the same rejection comes back.
STUCK = 4
#: Where the next solve starts: from its own iterate, from the last good plan, again from the observation.
GO_ON, RESUME, RESTART = 0, 1, 2


class Result(IntEnum):
    """What the functions of a controller return: 0 or 1, or why nothing was done."""

    OK = 0
    KEPT = 1  # no plan came of this update: the last one stays active
    WRONG_SIZE = -1
    NOT_ALIGNED = -2
    WRONG_PROCESSOR = -3
    NOT_A_NUMBER = -4  # a number that is not finite
    TIME_WENT_BACK = -5
    NO_PLAN = -6  # there has never been a plan
    NO_SUCH_INDEX = -7
    TOO_MANY = -8  # samples or events than there is room for; or none
    NOT_SORTED = -9
    NOT_A_ROTATION = -10  # a quaternion of length zero
    NOT_CREATED = -11  # the block is not one of this controller


class Count(IntEnum):
    """Entries of the integers that a controller keeps."""

    STARTED = 0  # whether there is a solve that the next one goes on from
    PLANNED = 1  # whether there is a plan
    STATUS = 2  # of the last solve
    ITERATIONS = 3  # of all solves of the last update
    BROKEN = 4  # updates in a row that ended with numbers that are not finite
    FAULTS = 5  # updates in a row without a plan
    UPDATES = 6
    FAILURES = 7  # updates without a plan
    CUT = 8  # how often a policy was cut to the limits
    EVENTS_WITHOUT_NODE = 9  # of the last update's horizon
    BRAKING_PLANS = 10  # plans that were replaced by one that stops
    EXTENDED = 11  # updates beside the first that took more than twice the iterations asked for


class Value(IntEnum):
    """Entries of the numbers that a controller keeps; all but the first are of the active plan."""

    START = 0  # of the last solve's horizon [s]
    COST = 1
    VIOLATION = 2
    LIMIT_VIOLATION = 3  # of planned states [ranges of their limits]
    INITIAL_STATE_MISMATCH = 4
    CLEARANCE = 5  # [m], of the pair that lacks most of its margin


@compiled
def recovery(status: int, broken: int, faults: int) -> int:
    """Where the next solve starts after an update without a plan: see :meth:`wbmpc.mpc.mpc.MPC.recover`. ``broken``, ``faults``:
    updates in a row that ended with numbers that are not finite, and without a plan."""
    if broken > 1:
        return RESTART
    if broken == 0 and (status == EQUALITY_INFEASIBLE or (status == INPUT_INFEASIBLE and faults >= STUCK)):
        return GO_ON
    return RESUME


@compiled
def finite(m: Floats, first: int, count: int) -> bool:
    """Whether ``count`` numbers from ``first`` on are finite."""
    found = True
    for i in range(count):
        found = found and np.isfinite(m[first + i])
    return found


@compiled
def put_trajectories(m: Floats, o: Integers, states: Floats, inputs: Floats, held: bool) -> None:
    """As :func:`start_from`, with slacks and multipliers as they are."""
    for k in range(o[N] + 1):
        for i in range(o[NX]):
            m[o[X] + k * o[NX] + i] = states[i if held else k * o[NX] + i]
    for k in range(o[N]):
        for i in range(o[NU]):
            m[o[U] + k * o[NU] + i] = inputs[i if held else k * o[NU] + i]


@compiled
def start_from(m: Floats, o: Integers, states: Floats, inputs: Floats, held: bool) -> None:
    """Trajectories (N + 1, nx) and (N, nu), or one state and one input that are ``held``, as where the next solve starts."""
    put_trajectories(m, o, states, inputs, held)
    forget(m, o)


@compiled
def reset(m: Floats, o: Integers, count: Integers, x: Floats, u: Floats) -> int:
    """Forget the last plan; start from a state and an input that are held."""
    if not (finite(x, 0, o[NX]) and finite(u, 0, o[NU])):
        return Result.NOT_A_NUMBER
    start_from(m, o, x, u, True)
    count[Count.STARTED], count[Count.PLANNED] = 0, 0
    return Result.OK


@compiled
def follow_last(m: Floats, o: Integers, numbers: Floats, integers: Integers, follow: Integers, t: float, since: float,
                delta: float) -> None:  # fmt: skip
    """The input that is active until ``t``, ``delta`` after the last plan's start, as the reference of the terms that limit its change.
    ``follow``: how many, then of each its slot, how many inputs, which. ``since`` [s]: when they were commanded."""
    k = min(max(count_until(m, o[GRID], o[N] + 1, delta - 1e-9) - 1, 0), o[N] - 1)
    at = 1
    for _ in range(follow[0]):
        s, width = 4 + 6 * follow[at], follow[at + 1]
        times, values = integers[s], integers[s + 2]
        integers[s + 1] = 2
        numbers[times], numbers[times + 1] = t, t + m[o[GRID] + o[N]]
        for j in range(width):
            u = m[o[U] + k * o[NU] + follow[at + 2 + j]]
            numbers[values + j], numbers[values + width + 1 + j] = u, u
        numbers[values + width], numbers[values + 2 * width + 1] = since, since + m[o[GRID] + o[N]]
        at += 2 + width


class Loop(NamedTuple):
    """What a controller has beside its plan: the solver's memory, tables and settings, and its own numbers."""

    m: Floats  # the solver's memory, see memory_layout
    o: Integers  # where what is in it, and sizes
    numbers: Floats  # samples of references and modes
    integers: Integers  # where these are
    settings: Floats  # of the solver
    log: Floats  # of its iterations
    follow: Integers  # see follow_last
    value: Floats  # Value


@compiled
def take_plan(c: Loop, plan: Plan, x: Floats, t: float) -> None:
    """The solver's iterate becomes the active plan from ``t`` on."""
    m, o, value = c.m, c.o, c.value
    times, states, inputs, gains = plan.times, plan.states, plan.inputs, plan.gains
    n, nx, nu = o[N], o[NX], o[NU]
    for k in range(n + 1):
        times[k] = t + m[o[GRID] + k]
    for i in range((n + 1) * nx):
        states[i] = m[o[X] + i]
    for i in range(n * nu):
        inputs[i] = m[o[U] + i]
        for j in range(nx):
            gains[i * nx + j] = m[o[K] + i * o[LX] + j]
    worst = 0.0
    for i in range(nx):
        worst = max(worst, abs(m[o[X] + i] - x[i]) / (1.0 + abs(x[i])))
    value[Value.INITIAL_STATE_MISMATCH] = worst if worst > THRESHOLDS.limit_tolerance else 0.0
    worst = max(m[o[STATE] + StateField.STATE_VIOLATION], m[o[STATE] + StateField.MIXED_VIOLATION])
    value[Value.LIMIT_VIOLATION] = worst if worst > THRESHOLDS.limit_tolerance else 0.0
    value[Value.COST], value[Value.VIOLATION] = m[o[STATE] + StateField.COST], m[o[STATE] + StateField.VIOLATION]


@compiled
def stayed_finite(m: Floats, o: Integers, status: int) -> bool:
    """Whether a solve that ended with this status has numbers that can be used."""
    n, nx, nu = o[N], o[NX], o[NU]
    known = finite(m, o[X], (n + 1) * nx) and finite(m, o[U], n * nu) and finite(m, o[K], n * nu * o[LX])
    return known and status != NOT_FINITE and status != DIVERGED


@compiled
def iterate(c: Loop, count: Integers, x: Floats, t: float, first: int, period: float) -> bool:
    """The solves of one update, for the first plan ``first`` of them; whether numbers stayed finite."""
    m, o, numbers, integers, value = c.m, c.o, c.numbers, c.integers, c.value
    started = count[Count.STARTED] > 0
    delta = t - value[Value.START] if started else 0.0
    if c.follow[0] > 0:
        follow_last(m, o, numbers, integers, c.follow, t, max(delta, period), delta)
    status = 0
    for k in range(1 if started else first):
        status, done = receding_solve(m, o, numbers, integers, t, delta if k == 0 else 0.0, x, c.settings, c.log)
        count[Count.ITERATIONS] += done
    count[Count.STATUS] = status
    return stayed_finite(m, o, status)


@compiled
def restart(c: Loop, x: Floats, room: Floats) -> None:
    """The next solve starts from the state held, without inputs."""
    for i in range(c.o[NU]):
        room[i] = 0.0
    start_from(c.m, c.o, x, room, True)


@compiled
def find_plan(c: Loop, count: Integers, x: Floats, room: Floats, t: float, first: int, period: float) -> bool:
    """As :func:`iterate`; a first plan once more from the state held, where what it started from led beyond all bounds."""
    count[Count.ITERATIONS] = 0
    known = iterate(c, count, x, t, first, period)
    if not known and count[Count.STARTED] == 0:
        restart(c, x, room)
        known = iterate(c, count, x, t, first, period)
    count[Count.STARTED], c.value[Value.START] = 1, t
    return known


@compiled
def fall_back(c: Loop, plan: Plan, count: Integers, x: Floats, room: Floats) -> int:
    """After an update without a plan: the last one stays active, and the next solve starts where :func:`recovery` says."""
    m, o = c.m, c.o
    count[Count.FAILURES] += 1
    if count[Count.PLANNED] == 0:
        if count[Count.BROKEN] > 0:
            restart(c, x, room)
            count[Count.STARTED] = 0
        return Result.NO_PLAN
    after = recovery(count[Count.STATUS], count[Count.BROKEN], count[Count.FAULTS])
    if after == RESTART:
        restart(c, x, room)
        count[Count.STARTED] = 0
    elif after == RESUME:
        start_from(m, o, plan.states, plan.inputs, False)
        c.value[Value.START] = plan.times[0]
    return Result.KEPT


@compiled
def admit(c: Loop, count: Integers, start: Floats, t: float, x: Floats) -> int:
    """Whether there can be an update from the state ``x`` at time ``t``: it is copied to ``start``."""
    if not (np.isfinite(t) and finite(x, 0, c.o[NX])):
        return Result.NOT_A_NUMBER
    if count[Count.STARTED] > 0 and t < c.value[Value.START]:
        return Result.TIME_WENT_BACK
    for i in range(c.o[NX]):
        start[i] = x[i]
    count[Count.UPDATES] += 1
    return Result.OK


@compiled
def conclude(
    c: Loop, plan: Plan, offsets: Offsets, count: Integers, start: Floats, room: Floats, t: float, started: bool, known: bool
) -> int:  # fmt: skip
    """What an update from ``start`` comes to after its solves; ``started``: they went on from others; ``known``: their numbers stayed
    finite."""
    m, o, status = c.m, c.o, count[Count.STATUS]
    count[Count.EXTENDED] += 1 if started and count[Count.ITERATIONS] > 2 * int(c.settings[Setting.ITERATIONS]) else 0
    count[Count.EVENTS_WITHOUT_NODE] = events_without_node(m, o, c.numbers, c.integers, t)
    count[Count.BROKEN] = 0 if known else count[Count.BROKEN] + 1
    usable = known and status != INPUT_INFEASIBLE and status != EQUALITY_INFEASIBLE
    count[Count.FAULTS] = 0 if usable else count[Count.FAULTS] + 1
    if not usable:
        return fall_back(c, plan, count, start, room)
    take_plan(c, plan, start, t)
    plan_rows(plan, offsets, m, o[P], o[NP], m, o[W], c.numbers, c.integers, room)
    count[Count.PLANNED] = 1
    return Result.OK


@compiled
def update(
    c: Loop,
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
    """A new plan from the state ``x`` at time ``t``."""
    admitted = admit(c, count, start, t, x)
    if admitted < 0:
        return admitted
    started = count[Count.STARTED] > 0
    known = find_plan(c, count, start, room, t, first, period)
    return conclude(c, plan, offsets, count, start, room, t, started, known)


@compiled
def policy(count: Integers, plan: Plan, room: Floats, t: float, x: Floats, u: Floats) -> int:
    """The input at time ``t`` in the state ``x``, with feedback, within the limits."""
    if count[Count.PLANNED] == 0:
        return Result.NO_PLAN
    if not (np.isfinite(t) and finite(x, 0, plan.nx)):
        return Result.NOT_A_NUMBER
    found = evaluate(plan, True, t, x, room, u)
    if found == CUT:
        count[Count.CUT] += 1
    return Result.NOT_A_NUMBER if found < 0 else Result.OK


@compiled
def planned(count: Integers, plan: Plan, room: Floats, t: float, x: Floats, u: Floats) -> int:
    """The planned state and input at time ``t``, the input within the limits."""
    if count[Count.PLANNED] == 0:
        return Result.NO_PLAN
    if not np.isfinite(t):
        return Result.NOT_A_NUMBER
    planned_state(plan.times, plan.states, plan.n, plan.nx, t, x)
    k = interval(plan.times, plan.n, t)
    for j in range(plan.nu):
        u[j] = plan.inputs[k * plan.nu + j]
    hold(plan, False, t, room, u)
    return Result.OK
