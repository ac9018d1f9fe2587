"""The problem that minimizes what the constraints of another one miss."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import casadi as ca
import numpy as np

from wbmpc.ocp.constraint_classification import missed, row_scales
from wbmpc.ocp.problem import OptimalControlProblem
from wbmpc.ocp.residuals import Expression, Symbols
from wbmpc.ocp.term_rows import with_input
from wbmpc.ocp.terms import Constraint, Cost
from wbmpc.ocp.transcription import Transcription

#: Weight of all variables: what constraints leave free needs some curvature.
SMALL = 1e-11


def violation_problem(problem: Transcription, rows: Mapping[str, np.ndarray]) -> OptimalControlProblem:
    """The same dynamics, and no cost but half the squares of what ``rows`` of constraints (by name) miss, and ``SMALL`` of all variables.

    What misses of "name" along the path is called "name, path", at the end "name, terminal".
    """
    ocp = problem.ocp.on(problem.ocp.dynamics)
    variables = Expression(problem.nx + problem.nu, lambda s: ca.vertcat(s.all_x, s.all_u))
    ocp.add(Cost("variables", variables, SMALL))
    parts: tuple[Literal["path", "terminal"], ...] = ("path", "terminal")
    for name, chosen in rows.items():
        term = problem.ocp.terms[name]
        assert isinstance(term, Constraint)
        for at in parts:
            there = chosen & ~with_input(problem, term) if at == "terminal" else chosen
            if term.at in (at, "path+terminal") and there.any():
                ocp.add(Cost(f"{name}, {at}", _misses(term, there), at=at, modes=term.modes))
    return ocp


def _misses(term: Constraint, rows: np.ndarray) -> Expression:
    """What some rows of a constraint miss, those in unlucky units divided by the length of their gradient."""

    def values(s: Symbols) -> ca.SX:
        r = ca.SX(term.residual(s))
        scales = row_scales(ca.jacobian(r, ca.vertcat(s.all_x, s.all_u)))
        return (missed(term, r) / scales)[np.flatnonzero(rows).tolist()]

    return Expression(int(rows.sum()), values, term.residual.reference)
