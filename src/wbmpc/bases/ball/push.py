"""How fast a push moves a ball robot's lean: what a plan has to leave room for while the push lasts."""

from __future__ import annotations

import math
from collections.abc import Callable

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.bases.ball.balance import Balance, load_offset
from wbmpc.checks import not_negative, numbers, positive_time
from wbmpc.errors import NotFinite
from wbmpc.model.numeric import Numeric
from wbmpc.model.robot import RobotModel

Array = NDArray[np.float64]
#: Slower drifts [m/s] than this are not taken for a push: noise, friction, loads and a model that is a little wrong.
DEAD = 0.1
#: Time constant [s] of the mean that is taken: three messages of the sensors at 400 Hz.
SMOOTH = 0.010


class PushEstimator:
    """The drift (2) [m/s] of the lean's divergent component (:class:`wbmpc.bases.ball.balance.Balance`) that the model does not explain.

    A plan knows nothing of a push that goes on. Robots that are pushed lean against their motion, to brake, as far as they
    are allowed to; the push goes on to tilt them the same way, and the wheels come too late. ``room``: by how much a push that
    lasts for ``expected_push_time`` [s] more will move the component, to be kept free by the limit of the lean. Unlike the disturbance
    observer's force it is there within some 20 ms and gone as fast.
    ``arm`` (m) [rad]: angles for which the pole is taken. Needs :meth:`update` once for every new state.
    Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be.
    """

    def __init__(self, robot: RobotModel, arm: ArrayLike, expected_push_time: float) -> None:
        not_negative("push estimator", expected_push_time=expected_push_time)
        arm = numbers("push estimator", "arm", arm, len(robot.state.groups["arm"]))
        n, q = robot.base.nq, ca.SX.sym("q", robot.base.nq)
        offset = load_offset(robot.base, q, ca.SX.zeros(robot.parameters.size))
        pole = Balance.of(robot, arm).pole
        self._slope = Numeric(ca.Function("slope", [q], [ca.densify(ca.jacobian(offset, q)) / pole]))
        self._size, self._speeds, self.expected_push_time = robot.state.size, slice(n, 2 * n), expected_push_time
        self.reset()

    def reset(self) -> None:
        """Reset the estimate."""
        self.drift = np.zeros(2)
        self._previous: tuple[Array, Array] | None = None

    def update(self, x: Array, u: Array, h: float, step: Callable[[Array, Array, float], Array]) -> None:
        """Take in the state x (nx), ``h`` [s] after the one before, from which on the input u (nu) acts; ``step(x, u, h)``: the
        model's state (nx) after h seconds. Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be, and where
        the model has no answer; nothing is taken in then."""
        positive_time("push estimator", h)
        x, u = numbers("push estimator", "state", x, self._size), numbers("push estimator", "input", u, np.size(u))
        if self._previous is not None:
            unexplained = x[self._speeds] - step(*self._previous, h)[self._speeds]
            rate = self._slope(x[: self._speeds.start])[0] @ unexplained / h
            drift = self.drift + h / (h + SMOOTH) * (rate - self.drift)
            if not np.isfinite(drift).all():
                raise NotFinite("the drift of the lean is not finite")
            self.drift = drift
        self._previous = x.copy(), u.copy()

    @property
    def room(self) -> Array:
        """(2) [m], along the world's x and y."""
        size = max(math.hypot(*self.drift.tolist()), 1e-12)
        room: Array = max(0.0, 1.0 - DEAD / size) * self.expected_push_time * self.drift
        return room
