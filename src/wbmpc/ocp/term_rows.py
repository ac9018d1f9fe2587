"""Rows of single terms of a transcription: what they depend on, and how far they are from being met."""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from wbmpc.ocp.constraint_classification import RowGroup, depends, missed, nonlinear_equalities
from wbmpc.ocp.norms import AugmentedLagrangian
from wbmpc.ocp.terms import Constraint

if TYPE_CHECKING:
    from wbmpc.ocp.transcription import Transcription


def with_input(t: Transcription, term: Constraint) -> np.ndarray:
    """For every row of a term, whether it depends on the input."""
    return depends(t.residual(term), t.u)


def with_state(t: Transcription, term: Constraint) -> np.ndarray:
    """For every row of a term, whether it depends on the state."""
    return depends(t.residual(term), t.x)


def violation(t: Transcription, term: Constraint) -> ca.SX:
    """How far every row of a constraint is from being met, in the residual's unit; 0 in modes where it does not count."""
    return t.switch(term.name) * ca.fabs(missed(term, t.residual(term)))


def nonlinear_in_the_inputs(t: Transcription) -> set[str]:
    """Names of the equalities, and of constraints with multipliers, that have second derivatives by the inputs."""
    own = [c for c in t.ocp.terms.values() if isinstance(c, Constraint) and not c.hard]
    own = [c for c in own if c.equality or isinstance(c.penalty, AugmentedLagrangian)]
    return {c.name for c in own if nonlinear_equalities(t.residual(c), RowGroup(), t.u)}
