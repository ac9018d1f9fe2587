"""Forces that last: how far a ball robot may lean against those that it has learned, and which ones no lean can hold."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.bases.ball.balance import Balance
from wbmpc.bases.ball.compilation import step
from wbmpc.bases.ball.model import ball_base
from wbmpc.checks import not_negative, numbers, positive
from wbmpc.control.monitor import SimpleFault
from wbmpc.errors import DisturbanceTooLarge
from wbmpc.kernel.ir import Floats
from wbmpc.kernel.step import bind
from wbmpc.lie import cos_sin
from wbmpc.model.robot import RobotModel

#: Coordinates of ball and base, before those of the arm.
BASE = 5


class Lean(NamedTuple):
    """How a robot leans against forces (5) on ball and base; distances [m] of the lean's divergent component."""

    shift: Floats  # (2, 5), by how much it counts like more than it is, in the heading's axes
    whole: Floats  # (2, 5), what the wheels bear, in the heading's axes
    heading: Floats  # (5), room for a force
    leans: Floats  # (6): shift (2), along the world's axes; borne (2), along the heading's; component (2), along the world's


@step
def lean_offsets(lean: Lean, force: Floats, yaw: float) -> None:
    """``leans`` under a ``force`` (5, or more) in the world's axes at a heading ``yaw`` [rad]."""
    c, s, heading, leans = np.cos(yaw), np.sin(yaw), lean.heading, lean.leans
    for i in range(BASE):
        heading[i] = force[i]
    heading[0], heading[1] = c * force[0] + s * force[1], c * force[1] - s * force[0]
    for k in range(4):
        leans[k] = 0.0
    for i in range(BASE):
        for k in range(2):
            leans[k] += lean.shift[k * BASE + i] * heading[i]
            leans[2 + k] += lean.whole[k * BASE + i] * heading[i]
    x, y = leans[0], leans[1]
    leans[0], leans[1] = c * x - s * y, s * x + c * y


_LOG = logging.getLogger("wbmpc")
#: The share of the wheels' reach up to which a robot leans against a force that lasts: the rest is for balancing there. With all
#: of it, 60 N that held on felled one of three perturbed robots after 6 s.
MAXIMUM = 0.9
#: A force that lasts is strong if standing against it takes more than this share.
STRONG = 0.6
#: How long [s] a strong force has to drive the ball that fast: one of 100 N for 0.7 s does for 28 ms and is recovered from.
HELD = 0.3
#: A learned force that has fallen below this share of its largest does not last: a push is over, and the observer forgets it.
FADED = 0.9


class LeanControl:
    """The lean that a learned disturbance d̂ asks for, from the linear model of :class:`wbmpc.bases.ball.balance.Balance` (arm held).

    ``arm`` (m) [rad]: angles for which that is; ``share`` of the reach to which the problem limits the lean's divergent
    component; ``speed`` [m/s]: a ball that goes faster than this under a strong force that lasts ends the run.
    """

    def __init__(self, robot: RobotModel, arm: ArrayLike, share: float, speed: float) -> None:
        not_negative("lean_control", share=share)
        positive("lean_control", speed=speed)
        arm = numbers("lean_control", "arm", arm, len(robot.state.groups["arm"]))
        self.balance, self.speed = Balance.of(robot, arm), speed
        self.reach = float(self.balance.reach.min())
        whole = self.balance.shift + self.balance.stand
        #: everything by its name in :class:`wbmpc.bases.ball.lean_control.Lean`
        self.arrays = {
            "shift": self.balance.shift.ravel(),
            "whole": whole.ravel(),
            "heading": np.zeros(BASE),
            "leans": np.zeros(6),
        }
        self._room, self._force = max(MAXIMUM - share, 0.0) * self.reach, np.zeros(BASE)
        self._lean_offsets = bind(lean_offsets, self.arrays | {"force": self._force})
        self._ball_speed = slice(ball_base(robot).nq, ball_base(robot).nq + 2)
        self.reset()

    def reset(self) -> None:
        """Before another run."""
        self.push_fault: SimpleFault | None = None  # of a force that pushes the robot away
        self._pushed_since = self._driven_since = np.inf
        self._largest = 0.0

    def leans(self, force: Array, yaw: float) -> list[float]:
        """Under the learned generalized ``force`` (nq) [N, N m] at a heading [rad], [m]: shift (2), by how much the divergent component
        counts like more than it is, along the world's x and y; what the wheels bear (2), along the heading's."""
        self._force[:] = force[:BASE]
        self._lean_offsets(yaw)
        return self.arrays["leans"][:4].tolist()

    def center(self, leans: Sequence[float], yaw: float) -> tuple[float, float]:
        """The shift (2) for the limit of the lean, of ``leans``: about the lean with which the robot stands still, as far as the reach allows.

        What the wheels bear there, (shift + stand) d̂, takes from the reach; the limit moves with it up to :data:`MAXIMUM`.
        """
        x, y, bx, by = leans[:4]
        share, (c, s) = min(1.0, self._room / max(math.hypot(bx, by), 1e-12)), cos_sin(yaw)
        bx, by = share * bx, share * by
        return x - (c * bx - s * by), y - (s * bx + c * by)

    def check(self, t: float, force: Array, x: Array, leans: Sequence[float] | None = None) -> None:
        """Report once a learned ``force`` (nq) that pushes the robot away for :data:`HELD`, at state x (nx) and time t [s]: one that no
        lean can hold, or a strong one that drives the ball with half of ``speed``. Raises :class:`DisturbanceTooLarge` when it has
        driven it with all of it for as long. What is left of a push that is over counts as neither. ``leans``: under that force, where
        they are known.
        """
        borne = math.hypot(*(leans or self.leans(force, float(x[2])))[2:4]) / self.reach
        if borne <= STRONG:
            self._largest, self._driven_since, self._pushed_since = 0.0, np.inf, np.inf
            return
        vx, vy = x[self._ball_speed].tolist()
        # a ball that rolls back against the force is not driven by it
        self._largest = max(self._largest, borne)
        lasts = borne >= FADED * self._largest
        driven = math.hypot(vx, vy) / self.speed if lasts and vx * force[0] + vy * force[1] > 0.0 else 0.0
        self._driven_since = min(self._driven_since, t) if driven > 1.0 else np.inf
        self._pushed_since = min(self._pushed_since, t) if lasts and (borne > MAXIMUM or driven > 0.5) else np.inf
        fault = t - self._pushed_since >= HELD - 1e-9 and not self.push_fault
        if not fault and t - self._driven_since < HELD:
            return
        what = f"a force of at least {np.hypot(*force[:2]):.0f} N that lasts pushes the robot away"
        if fault:
            self.push_fault = SimpleFault(t, what)
            _LOG.warning("%s", self.push_fault)
        if t - self._driven_since >= HELD:
            raise DisturbanceTooLarge(
                f"{what}: the ball goes faster than {self.speed:g} m/s (max_pushed_speed); motors off"
            )
