"""Receding-horizon control: shift, sample the references, iterate, hand out a policy."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from wbmpc.errors import InputError, RunAborted
from wbmpc.mpc.policy import Policy
from wbmpc.ocp import ModeSchedule, OptimalControlProblem, Reference
from wbmpc.solver import SQP, Solution, Solver, Status

#: (solver, time of the horizon's start, initial state): may rewrite the solver's trajectories before it iterates.
Guess = Callable[[Solver, float, np.ndarray], None]


@dataclass(frozen=True)
class Observation:
    """State ``x`` (nx) at time ``t`` [s]: for the MPC, the state predicted for the moment its policy comes into force."""

    t: float
    x: np.ndarray


class References:
    """``mpc.reference["hand"] = Reference...``: what the terms compare with."""

    def __init__(self, solver: Solver) -> None:
        self._solver = solver

    def __setitem__(self, name: str, reference: Reference) -> None:
        self._solver.set_reference(name, reference)

    def __getitem__(self, name: str) -> Reference:
        return self._solver.references[name]

    def __contains__(self, name: str) -> bool:
        return name in self._solver.references


@dataclass
class Statistics:
    """Solve times [s], failed solves, and the last solution's status."""

    solve_times: list[float] = field(default_factory=list)
    failures: int = 0


class MPC:
    """One problem solved again and again from the shifted last solution.

    ``rate`` [Hz] is checked by the loop. ``first_iterations``: iterations of the first solve. ``guess``: see
    :data:`Guess`. A solve that fails keeps the last policy and starts the next one from its plan.
    """

    def __init__(
        self,
        ocp: OptimalControlProblem,
        solver: SQP | None = None,
        rate: float = 50.0,
        *,
        first_iterations: int = 30,
        guess: Guess | None = None,
    ) -> None:
        if not rate > 0.0:
            raise InputError(f"mpc.rate: must be positive, got {rate}")
        settings = solver or SQP.real_time()
        self.ocp, self.rate, self.guess = ocp, float(rate), guess
        self.solver = Solver(ocp, settings)
        self.reference = References(self.solver)
        self.statistics = Statistics()
        self._first = first_iterations
        self._policy: Policy | None = None
        self._t: float | None = None

    @property
    def period(self) -> float:
        """Time between two updates [s]."""
        return 1.0 / self.rate

    def set_schedule(self, schedule: ModeSchedule) -> None:
        """Modes over absolute time."""
        self.solver.set_schedule(schedule)

    def reset(self, x: np.ndarray, u: np.ndarray | None = None) -> None:
        """Forget the last plan; start from the state ``x`` (nx) and the input ``u`` (nu) held."""
        self.solver.guess(x, u)
        self.solver.forget()
        self._t, self._policy = None, None

    def update(self, observation: Observation) -> Policy:
        """A new policy from the observation. Raises :class:`RunAborted` if there has never been a usable one."""
        self._check(observation)
        x0 = np.ascontiguousarray(observation.x, float)
        delta = 0.0 if self._t is None else observation.t - self._t
        passes = self._first if self._t is None else 1
        status, count, elapsed = 0, 0, 0.0
        for k in range(passes):
            start = time.perf_counter()
            if self.guess is not None and k == 0:
                self.guess(self.solver, observation.t, x0)
            status, count = self.solver.run(x0, observation.t, delta if k == 0 else 0.0)
            elapsed = time.perf_counter() - start
        if self._t is not None:
            self.statistics.solve_times.append(elapsed)
        self._t = observation.t
        solution: Solution = self.solver.solution(status, count, elapsed)
        if solution.status is Status.NOT_FINITE or not np.isfinite(solution.u).all():
            return self._fall_back(solution)
        self._policy = Policy.of(solution, observation.t)
        return self._policy

    def _check(self, observation: Observation) -> None:
        names = self.ocp.dynamics.state.names
        if observation.x.shape != (len(names),):
            raise InputError(f"observation: {len(names)} numbers are needed, got shape {observation.x.shape}")
        if not np.isfinite(observation.x).all():
            raise InputError(f"observation: '{names[int(np.argmax(~np.isfinite(observation.x)))]}' is not finite")
        if self._t is not None and observation.t < self._t:
            raise InputError(f"observation: time went back from {self._t:.4f} to {observation.t:.4f} s")

    def _fall_back(self, solution: Solution) -> Policy:
        """Keep the last policy, valid for its horizon, and restart from its plan."""
        self.statistics.failures += 1
        if self._policy is None:
            raise RunAborted(f"the first solve failed: {solution}")
        self.solver.guess(self._policy.x, self._policy.u)
        self.solver.forget()
        self._t = float(self._policy.times[0])  # the next update shifts that plan from where it starts
        return self._policy
