"""Optimal control problems: residuals, norms, sets, named terms, modes, references."""

from wbmpc.ocp import residuals, sets
from wbmpc.ocp.accelerations import with_accelerations
from wbmpc.ocp.frequency import frequency_aware
from wbmpc.ocp.norms import AugmentedLagrangian, Quadratic, RelaxedBarrier, SmoothL1
from wbmpc.ocp.problem import OptimalControlProblem
from wbmpc.ocp.reference import Reference
from wbmpc.ocp.schedule import Mode, ModeSchedule
from wbmpc.ocp.terms import Constraint, Cost
from wbmpc.ocp.transcription import Transcription

__all__ = [
    "AugmentedLagrangian",
    "Constraint",
    "Cost",
    "Mode",
    "ModeSchedule",
    "OptimalControlProblem",
    "Quadratic",
    "Reference",
    "RelaxedBarrier",
    "SmoothL1",
    "Transcription",
    "frequency_aware",
    "residuals",
    "sets",
    "with_accelerations",
]
