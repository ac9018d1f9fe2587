"""What a test problem is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from wbmpc.ocp import ModeSchedule, OptimalControlProblem, Reference
from wbmpc.solver import SQP, Solver


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
