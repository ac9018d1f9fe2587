"""Optimal control problems: residuals, norms, sets, named terms, modes, references."""

from wbmpc.ocp import residuals, sets
from wbmpc.ocp.accelerations import with_accelerations
from wbmpc.ocp.frequency import frequency_aware
from wbmpc.ocp.norms import AugmentedLagrangian, Quadratic, RelaxedBarrier, SmoothL1
from wbmpc.ocp.path import Path
from wbmpc.ocp.path_transform import add_progress, path_problem
from wbmpc.ocp.problem import OptimalControlProblem
from wbmpc.ocp.reference import Reference
from wbmpc.ocp.schedule import Mode, ModeSchedule
from wbmpc.ocp.terms import Constraint, Cost
from wbmpc.ocp.transcription import Transcription

__all__ = [
    "AugmentedLagrangian", "Constraint", "Cost", "Mode", "ModeSchedule", "OptimalControlProblem", "Path", "Quadratic",
    "Reference", "RelaxedBarrier", "SmoothL1", "Transcription", "add_progress", "frequency_aware", "path_problem",
    "residuals", "sets", "with_accelerations",
]  # fmt: skip
