"""The optimal control problem: dynamics, a time grid, named terms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from wbmpc import trajectory
from wbmpc.errors import InputError, unknown_name
from wbmpc.model import Dynamics
from wbmpc.ocp.sets import Zero
from wbmpc.ocp.terms import Constraint, Cost

Term = Cost | Constraint


class OptimalControlProblem:
    """minimise Σ ∫ cost dt + terminal cost, subject to ẋ = f(x, u) and constraints, over ``horizon`` seconds.

    ``intervals``: number of intervals N. ``first_interval`` [s]: geometric grid, fine near now; uniform when left out;
    or ``grid``: the times of the N + 1 nodes from 0 [s]. ``integrator``: "rk2" (midpoint) or "rk4" steps.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        horizon: float,
        intervals: int,
        *,
        first_interval: float | None = None,
        grid: Sequence[float] | None = None,
        integrator: Literal["rk2", "rk4"] = "rk2",
    ) -> None:
        if integrator not in ("rk2", "rk4"):
            raise unknown_name("integrator", integrator, ("rk2", "rk4"))
        self.dynamics = dynamics
        self.integrator = integrator
        self.grid = _grid(horizon, intervals, first_interval, grid)
        self.terms: dict[str, Term] = {}

    @property
    def intervals(self) -> int:
        """Number of intervals N."""
        return len(self.grid) - 1

    @property
    def horizon(self) -> float:
        """Length of the horizon [s]."""
        return float(self.grid[-1])

    @property
    def costs(self) -> list[Cost]:
        return [t for t in self.terms.values() if isinstance(t, Cost)]

    @property
    def equalities(self) -> list[Constraint]:
        return [t for t in self.terms.values() if isinstance(t, Constraint) and isinstance(t.set, Zero)]

    @property
    def inequalities(self) -> list[Constraint]:
        return [t for t in self.terms.values() if isinstance(t, Constraint) and not isinstance(t.set, Zero)]

    def add(self, term: Term) -> None:
        """Add a term; its name must be new."""
        if term.name in self.terms:
            raise InputError(f"term '{term.name}' is already there; valid: a new name")
        self.terms[term.name] = term

    def term(self, name: str) -> Term:
        """The term of that name."""
        if name not in self.terms:
            raise unknown_name("term", name, self.terms)
        return self.terms[name]


def _grid(horizon: float, intervals: int, first: float | None, grid: Sequence[float] | None) -> np.ndarray:
    if grid is not None:
        times = np.asarray(grid, float)
        if times.ndim != 1 or times.size < 2 or times[0] != 0.0 or np.any(np.diff(times) <= 0):
            raise InputError("grid: needs at least two increasing times that start at 0")
        return times
    if first is not None:
        return trajectory.geometric_grid(horizon, intervals, first)
    return trajectory.uniform_grid(horizon, intervals)
