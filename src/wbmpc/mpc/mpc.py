"""Receding-horizon control: shift, sample the references, iterate, hand out a policy."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from wbmpc.errors import InputError, NotFinite, RunAborted
from wbmpc.mpc.policy import Policy
from wbmpc.ocp import ModeSchedule, OptimalControlProblem, Reference
from wbmpc.solver import SQP, Solution, Solver, Status
from wbmpc.solver.certificate import not_finite
from wbmpc.solver.solution import COLUMNS

#: (solver, time of the horizon's start, initial state): may rewrite the solver's trajectories before it iterates.
Guess = Callable[[Solver, float, np.ndarray], None]


@dataclass(frozen=True)
class Observation:
    """State ``x`` (nx) at time ``t`` [s]: for the MPC, the state predicted for the moment its policy comes into force."""

    t: float
    x: np.ndarray

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "t", float(self.t))
            object.__setattr__(self, "x", np.asarray(self.x, float))
        except (TypeError, ValueError) as error:
            raise InputError(f"observation: a time and a vector of numbers are needed ({error})") from error


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
    """Solve times [s] of all updates but the first; how many solves there were, and how many did not help.

    ``failures``: solves without a usable plan (the last one stayed in force); ``no_step``: solves in which no step length
    was accepted, so that the plan is the last one moved on.
    """

    solve_times: list[float] = field(default_factory=list)
    solves: int = 0
    failures: int = 0
    no_step: int = 0

    @property
    def failed_share(self) -> float:
        """Solves without a new plan over all solves (0 before the first)."""
        return (self.failures + self.no_step) / max(self.solves, 1)


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
        if not (rate > 0.0 and np.isfinite(rate)):
            raise InputError(f"mpc.rate: must be positive, got {rate}")
        settings = solver or SQP(iterations=1, certify=False, smallest_step=0.2, force_step=True)
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
        """Forget the last plan; start from the state ``x`` (nx) and the input ``u`` (nu) held.

        Raises :class:`InputError` naming the entry that is not finite.
        """
        d = self.ocp.dynamics
        for names, value in ((d.state.names, x), (d.input.names, u)):
            if value is not None:
                _check_vector("reset", names, value)
        self.solver.guess(x, u)
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
        self.statistics.solves += 1
        fault = _fault(solution)
        if fault:
            return self._fall_back(solution, fault)
        self.statistics.no_step += int(solution.log[-1, COLUMNS["alpha"]] == 0.0 and not solution.kkt <= 1e-6)
        self._policy = Policy.of(solution, observation.t)
        return self._policy

    def _check(self, observation: Observation) -> None:
        if not np.isfinite(observation.t):
            raise NotFinite(f"observation: the time must be finite, got {observation.t}")
        _check_vector("observation", self.ocp.dynamics.state.names, observation.x)
        if self._t is not None and observation.t < self._t:
            raise InputError(f"observation: time went back from {self._t:.4f} to {observation.t:.4f} s")

    def _fall_back(self, solution: Solution, fault: str) -> Policy:
        """Keep the last policy, valid for its horizon, and restart from its plan."""
        self.statistics.failures += 1
        if self._policy is None:
            detail = not_finite(self.solver.problem, self.solver.ws)
            raise RunAborted(f"the first solve {fault}" + (f" ({detail})" if detail else ""))
        self.solver.guess(self._policy.x, self._policy.u)
        self._t = float(self._policy.times[0])  # the next update shifts that plan from where it starts
        return self._policy


def _check_vector(where: str, names: Sequence[str], value: np.ndarray) -> None:
    """Raise :class:`InputError` unless ``value`` has one finite number for each name."""
    try:
        vector = np.asarray(value, float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: {len(names)} numbers are needed ({error})") from error
    if vector.shape != (len(names),):
        raise InputError(f"{where}: {len(names)} numbers are needed, got shape {vector.shape}")
    if not np.isfinite(vector).all():
        raise NotFinite(f"{where}: '{names[int(np.argmax(~np.isfinite(vector)))]}' is not finite")


def _fault(solution: Solution) -> str:
    """Why a solution cannot become a policy: the solver refused it, or a part of it is not finite; else empty."""
    if solution.status in (Status.NOT_FINITE, Status.DIVERGED):
        return solution.status.value
    parts = {"planned state": solution.x, "planned input": solution.u, "feedback gain": solution.gain}
    bad = [name for name, values in parts.items() if not np.isfinite(values).all()]
    return f"failed: the {bad[0]} is not finite" if bad else ""
