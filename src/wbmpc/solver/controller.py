"""Compiled code of a whole receding-horizon controller: what :class:`wbmpc.mpc.mpc.MPC` does with numbers, for exported code.

It works on the solver's memory, on tables of references and modes with room for as many samples as was decided when they were made,
and on arrays of its own: the plan in force, ``count`` and ``value`` (:class:`Count`, :class:`Value`).
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from wbmpc.kernel.ir import Floats, Integers
from wbmpc.kernel.library import Library
from wbmpc.solver import compilation, feedback
from wbmpc.solver.driver import DIVERGED, EQUALITY_INFEASIBLE, INPUT_INFEASIBLE, NOT_FINITE
from wbmpc.solver.feedback import CUT, evaluate, hold, interval, plan_rows, planned_state
from wbmpc.solver.memory_layout import (
    GRID,
    LIMIT_TOLERANCE,
    LX,
    NU,
    NX,
    ROW_L,
    ROW_T,
    ROWS,
    STATE,
    K,
    N,
    StateField,
    U,
    W,
    X,
)
from wbmpc.solver.receding import POSE, POSE_HOLD, count_until, receding_solve

LIBRARY = Library("controller", rooms=("solver", "kernel", "ocp"), uses=(compilation.LIBRARY, feedback.LIBRARY))
compiled = LIBRARY.step

#: Rejected plans in a row from which on the next solve goes on from the rejected one. Rows that move fast reject up to three, and
#: then the plan before is where to start from; after more it is so old that the same rejection comes back.
STUCK = 4
#: Where the next solve starts: from its own iterate, from the last good plan, anew from the observation.
GO_ON, RESUME, RESTART = 0, 1, 2


class Result(IntEnum):
    """What the functions of a controller return: 0 or 1, or why nothing was done."""

    OK = 0
    KEPT = 1  # no plan came of this update: the last one stays in force
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


class Value(IntEnum):
    """Entries of the numbers that a controller keeps; all but the first are of the plan in force."""

    START = 0  # of the last solve's horizon [s]
    COST = 1
    VIOLATION = 2
    LIMIT_VIOLATION = 3  # of planned states [ranges of their limits]
    INITIAL_STATE_MISMATCH = 4


class Figure(IntEnum):
    """What a controller reports."""

    STATUS = 0  # of the last solve
    ITERATIONS = 1  # of the last update
    UPDATES = 2
    FAILURES = 3  # updates without a plan
    CUT = 4  # how often feedback was cut to the limits of the inputs
    COST = 5  # of the plan in force, here and below
    VIOLATION = 6  # of its constraints
    LIMIT_VIOLATION = 7  # of planned states' limits [their ranges]
    INITIAL_STATE_MISMATCH = 8  # how far it starts from the measured state
    BEGINNING = 9  # [s]
    END = 10  # [s]


@compiled
def figures(count: Integers, value: Floats, times: Floats, n: int, out: Floats) -> int:
    """Everything of :class:`Figure`."""
    out[Figure.STATUS], out[Figure.ITERATIONS] = count[Count.STATUS], count[Count.ITERATIONS]
    out[Figure.UPDATES], out[Figure.FAILURES] = count[Count.UPDATES], count[Count.FAILURES]
    out[Figure.CUT], out[Figure.COST] = count[Count.CUT], value[Value.COST]
    out[Figure.VIOLATION], out[Figure.LIMIT_VIOLATION] = value[Value.VIOLATION], value[Value.LIMIT_VIOLATION]
    out[Figure.INITIAL_STATE_MISMATCH] = value[Value.INITIAL_STATE_MISMATCH]
    out[Figure.BEGINNING], out[Figure.END] = times[0], times[n]
    return Result.OK


@compiled
def fill(block: Integers, size: int, runs: Integers, words: Integers, count: int) -> int:
    """A block of ``size`` words as it is in the beginning: zeros, and ``count`` runs (first, length) of ``words``."""
    for i in range(size):
        block[i] = 0
    at = 0
    for k in range(count):
        for i in range(runs[2 * k + 1]):
            block[runs[2 * k] + i] = words[at + i]
        at += runs[2 * k + 1]
    return Result.OK


@compiled
def forget(m: Floats, o: Integers) -> None:
    """Discard slacks and multipliers: the next solve initializes them."""
    state = o[STATE]
    m[state + StateField.MAX_STEP], m[state + StateField.INFEASIBLE_SOLVES] = 0.0, 0.0
    m[state + StateField.BLOCKED_RESIDUAL], m[state + StateField.BLOCKED_TIME] = 0.0, 0.0
    for i in range((o[N] + 1) * o[ROWS]):
        m[o[ROW_T] + i], m[o[ROW_L] + i] = 0.0, 0.0


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
    for i in range(count):
        if not np.isfinite(m[first + i]):
            return False
    return True


@compiled
def start_from(m: Floats, o: Integers, states: Floats, inputs: Floats, held: bool) -> None:
    """Trajectories (N + 1, nx) and (N, nu), or one state and one input that are ``held``, as where the next solve starts."""
    for k in range(o[N] + 1):
        for i in range(o[NX]):
            m[o[X] + k * o[NX] + i] = states[i if held else k * o[NX] + i]
    for k in range(o[N]):
        for i in range(o[NU]):
            m[o[U] + k * o[NU] + i] = inputs[i if held else k * o[NU] + i]
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
    """The input in force at ``t``, ``delta`` after the last plan's start, as the reference of the terms that limit its change.
    ``follow``: how many, then of each its slot, how many inputs, which. ``since`` [s]: when they were commanded."""
    k = min(count_until(m, o[GRID], o[N] + 1, delta + 1e-9) - 1, o[N] - 1)
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


@compiled
def take_plan(
    m: Floats, o: Integers, value: Floats, x: Floats, t: float, times: Floats, states: Floats, inputs: Floats, gains: Floats
) -> None:  # fmt: skip
    """The solver's iterate becomes the plan in force from ``t`` on."""
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
    value[Value.INITIAL_STATE_MISMATCH] = worst if worst > LIMIT_TOLERANCE else 0.0
    worst = max(m[o[STATE] + StateField.STATE_VIOLATION], m[o[STATE] + StateField.MIXED_VIOLATION])
    value[Value.LIMIT_VIOLATION] = worst if worst > LIMIT_TOLERANCE else 0.0
    value[Value.COST], value[Value.VIOLATION] = m[o[STATE] + StateField.COST], m[o[STATE] + StateField.VIOLATION]


