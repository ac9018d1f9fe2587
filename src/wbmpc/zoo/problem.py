"""What the zoo's problems are made of: equations of motion from a function, residual rows from a function."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from wbmpc.model import Layout
from wbmpc.ocp import ModeSchedule, OptimalControlProblem, Reference
from wbmpc.ocp.residuals import Symbols
from wbmpc.solver import SQP, Solver

Groups = Mapping[str, Sequence[str]]


class Equations:
    """ẋ = f(x, u) from a function on SX, with named states and inputs."""

    unit_quaternions: tuple[int, ...] = ()

    def __init__(self, state: Groups, inputs: Groups, f: Callable[[ca.SX, ca.SX], ca.SX]) -> None:
        self.state, self.input = Layout(state), Layout(inputs)
        self.parameters, self.mode = Layout({}), Layout({})
        self.f = f

    def __call__(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """ẋ (nx)."""
        return ca.SX(self.f(x, u))

    def jacobian(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> tuple[ca.SX, ca.SX]:
        """ẋ and its Jacobian (nx, nx + nu) by [x; u]."""
        f = self(x, u, w, m)
        return f, ca.jacobian(f, ca.vertcat(x, u))


@dataclass(frozen=True)
class Rows:
    """A residual of ``size`` rows from a function of the symbols; ``reference`` numbers are compared with."""

    size: int
    function: Callable[[Symbols], ca.SX] = field(compare=False, repr=False)
    reference: int = 0

    @property
    def groups(self) -> dict[str, slice]:
        """One group of all rows."""
        return {"all": slice(0, self.size)}

    def __call__(self, s: Symbols) -> ca.SX:
        return self.function(s)


@dataclass(frozen=True)
class ZooProblem:
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
        solver.guess(self.x, self.u)
        return solver
