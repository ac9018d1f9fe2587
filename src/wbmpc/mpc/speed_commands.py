"""Plans by accelerations for controllers that command speeds."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from wbmpc.errors import InputError
from wbmpc.model.augment import InputRate, WithPath
from wbmpc.mpc.guess import Bound, Guess
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.policy import Policy
from wbmpc.solver import SQP, Trajectory
from wbmpc.solver.simulation_arguments import simulation_arguments
from wbmpc.types import Observation


@dataclass(frozen=True)
class SpeedPolicy(Policy):
    """What a plan by accelerations means for drives that follow speeds: ``x`` (N + 1, nx) and ``u`` (N, nu) of the robot itself, the
    inputs at the beginning of each interval, which change by ``slope`` (N, nu) per second. It has no feedback: drives hold speeds."""

    slope: np.ndarray = field(kw_only=True)

    def feedforward(self, t: float) -> np.ndarray:
        """Planned speeds (nu) at time t [s]."""
        k = self._interval(t)
        start, end = self.times[k : k + 2].tolist()
        return self.u[k] + self.slope[k] * (min(max(t, start), end) - start)

    def law(self, t: float, x: np.ndarray) -> np.ndarray:
        """The planned speeds (nu), whatever the state is."""
        self._checked(t, x)
        return self.feedforward(t)

    def __call__(self, t: float, x: np.ndarray | None = None) -> np.ndarray:
        """The planned speeds (nu), whatever the state is."""
        return self.feedforward(t)


class SpeedMPC(MPC):
    """An :class:`MPC` of a problem with accelerations as inputs (:func:`wbmpc.ocp.with_accelerations`), as controllers use one on speeds.

    An observation that has the robot's own state (nx) gets the speeds that the active plan has at its time (before the first plan and
    after the end of the last one: none), and its policy gives speeds (:class:`SpeedPolicy`). Measured speeds would feed drive lag and
    noise into the accelerations. One with the problem's state gives the problem's policy. Its guess is one of the robot's own states and
    inputs, and of the path where there is one. :meth:`advance`, and with it the real-time runner, takes the problem's state alone.
    """

    def __init__(self, ocp: Any, solver: SQP | None = None, rate: float = 50.0, **options: Any) -> None:
        inner = ocp.dynamics.dynamics if isinstance(ocp.dynamics, WithPath) else ocp.dynamics
        if not isinstance(inner, InputRate):
            raise InputError("speed MPC: a problem with accelerations as inputs is needed (with_accelerations)")
        self._dynamics: InputRate = inner
        base = getattr(inner.dynamics, "base", None)  # a user's own dynamics have none
        self._rolling = [g for g in getattr(base, "rolling_groups", ()) if g not in inner.groups]
        guess = options.pop("guess", None)
        super().__init__(ocp, solver, rate, **options)
        self._own = self._dynamics.dynamics.state.size
        self.guess = None if guess is None else _SpeedGuess(guess, self._dynamics)

    @property
    def dynamics(self) -> Any:
        """The dynamics on speeds, which controllers know."""
        return self._dynamics.dynamics

    def reset(self, x: np.ndarray, u: np.ndarray | None = None) -> None:
        """As of :class:`MPC`; from the robot's own state (nx): at rest there."""
        x = np.asarray(x, float)
        if x.ndim == 1 and x.size == self._own:
            x = np.concatenate([x, np.zeros(self._dynamics.state.size - self._own)])
        super().reset(x, u)

    def simulate(self, x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        """As of :class:`MPC`: state (nx) of the robot after speeds u (nu), or (k, nu), which are held."""
        x, u, h = simulation_arguments(self.dynamics, x, u, h)
        d, inputs = self._dynamics, self._dynamics.dynamics.input
        for row in np.atleast_2d(u):
            held = np.concatenate([row[inputs[group]] for group in d.groups])
            rates = np.zeros(d.input.size)
            for group in set(inputs.groups) - set(d.groups):
                rates[d.input[group]] = row[inputs[group]]
            x = super().simulate(np.concatenate([x, held]), rates, h)[: self._own]
        return x

    def _update(self, observation: Observation) -> Policy:
        if np.size(observation.x) != self._own:
            return super()._update(observation)
        full = np.concatenate([observation.x, self._planned_speeds(observation.t)])
        return self._in_speeds(super()._update(replace(observation, x=full)))

    def _planned_speeds(self, t: float) -> np.ndarray:
        plan = self._policy
        if plan is None or t > plan.end:
            return np.zeros(self._dynamics.state.size - self._own)
        return plan.state(t)[self._own : self._dynamics.state.size]

    def _in_speeds(self, plan: Policy) -> SpeedPolicy:
        d, inputs = self._dynamics, self._dynamics.dynamics.input
        u, slope = plan.u.copy(), np.zeros_like(plan.u)
        steps = np.diff(plan.times)[:, None]
        for group in d.groups:
            u[:, inputs[group]] = plan.x[:-1, d.state[f"{group}_input"]]
            slope[:, inputs[group]] = plan.u[:, d.input[f"{group}_rate"]]
        for group in self._rolling:  # wheels roll with the base, from node to node
            part = inputs[group]
            slope[:-1, part] = np.diff(u[:, part], axis=0) / steps[:-1]
        own, gain = np.ascontiguousarray(plan.x[:, : self._own]), np.zeros((*plan.u.shape, self._own))
        return SpeedPolicy(
            plan.times, own, u, gain, slope=slope, limit_violation=plan.limit_violation, clearance=plan.clearance
        )


class _SpeedGuess:
    """A guess of the robot's own states and inputs, and the path's, for a problem on accelerations."""

    def __init__(self, inner: Guess, dynamics: InputRate) -> None:
        self._inner, self._dynamics = inner, dynamics

    def bind(self, mpc: MPC) -> None:
        """The inner guess too."""
        if isinstance(self._inner, Bound):
            self._inner.bind(mpc)

    def __call__(self, t: float, x0: np.ndarray, trajectory: Trajectory) -> Trajectory | None:
        d, inputs = self._dynamics, self._dynamics.dynamics.input
        speeds = trajectory.u.copy()
        own_state = np.r_[: d.dynamics.state.size, d.state.size : trajectory.x.shape[1]]
        for group in d.groups:
            speeds[:, inputs[group]] = trajectory.x[:-1, d.state[f"{group}_input"]]
        own = Trajectory(trajectory.start, trajectory.grid, trajectory.x[:, own_state], speeds)
        found = self._inner(t, x0[own_state], own)
        if found is None:
            return None
        x, u = trajectory.x.copy(), found.u.copy()
        x[:, own_state] = found.x
        for group in d.groups:
            held = found.u[:, inputs[group]]
            held = np.vstack([x0[d.state[f"{group}_input"]], held[1:], held[-1:]])
            x[:, d.state[f"{group}_input"]] = held
            u[:, d.input[f"{group}_rate"]] = np.diff(held, axis=0) / np.diff(trajectory.grid)[:, None]
        return Trajectory(trajectory.start, trajectory.grid, x, u)
