"""A tick of the tracking law and a period of the prediction, compiled: see :class:`wbmpc.bases.swerve.tracking.SwerveTracking`.

nu inputs, of which base (3), legs (0 or n), steering (n), wheels (n) and arm (m) begin at ``base``, ``leg``, ``steer``, ``wheel``, ``arm``;
``x_…``: the same of a state.
"""

from __future__ import annotations

import numpy as np

from wbmpc.bases.swerve.compilation import compiled, step
from wbmpc.kernel.ir import Floats

#: Steering errors [rad] that stop a base on its way, and that end a stop. The last is no smaller: the plan's angles move on
#: meanwhile, and a base that waits for the rest falls behind its reference.
MISALIGNED, ALIGNED = 0.45, 0.1


@compiled
def hold_base(n: int, legs: int, base: int, leg: int, wheel: int, u: Floats) -> None:
    """While wheels are aligned the base stands."""
    for i in range(3):
        u[base + i] = 0.0
    for i in range(legs):
        u[leg + i] = 0.0
    for i in range(n):
        u[wheel + i] = 0.0


@compiled
def limit_acceleration(
    nu: int, n: int, legs: int, leg: int, steer: int, sent: Floats, u: Floats, brake: Floats, input_rate: Floats,
    excess: Floats, period: float,
) -> None:  # fmt: skip
    """``sent`` (nu) goes towards u (nu) as far as accelerations allow within a period. All but the steering go the same share of
    the way, which is as short as the worst of them needs; a closed brake stops its leg as hard as it likes."""
    together = 1.0
    for i in range(nu):
        over = abs(u[i] - sent[i]) / (input_rate[i] * period)
        if i >= leg and i < leg + legs and brake[i - leg] <= 0.5:
            over = 0.0
        excess[i] = max(over, 1.0)
        if i < steer or i >= steer + n:
            together = max(together, over)
    for i in range(nu):
        if i < steer or i >= steer + n:
            excess[i] = together
        sent[i] += (u[i] - sent[i]) / excess[i]


@compiled
def drive_arm(
    m: int, arm: int, sent: Floats, sag: Floats, command: Floats, rate: Floats, mean: Floats, input_upper: Floats,
    input_rate: Floats, period: float, blend: float, late: float,
) -> None:  # fmt: skip
    """The arm's commands: without the sag, within limits of speed and acceleration."""
    for i in range(m):
        limit, change = input_upper[arm + i], input_rate[arm + i] * period
        given = min(max(sent[arm + i] - sag[i], -limit), limit)
        given = command[i] + min(max(given - command[i], -change), change)
        behind = rate[i] - given
        command[i], mean[i], rate[i] = given, given + behind * late, given + behind * (1.0 - blend)


@step
def simulate_drives(
    nu: int, n: int, steer: int, sent: Floats, rates: Floats, turning: Floats, blend: float, planned_steering: bool
) -> None:
    """What drives of first order make of ``sent`` within a period."""
    for i in range(n):
        rates[steer + i] = turning[i]
    for i in range(nu):
        rates[i] += blend * (sent[i] - rates[i])
    for i in range(n):
        turning[i] = rates[steer + i]
        if planned_steering:
            rates[steer + i] = 0.0


