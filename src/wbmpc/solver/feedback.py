"""Compiled code of a policy: the planned input with feedback, held within the hard rows of the inputs.

``limits`` is one array: lower and upper bounds (nu each), then of the r rows ``matrix`` u + offset ≥ 0 the matrix (r, nu), offsets (r,),
which inputs a row may scale back (r, nu; 1 or 0), the input of a row that depends on one alone (r,; −1: several). ``room``: 3 nu + r numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wbmpc.kernel.ir import Floats, Integers
from wbmpc.kernel.library import Library
from wbmpc.model.numeric import Reentrant
from wbmpc.solver.receding import LINEAR, POSE

LIBRARY = Library("policy", packages=("solver", "kernel", "ocp"))
compiled = LIBRARY.step
#: Share of a bound (or of 1, where that is more) beyond which an input counts as cut: the rest is rounding.
ROUNDING = 1e-9
#: Turns in which rows of several inputs are met beside the bounds of single ones.
TURNS = 100
#: An arc is at most this many times as long as its chord, up to half a circle (π / 2).
ARC = 1.6
#: What became of an input.
FINE, CUT, NOT_FINITE = 0, 1, -1


class Plan(NamedTuple):
    """The plan of a policy over n intervals, for nx states and nu inputs, and the r rows that hold its inputs."""

    times: Floats  # (n + 1) [s]
    states: Floats  # (n + 1, nx)
    inputs: Floats  # (n, nu)
    gains: Floats  # (n, nu, nx)
    limits: Floats  # see the module
    active: Floats  # (n, r), which rows count
    moving: Floats  # (n, 2, r), offsets at the beginning and end of an interval, where they move
    n: int
    nx: int
    nu: int
    r: int
    moves: int  # whether offsets move


class Offsets(NamedTuple):
    """What parameters add to the offsets of the r rows of a plan's limits."""

    rows: Floats  # by those of a node (r, by_node), then by those of the whole horizon (r, by_constant)
    switches: Integers  # (r), the node's parameter that turns each row on, or −1
    by_node: int
    by_constant: int


@compiled
def interval(times: Floats, n: int, t: float) -> int:
    """Which of the ``n`` intervals between ``times`` (n + 1) holds at time t; the first and the last one outside."""
    low, high = 0, n - 1
    while low < high:
        middle = (low + high + 1) // 2
        if times[middle] <= t + 1e-9:
            low = middle
        else:
            high = middle - 1
    return low


@compiled
def share(times: Floats, k: int, t: float) -> float:
    """How much of interval k has passed at time t, from 0 to 1."""
    return min(max((t - times[k]) / (times[k + 1] - times[k]), 0.0), 1.0)


@compiled
def planned_state(times: Floats, states: Floats, n: int, nx: int, t: float, x: Floats) -> None:
    """The planned state at time t: linear between the nodes."""
    k = interval(times, n, t)
    a = share(times, k, t)
    for i in range(nx):
        x[i] = (1.0 - a) * states[k * nx + i] + a * states[(k + 1) * nx + i]


@compiled
def law(plan: Plan, t: float, x: Floats, u: Floats) -> bool:
    """u = u_ff + K (x − x_ff) at time t; whether it is finite."""
    states, inputs, gains, nx, nu = plan.states, plan.inputs, plan.gains, plan.nx, plan.nu
    k = interval(plan.times, plan.n, t)
    a = share(plan.times, k, t)
    for j in range(nu):
        u[j] = inputs[k * nu + j]
    for i in range(nx):
        apart = x[i] - ((1.0 - a) * states[k * nx + i] + a * states[(k + 1) * nx + i])
        for j in range(nu):
            u[j] += gains[(k * nu + j) * nx + i] * apart
    finite = True
    for j in range(nu):
        finite = finite and np.isfinite(u[j])
    return finite


