"""Solvers: settings (:class:`SQP`), the solver bound to a problem, and solutions."""

from wbmpc.solver.solution import Solution, Status
from wbmpc.solver.solver import SQP, Solver

__all__ = ["SQP", "Solution", "Solver", "Status"]
