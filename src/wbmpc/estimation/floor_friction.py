"""How much friction there is between wheels and floor, from slips.

The floor gives a robot of mass m the acceleration a and the yaw acceleration α only by friction, at wheels r from its middle:
m a ≤ Σ |tᵢ| ≤ μ m g and I α ≤ r Σ |tᵢ| (Coulomb). With both at once some wheels bear √(a² + (I α / m r)²) / g of their loads, or more, and
while they slide it comes near to μ. So what is felt at its most in a slip is the coefficient. Of the robot it is the base whose motion is
felt; what the arm does beside it is neglected.
"""

from __future__ import annotations

import math

import numpy as np

from wbmpc.arrays import Array
from wbmpc.checks import finite, not_negative, numbers, positive, positive_time
from wbmpc.constants import GRAVITY
from wbmpc.model.robot import RobotModel
from wbmpc.stability import StanceOf

_WHO = "floor friction"
#: Time [s] over which accelerations are averaged; speed [m/s] of a wheel against the base's at which it slides; for how long [s] it has to
#: before that counts, and to roll before a slip is over.
MEAN_TIME, SLIDES, SLIDES_FOR, OVER_AFTER = 0.05, 0.1, 0.02, 0.1
#: Time [s] in which the most that was felt is forgotten, of which a slip begins.
PEAK_TIME = 0.2
#: Of what is felt in a slip this share is planned with; least coefficient; time [s] after a slip in which a share 1 - 1/e of
#: what was believed before comes back, for floors differ.
KEPT, LEAST, FORGETS = 0.7, 0.05, 30.0


class FloorFriction:
    """A coefficient of friction for plans. ``bound``: ``believed`` until wheels slide; then what the floor has given at its most in a slip,
    less as much as an estimate may be off. ``turning`` [m]: I / (m r), see :func:`turning`. ``slips``: how often wheels have slid. Raises
    :class:`InputError` for a coefficient that is not positive."""

    def __init__(self, believed: float, turning: float = 0.0) -> None:
        positive(_WHO, believed=believed)
        not_negative(_WHO, turning=turning)
        self._turning = float(turning)
        self.believed = self.bound = float(believed)
        self.slips = 0
        self._felt, self._change = np.zeros(2), 0.0  # acceleration [m/s²] and yaw acceleration [rad/s²], averaged
        self._rate: float | None = None  # the last yaw rate [rad/s]
        self._sliding = self._rolling = 0.0  # for how long [s]
        self._peak = 0.0
        self._most: float | None = None  # coefficient in the present slip
        self._before = self.bound  # what was believed before it

    def update(self, h: float, accel: Array, yaw_rate: float, slip: float) -> bool:
        """Whether wheels slide, after another ``h`` [s] with the inertial unit's ``accel`` (3) [m/s²] in axes of the base, its ``yaw_rate``
        [rad/s], and the fastest wheel's ``slip`` [m/s] against the base.

        Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be; nothing is taken in then."""
        positive_time(_WHO, h)
        finite(_WHO, slip=slip, yaw_rate=yaw_rate)
        not_negative(_WHO, slip=slip)
        felt = numbers(_WHO, "accel", accel, 3)[:2]
        new, last = 1.0 - math.exp(-h / MEAN_TIME), yaw_rate if self._rate is None else self._rate
        self._felt += new * (felt - self._felt)
        self._change += new * ((yaw_rate - last) / h - self._change)
        self._rate = float(yaw_rate)
        ratio = math.hypot(*self._felt.tolist(), self._turning * self._change) / GRAVITY
        self._peak = max(ratio, self._peak * math.exp(-h / PEAK_TIME))
        self._sliding = self._sliding + h if slip > SLIDES else 0.0
        self._rolling = 0.0 if slip > SLIDES else self._rolling + h
        if self._most is None and self._sliding >= SLIDES_FOR:
            self._most, self._before, self.slips = self._peak, self.bound, self.slips + 1
        elif self._rolling >= OVER_AFTER:
            self._most = None
        if self._most is None:
            self.bound += (1.0 - math.exp(-h / FORGETS)) * (self.believed - self.bound)
            self.bound = max(self.bound, min(KEPT * ratio, self.believed))
            return False
        self._most = max(self._most, ratio)
        self.bound = max(min(self._before, KEPT * self._most), LEAST)
        return True


def turning(robot: RobotModel, payload: float = 0.0) -> float:
    """I / (m r) [m] of a robot at home with a mass ``payload`` [kg] at its end effector: its moment of inertia about the vertical through its
    base over its mass and the mean distance of its feet. Times its yaw acceleration it is the acceleration that they have to give. Raises
    :class:`InputError` for a base that does not stand on feet of its own."""
    stance, about = StanceOf(robot), np.zeros(robot.input.size)
    about[robot.input["base"].start + 2] = 1.0
    still, turned = (stance(robot.home, u=np.zeros(robot.input.size), u_rate=rate) for rate in (0.0 * about, about))
    distance = float(np.linalg.norm(still.feet, axis=1).mean())
    reach = float(np.sum(robot.pose(robot.home)[0][:2] ** 2))
    inertia = abs(float(turned.moment[2] - still.moment[2])) + payload * reach
    return inertia / ((still.mass + payload) * distance)
