"""A tick of the tracking law and a period of the prediction, compiled: see :class:`wbmpc.bases.swerve.tracking.SwerveTracking`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.bases.swerve.compilation import compiled, step
from wbmpc.kernel.ir import Floats

#: Steering errors [rad] that stop a base on its way, and that end a stop. The last is no smaller: the plan's angles move on
#: meanwhile, and a base that waits for the rest falls behind its reference.
MISALIGNED, ALIGNED = 0.45, 0.1


class Law(NamedTuple):
    """The robot and the law: n modules, ``legs`` (0 or n) and m joints of the arm, whose entries begin at ``base``, ``leg``, ``steer``,
    ``wheel`` and ``arm`` of an input (nu), and at ``x_…`` of a state."""

    nu: int
    n: int
    legs: int
    m: int
    base: int
    leg: int
    steer: int
    wheel: int
    arm: int
    x_base: int
    x_leg: int
    x_steer: int
    x_wheel: int
    x_arm: int
    period: float  # [s]
    lag: float  # of the drives [s]
    blend: float  # share of the way to a command that drives go in a period
    late: float  # blend · lag / period
    gain: float  # of the steering servo [1/s]
    align_gain: float  # the least while wheels are aligned
    planned_steering: bool  # the plan's angles are those of the wheels
    low: Floats  # (n) [rad], limits of the steering
    high: Floats
    wheel_scale: Floats  # (n), the model's radius over each wheel's own
    actuator_upper: Floats  # (nu)
    input_upper: Floats  # (nu)
    input_rate: Floats  # (nu)
    brake: Floats  # (legs), 1 = open
    excess: Floats  # (nu), scratch


class Drives(NamedTuple):
    """What is commanded, and what drives make of it."""

    u: Floats  # (nu), the plan's input, then what plan and servo ask for
    planned: Floats  # (n) [rad], angles of the steering
    measured: Floats  # (n) [rad]
    error: Floats  # (n) [rad]
    sent: Floats  # (nu), what accelerations allow
    rates: Floats  # (nu), what drives make of it
    turning: Floats  # (n) [rad/s], the steering drives
    wheels: Floats  # (n) [rad/s], commands
    leg_rates: Floats  # (legs) [rad/s]
    sag: Floats  # (m) [rad/s], by what the arm's joints turn besides their commands
    command: Floats  # (m) [rad/s], of the arm
    rate: Floats  # (m) [rad/s], what its drives make of it now
    mean: Floats  # (m) [rad/s], and over the last period


class Prediction(NamedTuple):
    """A state that goes on with the plan."""

    x: Floats  # (nx)
    future: Floats  # (nu), the plan's input
    ahead: Floats  # (nu), the last command
    moved: Floats  # (nu), what drives make of it


@compiled
def hold_base(law: Law, u: Floats) -> None:
    """While wheels are aligned the base stands."""
    for i in range(3):
        u[law.base + i] = 0.0
    for i in range(law.legs):
        u[law.leg + i] = 0.0
    for i in range(law.n):
        u[law.wheel + i] = 0.0


@compiled
def own(law: Law, i: int) -> bool:
    """Whether input ``i`` is of the steering or of the arm."""
    return (i >= law.steer and i < law.steer + law.n) or (i >= law.arm and i < law.arm + law.m)


@compiled
def limit_acceleration(law: Law, sent: Floats, u: Floats) -> None:
    """``sent`` (nu) goes towards u (nu) as far as accelerations allow within a period. What rolls, base, legs and wheels, goes the same
    share of the way, which is as short as the worst of them needs; a closed brake stops its leg as hard as it likes. Joints of the arm
    go on their own, as plans count on: an arm that has to stop does not wait for wheels."""
    nu, leg, excess = law.nu, law.leg, law.excess
    together = 1.0
    for i in range(nu):
        over = abs(u[i] - sent[i]) / (law.input_rate[i] * law.period)
        if i >= leg and i < leg + law.legs and law.brake[i - leg] <= 0.5:
            over = 0.0
        excess[i] = max(over, 1.0)
        if not own(law, i):
            together = max(together, over)
    for i in range(nu):
        if not own(law, i):
            excess[i] = together
        sent[i] += (u[i] - sent[i]) / excess[i]


@compiled
def drive_arm(law: Law, d: Drives) -> None:
    """The arm's commands: without the sag, within limits of speed and acceleration."""
    sag, command, rate = d.sag, d.command, d.rate
    for i in range(law.m):
        limit, change = law.input_upper[law.arm + i], law.input_rate[law.arm + i] * law.period
        given = min(max(d.sent[law.arm + i] - sag[i], -limit), limit)
        given = command[i] + min(max(given - command[i], -change), change)
        behind = rate[i] - given
        command[i], d.mean[i], rate[i] = given, given + behind * law.late, given + behind * (1.0 - law.blend)