@compiled
def arrange(lower: Floats, upper: Floats, matrix: Floats, offset: Floats, r: int, nu: int, limits: Floats) -> None:
    """``limits`` of its parts. NumPy would let the interpreter go for the last two, and a tick makes limits of every new policy."""
    at, coupled, single = 2 * nu, 2 * nu + r * nu + r, 2 * nu + 2 * r * nu + r
    for i in range(nu):
        limits[i], limits[nu + i] = lower[i], upper[i]
    for row in range(r):
        limits[single + row], found = -1.0, 0
        for i in range(nu):
            limits[at + row * nu + i], limits[coupled + row * nu + i] = matrix[row * nu + i], 0.0
            if matrix[row * nu + i] != 0.0:
                limits[coupled + row * nu + i], limits[single + row], found = 1.0, float(i), found + 1
        if found != 1:
            limits[single + row] = -1.0
        limits[at + r * nu + row] = offset[row]
    wider = r > 1
    while wider:  # what a row shares with another one, it may scale back too
        wider = False
        for row in range(r):
            for other in range(r):
                shared, all_there = False, True
                for i in range(nu):
                    mine, its = limits[coupled + row * nu + i] > 0.0, limits[coupled + other * nu + i] > 0.0
                    shared = shared or (mine and its)
                    all_there = all_there and (mine or not its)
                if shared and not all_there:
                    wider = True
                    for i in range(nu):
                        if limits[coupled + other * nu + i] > 0.0:
                            limits[coupled + row * nu + i] = 1.0


@compiled
def row_bounds(limits: Floats, r: int, nu: int, active: Floats, k: int, room: Floats) -> None:
    """Bounds in ``room``: those that hold for good, and those of the rows of single inputs with the offsets behind them."""
    offset, single = 3 * nu, 2 * nu + 2 * r * nu + r
    for row in range(r):
        i = int(limits[single + row])
        if i < 0 or active[k * r + row] <= 0.0:
            continue
        slope = limits[2 * nu + row * nu + i]
        bound = -room[offset + row] / slope
        if slope > 0.0:
            room[i] = max(room[i], bound)
        else:
            room[nu + i] = min(room[nu + i], bound)


@compiled
def clip(u: Floats, nu: int, room: Floats) -> bool:
    """Cut inputs one by one to the bounds in ``room``; whether any was further outside than by rounding."""
    far = False
    for i in range(nu):
        out = max(u[i] - room[nu + i], room[i] - u[i])
        if out > 0.0:
            far = far or out > ROUNDING * max(abs(u[i]), 1.0)
            u[i] = min(max(u[i], room[i]), room[nu + i])
    return far


@compiled
def scale_back(
    u: Floats, inputs: Floats, limits: Floats, r: int, nu: int, active: Floats, k: int, room: Floats
) -> bool:
    """Feedback smaller where rows need it; whether any does. What the plan itself lacks of a row is not made worse."""
    matrix, coupled, offset, shares, found = 2 * nu, 2 * nu + r * nu + r, 3 * nu, 2 * nu, False
    for i in range(nu):
        room[shares + i] = 1.0
    for row in range(r):
        if active[k * r + row] <= 0.0:
            continue
        now, planned = room[offset + row], room[offset + row]
        for i in range(nu):
            now += limits[matrix + row * nu + i] * u[i]
            planned += limits[matrix + row * nu + i] * inputs[k * nu + i]
        if now >= -ROUNDING:
            continue
        found, planned = True, max(planned, 0.0)
        for i in range(nu):
            if limits[coupled + row * nu + i] > 0.0:
                room[shares + i] = min(room[shares + i], planned / (planned - now))
    for i in range(nu):
        if room[shares + i] < 1.0:
            u[i] = (u[i] - inputs[k * nu + i]) * room[shares + i] + inputs[k * nu + i]
    return found


@compiled
def meet(u: Floats, limits: Floats, r: int, nu: int, active: Floats, k: int, room: Floats) -> bool:
    """Rows of several inputs that a plan misses between its nodes, or by inputs that were cut, are met by inputs that may still go
    their way: each row by the least change, in turns (alternating projections), :data:`TURNS` at most. Returns whether there were any."""
    matrix, offset, single, found = 2 * nu, 3 * nu, 2 * nu + 2 * r * nu + r, False
    for _ in range(TURNS):
        missed = False
        for row in range(r):
            if active[k * r + row] <= 0.0 or limits[single + row] >= 0.0:
                continue
            lacks, slope = -room[offset + row], 0.0
            for i in range(nu):
                a = limits[matrix + row * nu + i]
                lacks -= a * u[i]
                if (a > 0.0 and u[i] < room[nu + i]) or (a < 0.0 and u[i] > room[i]):
                    slope += a * a
            if lacks <= ROUNDING or slope <= 0.0:
                continue
            missed, found = True, True
            for i in range(nu):
                a = limits[matrix + row * nu + i]
                if (a > 0.0 and u[i] < room[nu + i]) or (a < 0.0 and u[i] > room[i]):
                    u[i] = min(max(u[i] + lacks / slope * a, room[i]), room[nu + i])
        if not missed:
            break
    return found