@step
def track(
    nu: int, n: int, legs: int, m: int, base: int, leg: int, steer: int, wheel: int, arm: int, u: Floats, planned: Floats,
    measured: Floats, brake: Floats, low: Floats, high: Floats, error: Floats, turning: Floats, rates: Floats, sent: Floats,
    wheel_scale: Floats, actuator_upper: Floats, input_upper: Floats, input_rate: Floats, excess: Floats, wheels: Floats,
    leg_rates: Floats, sag: Floats, command: Floats, rate: Floats, mean: Floats, period: float, lag: float, blend: float,
    late: float, gain: float, align_gain: float, planned_steering: bool, aligning: bool,
) -> tuple[bool, bool]:  # fmt: skip
    """From the plan's input ``u`` (nu) and angles ``planned`` (n), and the ``measured`` ones: ``u`` becomes what plan and servo ask for,
    ``sent`` what of it accelerations allow; ``wheels`` (n), ``leg_rates`` and the arm's ``command`` (m) [rad/s]. Returns whether
    wheels are aligned now, and whether they were too fast."""
    off = 0.0
    for i in range(n):
        planned[i] = min(max(planned[i], low[i]), high[i])
        # what lagging drives still owe counts as done, or a wheel that turns fast would seem to be behind
        error[i] = planned[i] - measured[i] - lag * turning[i]
        if planned_steering:
            off = max(off, abs(error[i]))
    aligns = off > (ALIGNED if aligning else MISALIGNED)
    if aligns:
        hold_base(n, legs, base, leg, wheel, u)
    servo = max(gain, align_gain) if aligns else gain
    for i in range(n):
        largest = actuator_upper[steer + i]
        u[steer + i] = min(max(u[steer + i] + servo * error[i], -largest), largest)
    limit_acceleration(nu, n, legs, leg, steer, sent, u, brake, input_rate, excess, period)
    simulate_drives(nu, n, steer, sent, rates, turning, blend, planned_steering)
    fast = 0.0
    for i in range(n):
        wheels[i] = sent[wheel + i] * wheel_scale[i]
        fast = max(fast, abs(wheels[i]) / input_upper[wheel + i])
    # too fast for one wheel: the whole motion is slowed down, or the wheels drag each other
    for i in range(n):
        wheels[i] = wheels[i] / max(1.0, fast)
    for i in range(legs):
        leg_rates[i] = sent[leg + i] * min(1.0, 1.0 / max(fast, 1e-12))
    drive_arm(m, arm, sent, sag, command, rate, mean, input_upper, input_rate, period, blend, late)
    return aligns, fast > 1.0


@compiled
def sinc(x: float) -> float:
    return np.sin(x) / x if x != 0.0 else 1.0


@step
def integrate(
    n: int, legs: int, m: int, base: int, leg: int, steer: int, wheel: int, arm: int, x_base: int, x_leg: int, x_steer: int,
    x_wheel: int, x_arm: int, x: Floats, u: Floats, brake: Floats, h: float,
) -> None:  # fmt: skip
    """Integrate input rates u over h [s] into the state x."""
    dx, dy, turn = u[base] * h, u[base + 1] * h, u[base + 2] * h
    s, half = sinc(turn), sinc(0.5 * turn)
    c = 0.5 * turn * half * half
    ahead, left = s * dx - c * dy, c * dx + s * dy
    cy, sy = np.cos(x[x_base + 2]), np.sin(x[x_base + 2])
    x[x_base] += cy * ahead - sy * left
    x[x_base + 1] += sy * ahead + cy * left
    x[x_base + 2] += turn
    for i in range(legs):
        x[x_leg + i] += u[leg + i] * (brake[i] * h)
    for i in range(n):
        x[x_steer + i] += u[steer + i] * h
        x[x_wheel + i] += u[wheel + i] * h
    for i in range(m):
        x[x_arm + i] += u[arm + i] * h


@step
def predict(
    nu: int, n: int, legs: int, m: int, base: int, leg: int, steer: int, wheel: int, arm: int, x_base: int, x_leg: int,
    x_steer: int, x_wheel: int, x_arm: int, x: Floats, u: Floats, ahead: Floats, moved: Floats, brake: Floats,
    input_rate: Floats, excess: Floats, period: float, planned_steering: bool, aligning: bool,
) -> None:  # fmt: skip
    """The state x a period later under the plan's input ``u``; ``ahead`` (nu): the command before, which becomes this one. Planned
    angles go on with the plan, and the servo follows them."""
    if aligning:
        hold_base(n, legs, base, leg, wheel, u)
    limit_acceleration(nu, n, legs, leg, steer, ahead, u, brake, input_rate, excess, period)
    for i in range(nu):
        moved[i] = ahead[i]
        if planned_steering and i >= steer and i < steer + n:
            moved[i] = u[i]
    integrate(
        n=n, legs=legs, m=m, base=base, leg=leg, steer=steer, wheel=wheel, arm=arm, x_base=x_base, x_leg=x_leg,
        x_steer=x_steer, x_wheel=x_wheel, x_arm=x_arm, x=x, u=moved, brake=brake, h=period,
    )  # fmt: skip


@step
def learn_sag(m: int, sag: Floats, mean: Floats, turned: Floats, share: float, largest: float, h: float) -> None:
    """The sag (m) [rad/s] from what joints ``turned`` (m) [rad] in h [s] and what drives should have made of their commands."""
    for i in range(m):
        sag[i] = min(max(sag[i] + share * (turned[i] / h - mean[i] - sag[i]), -largest), largest)
