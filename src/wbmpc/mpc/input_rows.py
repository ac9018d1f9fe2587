"""Straight hard rows of the inputs that policies hold their feedback to, in each interval of a plan."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from wbmpc.kernel.step import Step, bind
from wbmpc.mpc.policy import InputLimits
from wbmpc.ocp.input_rows import input_bounds, input_planes
from wbmpc.solver import Solver

if TYPE_CHECKING:
    from wbmpc.solver.receding import Tables


class InputRows:
    """``limits``: bounds and straight hard rows of the inputs, of all modes; ``switches`` (r,): which of a node's parameters turns
    each row on, −1 for always; ``table``: what parameters of the node and of the horizon add to offsets, one after the other."""

    def __init__(self, solver: Solver) -> None:
        self._solver = solver
        self.planes = planes = input_planes(solver.problem)
        self.limits = InputLimits(*input_bounds(solver.problem), planes.matrix, planes.offset)
        first = solver.problem.node.slices["switch"].start
        self.switches = np.append(np.where(planes.switches >= 0, planes.switches + first, -1), -1).astype(np.int64)
        self.table = np.concatenate([planes.by_node.ravel(), planes.by_constant.ravel(), np.zeros(1)])
        self._step: Step | None = None
        self._tables: Tables | None = None  # which the step reads

    def of_plan(self, t: float) -> tuple[np.ndarray | None, np.ndarray | None]:
        """See :meth:`wbmpc.mpc.mpc.MPC.input_rows`; ``t`` [s]: where the plan begins."""
        if not self.limits.offset.size:
            return None, None
        tables = self._solver.data.tables()
        if self._step is None or tables is not self._tables:
            self._step, self._tables = self._bound(tables), tables
        np.add(self._solver.trajectory(copy=False).grid, t, out=self._times)
        self._step()
        return self._active.copy(), self._moving.copy() if self.planes.move else None

    def _bound(self, tables: Tables) -> Step:
        """The compiled step on the solver's memory as it is now."""
        from wbmpc.solver.feedback import plan_rows

        solver, planes, p = self._solver, self.planes, self._solver.node_parameters
        n, r, width = len(p) - 1, self.limits.offset.size, planes.by_node.shape[1]
        self._active, self._moving, self._times = np.empty((n, r)), np.empty((n, 2, r)), np.empty(n + 1)
        arrays = {
            "p": p, "w": solver.constants, "times": self._times, "numbers": tables.numbers, "integers": tables.integers,
            "limits": self.limits.table, "rows": self.table, "switches": self.switches, "room": np.empty(max(width, 1)),
            "active": self._active, "moving": self._moving, **{name: np.zeros(0) for name in ("states", "inputs", "gains")},
        }  # fmt: skip
        sizes: dict[str, Any] = {
            "n": n,
            "nx": solver.problem.nx,
            "nu": solver.problem.nu,
            "r": r,
            "moves": int(planes.move),
        }
        sizes |= {"size": p.shape[1], "by_node": width, "by_constant": planes.by_constant.shape[1]}
        return bind(plan_rows, arrays, p_at=0, w_at=0, **sizes)