@compiled
def within(
    u: Floats, inputs: Floats, k: int, limits: Floats, active: Floats, r: int, nu: int, moved: bool, feedback: bool,
    room: Floats,
) -> bool:  # fmt: skip
    """``u`` within the limits in interval k; whether it was cut. ``moved``: the rows' offsets are those in ``room``; ``feedback``:
    rows of several inputs scale back what it adds to the planned ``inputs``."""
    for i in range(2 * nu):
        room[i] = limits[i]
    if not moved:
        for row in range(r):
            room[3 * nu + row] = limits[2 * nu + r * nu + row]
    row_bounds(limits, r, nu, active, k, room)
    cut, scaled = clip(u, nu, room), False
    if feedback and scale_back(u, inputs, limits, r, nu, active, k, room):
        scaled = True
        cut = clip(u, nu, room) or cut  # a plan that is outside itself
    met = (cut or moved) and meet(u, limits, r, nu, active, k, room)
    return cut or scaled or met


@compiled
def hold(plan: Plan, feedback: bool, t: float, room: Floats, u: Floats) -> bool:
    """As :func:`within` at time t, with offsets that are linear in time over an interval where they move."""
    moving, nu, r = plan.moving, plan.nu, plan.r
    k = interval(plan.times, plan.n, t)
    if plan.moves > 0:
        a = share(plan.times, k, t)
        for row in range(r):
            room[3 * nu + row] = (1.0 - a) * moving[2 * k * r + row] + a * moving[(2 * k + 1) * r + row]
    return within(u, plan.inputs, k, plan.limits, plan.active, r, nu, plan.moves > 0, feedback, room)


@compiled
def evaluate(plan: Plan, limited: bool, t: float, x: Floats, room: Floats, u: Floats) -> int:
    """The input at time t in the state x: FINE, CUT to the limits where it is ``limited``, or NOT_FINITE."""
    if not law(plan, t, x, u):
        return NOT_FINITE
    if limited and hold(plan, True, t, room, u):
        return CUT
    return FINE


@compiled
def bulge(p: Floats, at: int, size: int, values: Floats, first: int, count: int, rows: Floats, row_at: int) -> float:
    """How far a row's offset may be from straight lines where a quaternion goes from one node's, in ``p``, over ``count`` samples of
    poses in ``values`` to the next one's: no further than the arcs on the way are long."""
    slopes, length = 0.0, 0.0
    for c in range(4):
        slopes += abs(rows[row_at + c])
    for i in range(count + 1):
        chord = 0.0
        for c in range(4):
            begin = p[at + c] if i == 0 else values[first + 7 * (i - 1) + c]
            end = p[at + size + c] if i == count else values[first + 7 * i + c]
            chord += (end - begin) ** 2
        length += np.sqrt(chord)
    return ARC * slopes * length


@compiled
def excess(
    p: Floats, at: int, size: int, begin: float, end: float, numbers: Floats, integers: Integers, rows: Floats, row_at: int
) -> float:  # fmt: skip
    """By how much a row's offset at an interval's nodes is too large somewhere in between, where references bend or jump.

    Reference by reference, at the samples from ``begin`` to ``end`` [s]: there is nothing larger between samples of straight lines.
    The quaternions of poses go along arcs beside these."""
    total = 0.0
    for slot in range(integers[0]):
        s = 4 + 6 * slot
        times, count, values, width, target = (
            integers[s],
            integers[s + 1],
            integers[s + 2],
            integers[s + 3],
            integers[s + 5],
        )
        matters, linear = False, integers[s + 4] == LINEAR or integers[s + 4] == POSE
        for c in range(width):
            matters = matters or rows[row_at + target + c] != 0.0
        if not matters:
            continue
        slack = 0.0 if linear else 1e-9  # as the nodes are sampled
        i, high, most = 0, count, 0.0
        while i < high:  # the first sample after the beginning
            middle = (i + high) // 2
            if numbers[times + middle] <= begin + slack:
                i = middle + 1
            else:
                high = middle
        first = i
        while i < count and numbers[times + i] <= end - slack:
            share_passed = (numbers[times + i] - begin) / (end - begin) if linear else 0.0
            over = 0.0
            for c in range(width):
                j = at + target + c
                line = p[j] + share_passed * (p[size + j] - p[j])
                over += rows[row_at + target + c] * (line - numbers[values + i * width + c])
            most = max(most, over)
            i += 1
        total += most
        if integers[s + 4] == POSE:
            total += bulge(
                p, at + target + 3, size, numbers, values + 7 * first + 3, i - first, rows, row_at + target + 3
            )
    return total


