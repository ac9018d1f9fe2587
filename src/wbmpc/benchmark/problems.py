"""What problems of the race are. Those of ``wbmpc bench`` are found by the entry-point group ``wbmpc.race``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from wbmpc import plugins
from wbmpc.errors import InputError
from wbmpc.ocp import ModeSchedule, OptimalControlProblem, Reference
from wbmpc.solver import SQP, Solver

GROUP = "wbmpc.race"


@dataclass(frozen=True)
class SampleProblem:
    """A problem with all that a solver needs: start ``x0`` (nx), guess ``x`` (nx or N + 1, nx) and ``u`` (nu or N, nu)."""

    name: str
    ocp: OptimalControlProblem
    x0: np.ndarray
    x: np.ndarray
    u: np.ndarray
    references: Mapping[str, Reference] = field(default_factory=dict)
    schedule: ModeSchedule | None = None

    def solver(self, settings: Any = None) -> Solver:
        """A solver with references, modes and the guess set."""
        solver = Solver(self.ocp, settings or SQP())
        for name, reference in self.references.items():
            solver.set_reference(name, reference)
        if self.schedule is not None:
            solver.set_schedule(self.schedule)
        solver.warm_start(self.x, self.u)
        return solver


@dataclass(frozen=True)
class Problem:
    """A solver with its references set, its start, and the guess that every solver gets."""

    name: str
    solver: Solver
    x0: np.ndarray
    u0: np.ndarray


def suite_bench(problem: SampleProblem) -> Problem:
    """A sample problem for the race; its guess is the start, held, with the guess's first input."""
    solver = problem.solver(SQP(iterations=300))
    return Problem(problem.name, solver, problem.x0, np.atleast_2d(problem.u)[0])


@dataclass(frozen=True)
class RaceProblems:
    """What is raced on. ``robots``: each makes a problem, with ``limits`` "soft" or "hard". ``limited``: by name, what makes a problem
    of hard limits with settings of the solver. ``sizes``: by name, what makes a problem, the milliseconds of one iteration that
    OCS2 publishes of one of the same size, and how many times faster we want to be."""

    robots: Sequence[Callable[..., Problem]]
    limited: Mapping[str, Callable[[SQP], Problem]]
    sizes: Mapping[str, tuple[Callable[[], SampleProblem], float, float]]


@cache
def race_problems() -> RaceProblems:
    """All that installed packages offer. Raises :class:`InputError` if there are none, or they cannot be imported."""
    offered = plugins.offered(GROUP)
    if not offered:
        raise InputError(f"no installed package offers problems for the race (entry-point group '{GROUP}')")
    found: list[RaceProblems] = [plugins.load(value, f"race '{name}':") for name, value in offered.items()]
    return RaceProblems(
        [make for each in found for make in each.robots],
        {name: make for each in found for name, make in each.limited.items()},
        {name: size for each in found for name, size in each.sizes.items()},
    )
