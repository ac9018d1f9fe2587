"""The force at an end effector without a force sensor: a momentum observer (De Luca and Mattone, ICRA 2003).

With p = M(q) v and ṗ = τ_known + τ_unknown + Ṁ v − h, where h = C v + g, the residual r' = K (ṗ − known part − r) follows the
unknown generalized forces with bandwidth K. What it holds before the touch is the model's error; the change since then is
explained as a force on the end effector by least squares, weighted by how well each coordinate's force is known.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.bases.ball.model import ball_base
from wbmpc.checks import numbers, positive, positive_time
from wbmpc.errors import InputError
from wbmpc.model.numeric import Numeric
from wbmpc.model.robot import RobotModel

#: How well the generalized forces of ball (x, y), base (yaw, pitch, roll) and arm joints are known [N, N m].
SPREAD = (2.0, 2.0, 1.0, 1.5, 1.5, 0.1)


class MomentumObserver:
    """``mass(q)``: M (n, n); ``bias(q, v)``: C v + g (n); ``bandwidth`` [1/s]. ``residual`` (n): generalized forces that the
    drives do not explain [N, N m]."""

    def __init__(
        self, mass: Callable[[Array], Array], bias: Callable[[Array, Array], Array], bandwidth: float = 30.0
    ) -> None:
        positive("momentum observer", bandwidth=bandwidth)
        self.mass, self.bias, self.bandwidth = mass, bias, bandwidth
        self.residual = np.zeros(0)
        self._previous: tuple[Array, Array] | None = None
        self._zero: Array | None = None

    def update(self, q: ArrayLike, v: ArrayLike, force: ArrayLike, interval: float) -> Array:
        """The residual (n) at positions q (n) and speeds v (n), with the known generalized ``force`` (n) that acted over the
        ``interval`` [s] before. Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be."""
        positive_time("momentum observer", interval)
        n = np.size(v)
        q, v, force = (numbers("momentum observer", name, a, n) for name, a in (("q", q), ("v", v), ("force", force)))
        mass = self.mass(q)
        if self._previous is None:
            self.residual = np.zeros(v.size)
        else:
            last_mass, last_v = self._previous
            middle = 0.5 * (v + last_v)
            # M v − M⁻ v⁻ = M̄ Δv + ΔM v̄: the second part is Ṁ v, which is no force
            pushed = 0.5 * (mass + last_mass) @ (v - last_v) / interval
            unknown = pushed - force + self.bias(q, middle)
            self.residual = self.residual + self.share(interval) * (unknown - self.residual)
        self._previous = (mass, v)
        return self.residual

    def share(self, interval: float) -> float:
        """Which share of a change of the force the residual follows within an ``interval`` [s]."""
        return float(1.0 - np.exp(-self.bandwidth * interval))

    def zero(self) -> None:
        """Take the present residual for the model's error: nothing touches now. Raises :class:`InputError` before an update."""
        self._started()
        self._zero = self.residual.copy()

    def force(self, jacobian: ArrayLike, weight: ArrayLike) -> Array:
        """The force (m) on a point with ``jacobian`` (m, n) that explains the residual's change since :meth:`zero` best;
        ``weight`` (n): one over the squared uncertainty of each coordinate's residual. Raises :class:`InputError`
        (:class:`NotFinite`) before an update, and for numbers that cannot be."""
        self._started()
        n, j = self.residual.size, np.atleast_2d(np.asarray(jacobian, float))
        numbers("momentum observer", "jacobian", j.ravel(), len(j) * n)
        w = numbers("momentum observer", "weight", weight, n)
        change = self.residual if self._zero is None else self.residual - self._zero
        found: Array = np.linalg.solve((j * w) @ j.T + 1e-9 * np.eye(len(j)), (j * w) @ change)
        return found

    def _started(self) -> None:
        if self._previous is None:
            raise InputError("momentum observer: nothing is known before the first update")


class SensorlessForce:
    """The force (3) [N] of the world on a ball robot's end effector from state and torques alone, beside the measured one."""

    def __init__(self, robot: RobotModel) -> None:
        n = self._nq = ball_base(robot).nq
        q, force = ca.SX.sym("q", n), ca.SX.sym("f", 3)
        torque = ca.SX.sym("u", robot.input.size - 3)
        known = ball_base(robot).generalized_force(q, ca.vertcat(torque, ca.SX(3, 1)), ca.SX(robot.parameters.size, 1))
        self._known = Numeric(ca.Function("known", [q, torque], [known]))
        jacobian = ca.jacobian(ball_base(robot).tool_force(q, force), force).T
        self._jacobian = Numeric(ca.Function("jacobian", [q], [jacobian]))
        still = np.zeros(n)
        self.observer = MomentumObserver(
            ball_base(robot).numeric.mass_matrix, lambda q, v: ball_base(robot).numeric.inverse_dynamics(q, v, still)
        )
        self._load = ball_base(robot).numeric.tool_weight
        self._weight = 1.0 / np.array([*SPREAD[:5], *[SPREAD[5]] * (n - 5)]) ** 2
        self.force = np.zeros(3)

    def update(self, state: Array, torque: Array, interval: float, carried: float) -> None:
        """The state (nx) now, the torques that acted over the ``interval`` [s] before, the mass [kg] that the end effector holds."""
        q, v = state[: self._nq], state[self._nq :]
        known = self._known(q, torque)[0].ravel() + carried * self._load(q)
        self.observer.update(q, v, known, interval)
        self.force = self.observer.force(self._jacobian(q)[0], self._weight)