@compiled
def plan_rows(
    plan: Plan, offsets: Offsets, p: Floats, p_at: int, size: int, w: Floats, w_at: int, numbers: Floats, integers: Integers,
    room: Floats,
) -> None:  # fmt: skip
    """Of the rows of a plan's limits in each interval: which count, ``active``, and where they ``move`` their offsets at its beginning
    and end, ``moving``. ``p`` from ``p_at`` on: the nodes' parameters (n + 1, size); ``w`` from ``w_at`` on: those of the whole
    horizon; ``numbers``, ``integers``: references and modes. ``room``: by_node numbers.

    What is linear in time at the nodes goes on to the next one, all else holds over an interval; both less what would be too much
    somewhere in the interval (:func:`excess`)."""
    times, moving, n, r = plan.times, plan.moving, plan.n, plan.r
    rows, switches, by_node, by_constant = offsets.rows, offsets.switches, offsets.by_node, offsets.by_constant
    for k in range(n):
        for row in range(r):
            plan.active[k * r + row] = 1.0 if switches[row] < 0 else p[p_at + k * size + switches[row]]
    if plan.moves == 0:
        return
    for j in range(by_node):
        room[j] = 0.0
    for slot in range(integers[0]):
        s = 4 + 6 * slot
        if integers[s + 4] == LINEAR or integers[s + 4] == POSE:
            for j in range(integers[s + 3]):
                room[integers[s + 5] + j] = 1.0
    for row in range(r):
        fixed = plan.limits[(2 + r) * plan.nu + row]
        for j in range(by_constant):
            fixed += rows[r * by_node + row * by_constant + j] * w[w_at + j]
        for k in range(n):
            start, end, at = fixed, fixed, p_at + k * size
            for j in range(by_node):
                slope = rows[row * by_node + j]
                start += slope * p[at + j]
                end += slope * (p[at + size + j] if room[j] > 0.0 else p[at + j])
            over = excess(p, at, size, times[k], times[k + 1], numbers, integers, rows, row * by_node)
            moving[2 * k * r + row], moving[(2 * k + 1) * r + row] = start - over, end - over


#: Arguments of :func:`evaluate` as machine code: the plan's; then come ``limited``, t, x, room, u, and the result.
_OWN, _ARGUMENTS = len(Plan._fields), len(Plan._fields) + 5


class Evaluation:
    """A call of :func:`evaluate` with memory of its own."""

    def __init__(self) -> None:
        self._resize(0, 0, 0)

    def _resize(self, nx: int, nu: int, room: int) -> None:
        self._sizes = (nx, nu, room)
        self._policy: NDArray[np.int64] | None = None  # whose part of the table is there
        self._x, self._u, self._room = np.zeros(nx), np.zeros(nu), np.zeros(room)
        self._table = np.zeros(_ARGUMENTS + 1, np.int64)
        self._numbers, self._address = self._table.view(np.float64), self._table.ctypes.data
        self._table[_OWN + 2 : _ARGUMENTS] = [a.ctypes.data for a in (self._x, self._room, self._u)]

    def __call__(
        self, policy: NDArray[np.int64], sizes: tuple[int, int, int], limited: bool, t: float, x: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], int]:
        """(input (nu), what became of it) of a ``policy``: its part of the table of arguments; ``sizes``: (nx, nu, numbers of the room)."""
        if sizes != self._sizes:
            self._resize(*sizes)
        if policy is not self._policy:
            self._table[:_OWN], self._policy = policy, policy
        self._table[_OWN], self._numbers[_OWN + 1], self._x[:] = limited, t, x
        evaluate.by_table(self._address)
        return self._u.copy(), int(self._table[_ARGUMENTS])


#: For all policies, which several threads may share.
EVALUATION: Reentrant[
    [NDArray[np.int64], tuple[int, int, int], bool, float, NDArray[np.float64]], tuple[NDArray[np.float64], int]
] = Reentrant(Evaluation)