@compiled
def iterate(
    m: Floats, o: Integers, numbers: Floats, integers: Integers, settings: Floats, log: Floats, follow: Integers,
    count: Integers, value: Floats, x: Floats, t: float, first: int, period: float,
) -> bool:  # fmt: skip
    """The solves of one update, for the first plan ``first`` of them; whether numbers stayed finite."""
    started = count[Count.STARTED] > 0
    delta = t - value[Value.START] if started else 0.0
    if follow[0] > 0:
        follow_last(m, o, numbers, integers, follow, t, max(delta, period), delta)
    status, total = 0, 0
    for k in range(1 if started else first):
        status, done = receding_solve(m, o, numbers, integers, t, delta if k == 0 else 0.0, x, settings, log)
        total += done
    count[Count.STATUS], count[Count.ITERATIONS], count[Count.STARTED], value[Value.START] = status, total, 1, t
    n, nx, nu = o[N], o[NX], o[NU]
    known = finite(m, o[X], (n + 1) * nx) and finite(m, o[U], n * nu) and finite(m, o[K], n * nu * o[LX])
    return known and status != NOT_FINITE and status != DIVERGED


@compiled
def fall_back(
    m: Floats, o: Integers, count: Integers, value: Floats, x: Floats, times: Floats, states: Floats, inputs: Floats,
    room: Floats,
) -> int:  # fmt: skip
    """After an update without a plan: the last one stays in force, and the next solve starts where :func:`recovery` says."""
    count[Count.FAILURES] += 1
    if count[Count.PLANNED] == 0:
        return Result.NO_PLAN
    after = recovery(count[Count.STATUS], count[Count.BROKEN], count[Count.FAULTS])
    if after == RESTART:
        for i in range(o[NU]):
            room[i] = 0.0
        start_from(m, o, x, room, True)
        count[Count.STARTED] = 0
    elif after == RESUME:
        start_from(m, o, states, inputs, False)
        value[Value.START] = times[0]
    return Result.KEPT


