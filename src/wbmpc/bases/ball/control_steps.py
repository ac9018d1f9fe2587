"""The compiled part of a ball robot's controller that follows policies, for states of its model and the torques that were sent."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wbmpc.bases.ball.control_step import act, foresee, through
from wbmpc.bases.ball.sent_torques import SentTorques
from wbmpc.bases.ball.torque_limits import TorqueLimits
from wbmpc.kernel.step import Backend, bind
from wbmpc.mpc.policy import Policy
from wbmpc.solver import Solver
from wbmpc.solver.feedback import Plan

Array = NDArray[np.float64]


class ControlSteps:
    """Of torques within ``limits``, which drives follow as ``sent`` has it every ``period`` [s], and of the model as a ``solver`` integrates
    it. ``backend``: machine code, or the same source as ordinary Python.

    None of what it finds is found where something is not finite, or a policy has other states and inputs: who asks it part by part gets
    the error.
    """

    def __init__(
        self, solver: Solver, limits: TorqueLimits, sent: SentTorques, period: float, backend: Backend = "compiled"
    ) -> None:
        nx, nu = self._sizes = solver.problem.nx, solver.problem.nu
        self._solver, self._sent, self._period = solver, sent, period
        own = {"state": np.zeros(nx), "acted": np.zeros(nu), "trial": np.zeros(nx), "feedforward": np.zeros(nu)}
        a = self._arrays = solver.integrator | limits.arrays | own
        self._next = np.zeros(2 * nu)
        law = {"changing": [name for name, kind in Plan.__annotations__.items() if "Floats" in str(kind)], "blend": sent.blend}
        rows = {"rows": sent.rows.reshape(-1)}
        self._through = bind(through, a | rows, backend, nx=nx, nu=nu)
        self._act = bind(act, a | rows, backend, **law, **limits.constants)
        self._foresee = bind(foresee, a | {"rows": self._next}, backend, **law, **limits.constants)

    def through(self, x: Array, rows: slice) -> Array | None:
        """The state (nx) after ``x`` under these rows of the torques that were sent, each for a period."""
        a = self._arrays
        if x.shape != a["state"].shape:
            return None
        a["state"][:] = x
        with self._solver.exclusive:
            known = self._through(rows.start, rows.stop - rows.start, self._period)
        return a["trial"].copy() if known else None

    def act(self, policy: Policy, t: float, x: Array) -> tuple[Array, Array, Array] | None:
        """Torques (nu) [N m] of a ``policy`` at time t [s] in the state x (nx), without and with feedback, and within limits, which go to the
        drives."""
        plan, a = policy.plan, self._arrays
        if plan[8:10] != self._sizes:
            return None
        a["trial"][:] = x
        if not self._act(*plan, self._sent.begin(), t):
            return None
        self._sent.end()
        return a["feedforward"].copy(), a["torque"].copy(), a["out"].copy()

    def foresee(self, policy: Policy, t: float, x: Array, torque: Array) -> tuple[Array, Array] | None:
        """State (nx) and torques (nu) of the drives a period after these under a ``policy`` at time t [s]."""
        plan, trial, (_, nu) = policy.plan, self._arrays["trial"], self._sizes
        if plan[8:10] != self._sizes:
            return None
        trial[:], self._next[:nu] = x, torque
        with self._solver.exclusive:
            known = self._foresee(*plan, t, self._period)
        return (trial.copy(), self._next[:nu].copy()) if known else None
