"""The equations of a ball robot for numbers: compiled when they are first used."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.errors import InputError
from wbmpc.model.layout import Layout
from wbmpc.model.numeric import Numeric

if TYPE_CHECKING:
    from wbmpc.bases.ball.model import BallBase

Array = NDArray[np.float64]


class BallNumeric:
    """Dynamics and equilibria of one ball robot with nq coordinates; reached as ``robot.base.numeric``."""

    def __init__(self, base: BallBase) -> None:
        self._base, self._state = base, Layout(base.state)
        self._input, self._parameters = Layout(base.input).size, Layout(base.parameters).size
        self._numeric: dict[str, Numeric] = {}
        self._functions: dict[str, ca.Function] = {}
        #: What :class:`wbmpc.bases.ball.balance.Balance` has found, by all that it depends on.
        self.balances: dict[tuple[object, ...], Any] = {}

    def mass_matrix(self, q: ArrayLike) -> Array:
        """M (nq, nq) with the spin of the ball."""
        base = self._base
        if "M" not in self._numeric:
            s = ca.SX.sym("q", base.nq)
            self._numeric["M"] = Numeric(ca.Function("M", [s], [ca.densify(base.mass_matrix(s))]))
        return self._numeric["M"](q)[0]

    def tool_moment(self, q: ArrayLike, moment: ArrayLike) -> Array:
        """Generalized forces (nq) of a moment (3) [N m] of the world on the tool, world axes."""
        base = self._base
        if "moment" not in self._numeric:
            s, m = ca.SX.sym("q", base.nq), ca.SX.sym("m", 3)
            function = ca.Function("moment", [s, m], [ca.densify(base.tool_moment(s, m))])
            self._numeric["moment"] = Numeric(function)
        return self._numeric["moment"](q, moment)[0].ravel()

    def tool_weight(self, q: ArrayLike) -> Array:
        """Generalized forces (nq) [N, N m] of the weight of 1 kg at the tool."""
        base = self._base
        if "weight" not in self._numeric:
            s = ca.SX.sym("q", base.nq)
            function = ca.Function("weight", [s], [ca.densify(base.tool_force(s, ca.SX([0, 0, -9.81])))])
            self._numeric["weight"] = Numeric(function)
        return self._numeric["weight"](q)[0].ravel()

    def inverse_dynamics(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """M a + h (nq): the generalized forces of a motion."""
        base = self._base
        if "tau" not in self._functions:
            s = [ca.SX.sym(n, base.nq) for n in "qva"]
            self._functions["tau"] = ca.Function("tau", s, [ca.densify(base.inverse_dynamics(*s))])
        return np.array(self._functions["tau"](*(np.asarray(value, float) for value in (q, v, a)))).ravel()

    def equilibrium(self, arm: ArrayLike, yaw: float = 0.0, force: ArrayLike = (0.0, 0.0, 0.0)) -> tuple[Array, Array]:
        """State (nx) and torques (wheels + arm) at which the robot rests with a force (3) [N] of the world on the tool."""
        from scipy.optimize import root

        base = self._base
        n = base.nq
        if "rest" not in self._functions:
            q, u, f = ca.SX.sym("q", n), ca.SX.sym("u", len(base.input["wheel"]) + n - 5), ca.SX.sym("f", 3)
            inputs = ca.vertcat(u, ca.SX.zeros(self._input - u.shape[0]))
            rest = base.inverse_dynamics(q, ca.SX(n, 1), ca.SX(n, 1)) - base.tool_force(q, f)
            rest -= base.generalized_force(q, inputs, ca.SX.zeros(self._parameters))
            self._functions["rest"] = ca.Function("rest", [q, u, f], [rest])
        rest_of, angles, push = self._functions["rest"], np.asarray(arm, float), np.asarray(force, float)
        if angles.shape != (n - 5,) or push.shape != (3,):
            raise InputError(f"{base.name}: an equilibrium needs {n - 5} arm angles and 3 forces")

        def joints(z: Array) -> Array:
            return np.concatenate([[0, 0, yaw], z[:2], angles])

        # With more than three wheels the torques are not unique: the least-norm ones to a torque (3) on the ball.
        wheels = np.linalg.pinv(base.wheel_torque_map())

        def torques(z: Array) -> Array:
            return np.concatenate([wheels @ z[2:5], z[5:]])

        def unbalanced(z: Array) -> Array:
            return np.array(rest_of(joints(z), torques(z), push)).ravel()

        found = root(unbalanced, np.zeros(n), method="hybr", options={"xtol": 1e-14})
        if np.abs(found.fun).max() > 1e-8:
            raise InputError(f"{base.name}: no equilibrium for the arm at {angles} with force {push}")
        x = self._state.vector({})
        x[:n] = joints(found.x)
        return x, torques(found.x)