@compiled
def update(
    m: Floats, o: Integers, numbers: Floats, integers: Integers, settings: Floats, log: Floats, follow: Integers,
    count: Integers, value: Floats, start: Floats, times: Floats, states: Floats, inputs: Floats, gains: Floats,
    limits: Floats, rows: Floats, switches: Integers, active: Floats, moving: Floats, room: Floats, r: int, moves: int,
    by_node: int, by_constant: int, first: int, period: float, constants: int, t: float, x: Floats,
) -> int:  # fmt: skip
    """A new plan from the state ``x`` at time ``t``."""
    if not (np.isfinite(t) and finite(x, 0, o[NX])):
        return Result.NOT_A_NUMBER
    if count[Count.STARTED] > 0 and t < value[Value.START]:
        return Result.TIME_WENT_BACK
    for i in range(o[NX]):
        start[i] = x[i]
    count[Count.UPDATES] += 1
    known = iterate(m, o, numbers, integers, settings, log, follow, count, value, start, t, first, period)
    status = count[Count.STATUS]
    count[Count.BROKEN] = 0 if known else count[Count.BROKEN] + 1
    usable = known and status != INPUT_INFEASIBLE and status != EQUALITY_INFEASIBLE
    count[Count.FAULTS] = 0 if usable else count[Count.FAULTS] + 1
    if not usable:
        return fall_back(m, o, count, value, start, times, states, inputs, room)
    take_plan(m, o, value, start, t, times, states, inputs, gains)
    plan_rows(m, o, integers, limits, rows, switches, r, moves, by_node, by_constant, constants, room, active, moving)
    count[Count.PLANNED] = 1
    return Result.OK


@compiled
def policy(
    count: Integers, times: Floats, states: Floats, inputs: Floats, gains: Floats, limits: Floats, active: Floats,
    moving: Floats, room: Floats, n: int, nx: int, nu: int, r: int, moves: int, t: float, x: Floats, u: Floats,
) -> int:  # fmt: skip
    """The input at time ``t`` in the state ``x``, with feedback, within the limits."""
    if count[Count.PLANNED] == 0:
        return Result.NO_PLAN
    if not (np.isfinite(t) and finite(x, 0, nx)):
        return Result.NOT_A_NUMBER
    found = evaluate(times, states, inputs, gains, limits, active, moving, n, nx, nu, r, moves, True, t, x, room, u)
    if found == CUT:
        count[Count.CUT] += 1
    return Result.NOT_A_NUMBER if found < 0 else Result.OK


@compiled
def planned(
    count: Integers, times: Floats, states: Floats, inputs: Floats, limits: Floats, active: Floats, moving: Floats,
    room: Floats, n: int, nx: int, nu: int, r: int, moves: int, t: float, x: Floats, u: Floats,
) -> int:  # fmt: skip
    """The planned state and input at time ``t``, the input within the limits."""
    if count[Count.PLANNED] == 0:
        return Result.NO_PLAN
    if not np.isfinite(t):
        return Result.NOT_A_NUMBER
    planned_state(times, states, n, nx, t, x)
    k = interval(times, n, t)
    for j in range(nu):
        u[j] = inputs[k * nu + j]
    hold(times, inputs, limits, active, moving, n, nu, r, moves, False, t, room, u)
    return Result.OK


