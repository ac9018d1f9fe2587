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
        problem, self._solver, self._sent, self._period = solver.problem, solver, sent, period
        n, nx, nu = solver.ocp.intervals, problem.nx, problem.nu
        self._plan = np.zeros(n + 1), np.zeros((n + 1, nx)), np.zeros((n, nu)), np.zeros((n, nu, nx))
        self._policy: Policy | None = None  # whose plan that is
        a = dict(zip(("times", "states", "inputs", "gains"), (each.reshape(-1) for each in self._plan), strict=True))
        a |= {name: np.zeros(size) for name, size in {"state": nx, "acted": nu, "trial": nx, "feedforward": nu}.items()}
        a |= solver.integrator | limits.arrays | {name: np.zeros(1) for name in ("limits", "active", "moving")}
        self._arrays, self._next, sizes = a, np.zeros(2 * nu), {"nx": nx, "nu": nu}
        law = {**sizes, "r": 0, "moves": 0, "blend": sent.blend, **limits.constants}
        a["rows"] = sent.rows.reshape(-1)
        self._through = bind(through, a, backend, **sizes)
        self._act = bind(act, a, backend, **law)
        self._foresee = bind(foresee, a | {"rows": self._next}, backend, **law)

    def _take(self, policy: Policy) -> bool:
        """Whether the plan of a ``policy`` is one that fits: it is here then."""
        n, (times, states, inputs, gains) = len(policy.u), self._plan
        own, given = (times[: n + 1], states[: n + 1], inputs[:n], gains[:n]), (policy.times, policy.x, policy.u, policy.gain)
        for mine, its in zip(own, given, strict=True):
            if mine.shape != its.shape or not n:
                return False
        for mine, its in zip(own, given, strict=True):
            mine[:] = its
        self._policy = policy
        return True

    def through(self, x: Array, rows: slice) -> Array | None:
        """The state (nx) after ``x`` under these rows of the torques that were sent, each for a period."""
        a = self._arrays
        if x.shape != a["state"].shape:
            return None
        a["state"][:] = x
        with self._solver.exclusive:
            known = self._through(rows.start, rows.stop - rows.start, self._period)
        return a["trial"].copy() if known else None

    def act(self, policy: Policy, t: float, x: Array, rows: slice) -> tuple[Array, Array, Array] | None:
        """Torques (nu) [N m] of a ``policy`` at time t [s] in the state (nx) that follows from x as in :meth:`through`, without and with
        feedback, and within limits, which go to the drives."""
        a = self._arrays
        if (policy is not self._policy and not self._take(policy)) or x.shape != a["state"].shape:
            return None
        a["state"][:] = x
        with self._solver.exclusive:
            known = self._act(
                len(policy.u), rows.start, rows.stop - rows.start, self._sent.begin(), t, self._period
            )
        if not known:
            return None
        self._sent.end()
        return a["feedforward"].copy(), a["torque"].copy(), a["out"].copy()

    def foresee(self, policy: Policy, t: float, x: Array, torque: Array) -> tuple[Array, Array] | None:
        """State (nx) and torques (nu) of the drives a period after these under a ``policy`` at time t [s]."""
        trial, nu = self._arrays["trial"], torque.size
        if policy is not self._policy and not self._take(policy):
            return None
        trial[:], self._next[:nu] = x, torque
        with self._solver.exclusive:
            known = self._foresee(len(policy.u), t, self._period)
        return (trial.copy(), self._next[:nu].copy()) if known else None
