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
        # rows of some modes: where they are among all, and the parameters that switch them
        self._switched = np.flatnonzero(planes.switches >= 0)
        self._switches = planes.switches[self._switched] + solver.problem.node.slices["switch"].start
        self.switches = np.full(max(planes.offset.size, 1), -1, dtype=np.int64)
        self.switches[self._switched] = self._switches
        self.table = np.concatenate([planes.by_node.ravel(), planes.by_constant.ravel(), np.zeros(1)])

    def of_plan(self) -> tuple[np.ndarray | None, np.ndarray | None]:
        """See :meth:`wbmpc.mpc.mpc.MPC.input_rows`."""
        if not self.limits.offset.size:
            return None, None
        nodes = self._solver.node_parameters[:-1]  # of the solver's grid, which may be finer than the problem's
        active = np.ones((len(nodes), self.limits.offset.size))
        active[:, self._switched] = nodes[:, self._switches]
        return active, self._moving() if self.planes.move else None

    def _moving(self) -> np.ndarray:
        """Offsets (N, 2, r): what is linear in time at the nodes goes on to the next one, all else holds over an interval."""
        solver, planes = self._solver, self.planes
        nodes = solver.node_parameters[:, : planes.by_node.shape[1]]
        ends = nodes[:-1].copy()
        for name, reference in solver.references.items():
            if reference.kind == "linear":
                part = solver.problem.node.slices[f"reference.{name}"]
                ends[:, part] = nodes[1:, part]
        fixed = planes.offset + planes.by_constant @ solver.constants[: planes.by_constant.shape[1]]
        return np.stack([nodes[:-1], ends], axis=1) @ planes.by_node.T + fixed
