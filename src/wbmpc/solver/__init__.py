"""Solvers: settings (:class:`SQP`, :class:`ILQR`, :class:`SLQ`), the solver bound to a problem, and solutions."""

from wbmpc.solver.results import Trajectory
from wbmpc.solver.settings import ILQR, SLQ, SQP, InteriorPoint
from wbmpc.solver.solution import Solution, Status
from wbmpc.solver.solver import Solver

__all__ = ["ILQR", "SLQ", "SQP", "InteriorPoint", "Solution", "Solver", "Status", "Trajectory"]
