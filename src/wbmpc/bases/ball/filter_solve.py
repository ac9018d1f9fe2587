"""The ball filter's least squares, compiled: solved under the mildest explanation of the readings.

The arrays are in :class:`wbmpc.bases.ball.filter_step.Filter`.
"""

from __future__ import annotations

import numpy as np

from wbmpc.bases.ball.compilation import compiled, step
from wbmpc.bases.ball.filter_step import Filter, Noise, Row, State, advance, apply, linearize
from wbmpc.bases.ball.inertial_gate_step import FINE, JUMPS, UNKNOWN_PUSH, UNKNOWN_TURN, Gate, judge
from wbmpc.kernel.ir import Floats

#: Variance [rad²] of rows that count for nothing.
ANY = 1.0


@compiled
def cholesky(a: Floats, n: int) -> None:
    """The lower triangle of ``a`` (n, n) becomes its factor; not numbers where it has none."""
    for j in range(n):
        pivot = a[j * n + j]
        for k in range(j):
            pivot -= a[j * n + k] ** 2
        pivot = np.sqrt(pivot) if pivot > 0.0 else np.nan
        a[j * n + j] = pivot
        for i in range(j + 1, n):
            total = a[i * n + j]
            for k in range(j):
                total -= a[i * n + k] * a[j * n + k]
            a[i * n + j] = total / pivot


@compiled
def whiten(f: Filter) -> None:
    """``w`` (rows, size + 1): slopes by the newer state, and residuals, over the ``root`` of what noise and the older state's
    covariance ``p`` make of them."""
    p, jx, jy, q, r, moved, root, w = f.p, f.jx, f.jy, f.q, f.r, f.moved, f.root, f.w
    size, m = 16 + f.n, 17 + 2 * f.n
    c = size + 1
    for i in range(m):
        for j in range(size):
            moved[i * size + j] = 0.0
        for k in range(size):
            slope = jx[i * size + k]
            if slope != 0.0:
                for j in range(size):
                    moved[i * size + j] += slope * p[k * size + j]
        for j in range(i + 1):
            total = q[i * m + j]
            for k in range(size):
                total += moved[i * size + k] * jx[j * size + k]
            root[i * m + j] = total
    cholesky(root, m)
    for i in range(m):
        for j in range(size):
            w[i * c + j] = jy[i * size + j]
        w[i * c + size] = r[i]
        for k in range(i):
            share = root[i * m + k]
            for j in range(c):
                w[i * c + j] -= share * w[k * c + j]
        pivot = 1.0 / root[i * m + i]
        for j in range(c):
            w[i * c + j] *= pivot


@compiled
def invert(a: Floats, inverse: Floats, out: Floats, n: int) -> None:
    """``out`` (n, n) becomes the inverse of ``a``, of which the lower triangle counts and is lost, as ``inverse`` is."""
    cholesky(a, n)
    for i in range(n):
        for j in range(n):
            inverse[i * n + j], out[i * n + j] = 0.0, 0.0
        inverse[i * n + i] = 1.0
        for k in range(i):
            share = a[i * n + k]
            for j in range(k + 1):
                inverse[i * n + j] -= share * inverse[k * n + j]
        pivot = 1.0 / a[i * n + i]
        for j in range(i + 1):
            inverse[i * n + j] *= pivot
    for k in range(n):
        for i in range(k + 1):
            share = inverse[k * n + i]
            for j in range(i + 1):
                out[i * n + j] += share * inverse[k * n + j]
    for i in range(n):
        for j in range(i):
            out[j * n + i] = out[i * n + j]


@compiled
def solve(f: Filter) -> float:
    """``error`` (size) of the newer state and its ``covariance``, the older one, with covariance ``p``, being marginalised; returns
    the cost of the redundant rows, which is no number where there is no solution."""
    a, w, slope, error, covariance = f.a, f.w, f.slope, f.error, f.covariance
    size, m = 16 + f.n, 17 + 2 * f.n
    c = size + 1
    whiten(f)
    for i in range(size * size):
        a[i] = 0.0
    for i in range(size):
        slope[i] = 0.0
    for k in range(m):
        for i in range(size):
            share = w[k * c + i]
            for j in range(i + 1):
                a[i * size + j] += share * w[k * c + j]
            slope[i] += share * w[k * c + size]
    invert(a, f.inverse, covariance, size)
    for i in range(size):
        total = 0.0
        for j in range(size):
            total -= covariance[i * size + j] * slope[j]
        error[i] = total
    cost = 0.0
    for k in range(m):
        left = w[k * c + size]
        for i in range(size):
            left += w[k * c + i] * error[i]
        cost += left**2
    return cost