@step
def simulate_drives(law: Law, d: Drives) -> None:
    """What drives of first order make of ``sent`` within a period."""
    steer, rates, turning = law.steer, d.rates, d.turning
    for i in range(law.n):
        rates[steer + i] = turning[i]
    for i in range(law.nu):
        rates[i] += law.blend * (d.sent[i] - rates[i])
    for i in range(law.n):
        turning[i] = rates[steer + i]
        if law.planned_steering:
            rates[steer + i] = 0.0


@step
def track(law: Law, d: Drives, aligning: bool) -> tuple[bool, bool]:
    """From the plan's input ``u`` (nu) and angles ``planned`` (n), and the ``measured`` ones: ``u`` becomes what plan and servo ask for,
    ``sent`` what of it accelerations allow; ``wheels`` (n), ``leg_rates`` and the arm's ``command`` (m) [rad/s]. Returns whether
    wheels are aligned now, and whether they were too fast."""
    n, u, planned, error, sent, wheels = law.n, d.u, d.planned, d.error, d.sent, d.wheels
    off = 0.0
    for i in range(n):
        planned[i] = min(max(planned[i], law.low[i]), law.high[i])
        # what lagging drives still owe counts as done, or a wheel that turns fast would seem to be behind
        error[i] = planned[i] - d.measured[i] - law.lag * d.turning[i]
        if law.planned_steering:
            off = max(off, abs(error[i]))
    aligns = off > (ALIGNED if aligning else MISALIGNED)
    if aligns:
        hold_base(law, u)
    servo = max(law.gain, law.align_gain) if aligns else law.gain
    for i in range(n):
        largest = law.actuator_upper[law.steer + i]
        u[law.steer + i] = min(max(u[law.steer + i] + servo * error[i], -largest), largest)
    limit_acceleration(law, sent, u)
    simulate_drives(law, d)
    fast = 0.0
    for i in range(n):
        wheels[i] = sent[law.wheel + i] * law.wheel_scale[i]
        fast = max(fast, abs(wheels[i]) / law.input_upper[law.wheel + i])
    # too fast for one wheel: the whole motion is slowed down, or the wheels drag each other
    for i in range(n):
        wheels[i] = wheels[i] / max(1.0, fast)
    for i in range(law.legs):
        d.leg_rates[i] = sent[law.leg + i] * min(1.0, 1.0 / max(fast, 1e-12))
    drive_arm(law, d)
    return aligns, fast > 1.0


@compiled
def sinc(x: float) -> float:
    return np.sin(x) / x if x != 0.0 else 1.0


@step
def integrate(law: Law, p: Prediction, h: float) -> None:
    """Integrate the input rates ``moved`` over h [s] into the state x."""
    x, u, base, x_base = p.x, p.moved, law.base, law.x_base
    dx, dy, turn = u[base] * h, u[base + 1] * h, u[base + 2] * h
    s, half = sinc(turn), sinc(0.5 * turn)
    c = 0.5 * turn * half * half
    ahead, left = s * dx - c * dy, c * dx + s * dy
    cy, sy = np.cos(x[x_base + 2]), np.sin(x[x_base + 2])
    x[x_base] += cy * ahead - sy * left
    x[x_base + 1] += sy * ahead + cy * left
    x[x_base + 2] += turn
    for i in range(law.legs):
        x[law.x_leg + i] += u[law.leg + i] * (law.brake[i] * h)
    for i in range(law.n):
        x[law.x_steer + i] += u[law.steer + i] * h
        x[law.x_wheel + i] += u[law.wheel + i] * h
    for i in range(law.m):
        x[law.x_arm + i] += u[law.arm + i] * h


@step
def predict(law: Law, p: Prediction, aligning: bool) -> None:
    """The state x a period later under the plan's input ``future``; ``ahead``: the command before, which becomes this one. Planned
    angles go on with the plan, and the servo follows them."""
    if aligning:
        hold_base(law, p.future)
    limit_acceleration(law, p.ahead, p.future)
    for i in range(law.nu):
        p.moved[i] = p.ahead[i]
        if law.planned_steering and i >= law.steer and i < law.steer + law.n:
            p.moved[i] = p.future[i]
    integrate(law, p, law.period)


@step
def learn_sag(m: int, sag: Floats, mean: Floats, turned: Floats, share: float, largest: float, h: float) -> None:
    """The sag (m) [rad/s] from what joints ``turned`` (m) [rad] in h [s] and what drives should have made of their commands."""
    for i in range(m):
        sag[i] = min(max(sag[i] + share * (turned[i] / h - mean[i] - sag[i]), -largest), largest)
