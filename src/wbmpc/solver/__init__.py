"""Solvers: settings (:class:`SQP`), the solver bound to a problem, and solutions."""

from wbmpc.solver.solution import Solution, Status
from wbmpc.solver.sqp import SQP, SQPSolver

__all__ = ["SQP", "SQPSolver", "Solution", "Status"]