@step
def solve_robust(f: Filter, bound: float) -> tuple[int, float]:
    """The error and covariance of the newer state under the mildest explanation of the rows: which one, and the cost without one.

    0: nothing, 1: the ball spins on the floor, 2 + i: wheel i slips, 2 + n: the ball slips; −1: there is no solution. If none costs
    less than the ``bound`` the best one counts."""
    n, x, wheels, q, plain, spin, stalled = f.n, f.x, f.wheels, f.q, f.plain, f.spin, f.stalled
    size, m = 16 + n, 17 + 2 * n
    best, lowest, first = -1, np.inf, 0.0
    for i in range(n):
        t = 3 * i
        spin[i] = wheels[t] * x[State.ROTATION + 6] + wheels[t + 1] * x[State.ROTATION + 7]
        spin[i] += wheels[t + 2] * x[State.ROTATION + 8]
        for j in range(n):
            plain[i * n + j] = q[(Row.ROLLING + i) * m + Row.ROLLING + j]
        plain[i * n + i] += ANY * stalled[i]
    for choice in range(n + 3):
        if choice >= 2 and choice < 2 + n and stalled[choice - 2] > 0.0:
            continue
        for i in range(n):
            for j in range(n):
                more = ANY * spin[i] * spin[j] if choice == 1 else 0.0
                if i == j and (choice == 2 + i or choice == 2 + n):
                    more = ANY
                q[(Row.ROLLING + i) * m + Row.ROLLING + j] = plain[i * n + j] + more
        cost = solve(f)
        if choice == 0:
            first = cost
        if cost < lowest:
            best, lowest = choice, cost
            for i in range(size):
                f.best_error[i] = f.error[i]
            for i in range(size * size):
                f.best_covariance[i] = f.covariance[i]
        if lowest < bound:
            break
    return best, first


@compiled
def explain(
    f: Filter, message: Floats, fault: int, jumps: bool, turned: float, pushed: float, h: float, torque: float, bound: float
) -> tuple[int, float]:  # fmt: skip
    """The newer state ``z`` by the wheels and a ``message`` (6) of the inertial unit, :func:`~wbmpc.bases.ball.filter_step.linearize`,
    :func:`solve_robust` (what it returns) and :func:`~wbmpc.bases.ball.filter_step.apply`; the message is another one's, which says
    little, where the present one has a ``fault``. ``jumps``, ``turned``, ``pushed``: what is said of the present one."""
    gyro_more, accel_more = 0.0, 0.0
    if fault != FINE:
        gyro_more = (UNKNOWN_TURN * h) ** 2 - f.noise[Noise.GYRO] ** 2 * h
        accel_more = (UNKNOWN_PUSH * h) ** 2 - f.noise[Noise.ACCEL] ** 2 * h
    elif not jumps:
        # a mean says the less of a motion, the more it changes to the next; spikes are judged, not believed a little less
        share = (f.noise[Noise.CHANGE] * h) ** 2
        gyro_more, accel_more = share * turned, share * pushed
    for i in range(3):
        f.gyro[i], f.accel[i] = message[i], message[3 + i]
    linearize(f, h, torque, gyro_more, accel_more)
    choice, first = solve_robust(f, bound)
    if choice >= 0:
        apply(f)
    return choice, first


@step
def process(
    f: Filter, message: Floats, given: Floats, last: Floats, gate: Floats, h: float, torque: float, bound: float, still: float,
    largest_step: float,
) -> tuple[int, int, float]:  # fmt: skip
    """Take in the wheels and a ``message`` of the inertial unit, without it if it cannot be true: which explanation of
    :func:`solve_robust` counts, what is wrong with the message, and what the redundant rows cost.

    One that jumps while the wheels contradict it cannot be true, if the wheels agree with each other: a spike, not three wheels; what
    jumped and is still there needs no more to contradict it."""
    fault, jumps, turned, pushed = judge(message, given, last, gate, h)
    if fault != FINE:
        choice, first = explain(f, last, fault, jumps, turned, pushed, h, torque, bound)
    else:
        choice, first = explain(f, message, FINE, jumps, turned, pushed, h, torque, bound)
        if jumps and choice >= 0 and (choice > 0 or gate[Gate.JUMPED] > 0.0):
            choice, first = explain(f, last, JUMPS, jumps, turned, pushed, h, torque, bound)
            if choice == 0:
                fault = JUMPS
            elif choice > 0:
                choice, first = explain(f, message, FINE, jumps, turned, pushed, h, torque, bound)
    if choice >= 0:
        if fault == FINE:
            for i in range(6):
                last[i] = message[i]
            gate[Gate.COUNTED], gate[Gate.JUMPED] = 1.0, 0.0
        elif fault == JUMPS:
            gate[Gate.JUMPED] = 1.0
        advance(f, still, largest_step)
    return choice, fault, first