@compiled
def set_reference(
    numbers: Floats, integers: Integers, capacities: Integers, slots: int, slot: int, kind: int, samples: int, t: Floats,
    v: Floats,
) -> int:  # fmt: skip
    """``samples`` of the reference in a slot. Quaternions get unit length, neighbours in the same half sphere."""
    if slot < 0 or slot >= slots or kind < 0 or kind > POSE_HOLD:
        return Result.NO_SUCH_INDEX
    s = 4 + 6 * slot
    times, values, width = integers[s], integers[s + 2], integers[s + 3]
    pose = kind == POSE or kind == POSE_HOLD
    if pose and width != 7:
        return Result.NO_SUCH_INDEX
    if samples < 1 or samples > capacities[slot]:
        return Result.TOO_MANY
    if not (finite(t, 0, samples) and finite(v, 0, samples * width)):
        return Result.NOT_A_NUMBER
    for i in range(samples - 1):
        if t[i + 1] < t[i]:
            return Result.NOT_SORTED
    if pose and not rotations(v, samples):
        return Result.NOT_A_ROTATION
    integers[s + 1], integers[s + 4] = samples, kind
    for i in range(samples):
        numbers[times + i] = t[i]
        for j in range(width):
            numbers[values + i * width + j] = v[i * width + j]
    if pose:
        align_quaternions(numbers, values, samples)
    return Result.OK


@compiled
def rotations(v: Floats, samples: int) -> bool:
    """Whether no quaternion of the poses has the length zero."""
    for i in range(samples):
        if v[7 * i + 3] ** 2 + v[7 * i + 4] ** 2 + v[7 * i + 5] ** 2 + v[7 * i + 6] ** 2 < 1e-12:
            return False
    return True


@compiled
def align_quaternions(numbers: Floats, values: int, samples: int) -> None:
    """Unit length, and neighbours in the same half sphere (q and −q are the same rotation)."""
    for i in range(samples):
        q, product = values + 7 * i + 3, 0.0
        norm = np.sqrt(numbers[q] ** 2 + numbers[q + 1] ** 2 + numbers[q + 2] ** 2 + numbers[q + 3] ** 2)
        for j in range(4):
            numbers[q + j] /= norm
            if i > 0:
                product += numbers[q + j] * numbers[q - 7 + j]
        if product < 0.0:
            for j in range(4):
                numbers[q + j] = -numbers[q + j]


@compiled
def set_schedule(
    numbers: Floats, integers: Integers, modes: Floats, known_modes: int, max_events: int, events: int, t: Floats, mode: Integers
) -> int:  # fmt: skip
    """``events`` times, and the modes before, between and after them, by their places in the table ``modes``."""
    width = integers[2]
    if events < 0 or events > max_events:
        return Result.TOO_MANY
    if not finite(t, 0, events):
        return Result.NOT_A_NUMBER
    for i in range(events - 1):
        if t[i + 1] <= t[i]:
            return Result.NOT_SORTED
    for i in range(events + 1):
        if mode[i] < 0 or mode[i] >= known_modes:
            return Result.NO_SUCH_INDEX
    integers[1] = events
    for i in range(events):
        numbers[i] = t[i]
    for i in range(events + 1):
        for j in range(width):
            numbers[events + i * width + j] = modes[mode[i] * width + j]
    return Result.OK


@compiled
def set_constants(m: Floats, o: Integers, groups: Integers, known_groups: int, group: int, v: Floats) -> int:
    """One group of the numbers that are constant over the horizon: the model's parameters, or the weights of a cost.
    ``groups``: first and length of each."""
    if group < 0 or group >= known_groups:
        return Result.NO_SUCH_INDEX
    first, length = o[W] + groups[2 * group], groups[2 * group + 1]
    if not finite(v, 0, length):
        return Result.NOT_A_NUMBER
    for i in range(length):
        m[first + i] = v[i]
    return Result.OK
