"""How fast a push moves a ball robot's lean: what a plan has to leave room for while the push lasts."""

from __future__ import annotations

import math
from collections.abc import Callable

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.bases.ball.balance import Balance, load_offset
from wbmpc.bases.ball.compilation import step
from wbmpc.bases.ball.model import ball_base
from wbmpc.checks import not_negative, numbers, positive_time
from wbmpc.errors import NotFinite
from wbmpc.kernel.function import CompiledFunction
from wbmpc.kernel.ir import Floats
from wbmpc.kernel.step import bind
from wbmpc.model.robot import RobotModel

#: Time constant [s] of the mean that is taken: three messages of the sensors at 400 Hz.
SMOOTH = 0.010


@step
def take_in(n: int, x: Floats, expected: Floats, slope: Floats, drift: Floats, found: Floats, h: float) -> bool:
    """``drift`` (2) [m/s] after a state ``x`` (2 n), h [s] after the one from which the model ``expected`` (2 n) another; ``slope`` (2, n):
    of the lean's divergent component by coordinates, over its pole. False, and nothing is changed, if it would not be finite;
    ``found``: room for it."""
    for k in range(2):
        rate = 0.0
        for i in range(n):
            rate += slope[k * n + i] * (x[n + i] - expected[n + i])
        found[k] = drift[k] + h / (h + SMOOTH) * (rate / h - drift[k])
    if not (np.isfinite(found[0]) and np.isfinite(found[1])):
        return False
    drift[0], drift[1] = found[0], found[1]
    return True


#: Slower drifts [m/s] than this are not taken for a push: noise, friction, loads and a model that is a little wrong.
DEAD = 0.1


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
        base = ball_base(robot)
        n, q = base.nq, ca.SX.sym("q", base.nq)
        offset = load_offset(base, q, ca.SX.zeros(robot.parameters.size))
        pole = Balance.of(robot, arm).pole
        # by rows
        slope = ca.Function("slope", [q], [ca.vec(ca.densify(ca.jacobian(offset, q)).T) / pole])
        self._slope = CompiledFunction(slope).evaluator(1)
        self._size, self._n, self.expected_push_time = robot.state.size, n, expected_push_time
        own = {"x": self._size, "expected": self._size, "slope": 2 * n, "drift": 2, "found": 2}
        self._arrays = {name: np.zeros(size) for name, size in own.items()}
        self._take_in = bind(take_in, self._arrays, n=n)
        self.reset()

    @property
    def drift(self) -> Array:
        """See the class."""
        return self._arrays["drift"].copy()

    def reset(self) -> None:
        """Reset the estimate."""
        self._arrays["drift"][:] = 0.0
        self._previous: tuple[Array, Array] | None = None

    def update(self, x: Array, u: Array, h: float, step: Callable[[Array, Array, float], Array]) -> None:
        """Take in the state x (nx), ``h`` [s] after the one before, from which on the input u (nu) acts; ``step(x, u, h)``: the
        model's state (nx) after h seconds. Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be, and where
        the model has no answer; nothing is taken in then."""
        positive_time("push estimator", h)
        x, u = numbers("push estimator", "state", x, self._size), numbers("push estimator", "input", u, np.size(u))
        if self._previous is not None:
            a = self._arrays
            a["x"][:], a["expected"][:] = x, step(*self._previous, h)
            self._slope.arguments[0] = x[: self._n]
            a["slope"][:] = self._slope(1)[0]
            if not self._take_in(h):
                raise NotFinite("the drift of the lean is not finite")
        self._previous = x.copy(), u.copy()

    @property
    def lean_margin(self) -> tuple[float, float]:
        """(2) [m], along the world's x and y."""
        x, y = self._arrays["drift"].tolist()
        share = max(0.0, 1.0 - DEAD / max(math.hypot(x, y), 1e-12)) * self.expected_push_time
        return share * x, share * y
