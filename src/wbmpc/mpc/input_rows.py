"""Straight hard rows of the inputs that policies hold their feedback to, in each interval of a plan."""

from __future__ import annotations

import numpy as np

from wbmpc.mpc.policy import InputLimits
from wbmpc.solver import Solver


class InputRows:
    """``limits``: bounds and straight hard rows of the inputs, of all modes; ``switches`` (r,): which of a node's parameters turns
    each row on, −1 for always; ``table``: what parameters of the node and of the horizon add to offsets, one after the other."""

    def __init__(self, solver: Solver) -> None:
        self._solver = solver
        self.planes = planes = solver.problem.input_planes()
        self.limits = InputLimits(*solver.problem.input_bounds(), planes.matrix, planes.offset)
        first = solver.problem.node.slices["switch"].start
        self.switches = np.append(np.where(planes.switches >= 0, planes.switches + first, -1), -1).astype(np.int64)
        self.table = np.concatenate([planes.by_node.ravel(), planes.by_constant.ravel(), np.zeros(1)])

    def of_plan(self) -> tuple[np.ndarray | None, np.ndarray | None]:
        """See :meth:`wbmpc.mpc.mpc.MPC.input_rows`."""
        if not self.limits.offset.size:
            return None, None
        from wbmpc.solver.feedback import plan_rows

        solver, planes, p = self._solver, self.planes, self._solver.node_parameters
        n, r, width = len(p) - 1, self.limits.offset.size, planes.by_node.shape[1]
        active, moving = np.empty((n, r)), np.empty((n, 2, r))
        plan_rows(
            p, 0, n, p.shape[1], solver.constants, 0, solver.tables().integers, solver.problem.nu, self.limits.table, self.table,
            self.switches, r, int(planes.move), width, planes.by_constant.shape[1], np.empty(max(width, 1)), active, moving,
        )  # fmt: skip
        return active, moving if planes.move else None
