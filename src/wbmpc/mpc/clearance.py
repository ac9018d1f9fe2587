"""Clearance rows of an MPC: set before every solve, watched after it; plans that would run into something are replaced."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wbmpc.errors import InputError
from wbmpc.mpc.braking import BrakingPlan, braking_plan, braking_time
from wbmpc.obstacles.rows import Clearance as LeastClearance
from wbmpc.obstacles.world import Obstacles, Snapshot
from wbmpc.ocp import OptimalControlProblem, Reference, residuals
from wbmpc.solver import Solver

Array = NDArray[np.float64]
_TERMS = (residuals.Clearance, residuals.SelfClearance)
#: Share of a margin that a plan may lack before it is replaced: one iteration misses rows by some of it.
TOLERATED = 0.5
#: Less than this [m] deeper than now is no deeper.
DEEPER = 0.003
#: Solves from a braking plan before one is taken as it is.
BRAKING_SOLVES = 5
#: A plan has to be clear from now on for the duration of a stop and so much longer [s].
REACTION = 0.2


class ClearanceRows:
    """The clearance terms of a problem. ``active``: whether there are any; ``last``: the least clearance of the last plan."""

    def __init__(self, ocp: OptimalControlProblem, solver: Solver, obstacles: Obstacles | None) -> None:
        self._solver, self._obstacles = solver, obstacles
        terms = {name: term.residual for name, term in ocp.terms.items()}
        self._around = {n: r for n, r in terms.items() if isinstance(r, residuals.Clearance)}
        self._within = {n: r for n, r in terms.items() if isinstance(r, residuals.SelfClearance)}
        self.active = bool(self._around or self._within)
        self.last = LeastClearance()
        self._snapshot = Snapshot()
        if self._around and obstacles is None:
            raise InputError(
                f"mpc: term '{next(iter(self._around))}' needs obstacles: MPC(ocp, obstacles=wb.Obstacles())"
            )
        if obstacles is not None and not self._around:
            raise InputError(
                "mpc: obstacles are given, but no term keeps clear of them; valid: a hard residuals.Clearance"
            )
        self.robot: Any = next((r.robot for r in terms.values() if isinstance(r, _TERMS)), None)

    # ------------------------------------------------------------------ before a solve
    def look(self, t: float) -> None:
        """Take the obstacles as they are at ``t`` [s]."""
        if self._obstacles is not None:
            self._snapshot = self._obstacles.snapshot(t)

    def predicted(self, t: float, delta: float) -> tuple[Array, Array]:
        """Times (N + 1) [s] of the next solve's nodes, and where the last plan, ``delta`` [s] old, is then (N + 1, nx)."""
        grid, plan = self._solver.node_times(t), self._solver.trajectory(copy=False)
        at = np.minimum(grid + delta, plan.grid[-1])
        k = np.clip(np.searchsorted(plan.grid, at, side="right") - 1, 0, len(plan.grid) - 2)
        share = ((at - plan.grid[k]) / (plan.grid[k + 1] - plan.grid[k]))[:, None]
        return t + grid, (1.0 - share) * plan.x[k] + share * plan.x[k + 1]

    def refresh(self, t: float, delta: float) -> None:
        """Set all rows for a solve at ``t`` [s] that goes on from a plan which is ``delta`` [s] old."""
        times, states = self.predicted(t, delta)
        for name, term in self._around.items():
            self._solver.set_reference(name, Reference(times, term.rows.refresh(self._snapshot, times, states)))
        for name, own in self._within.items():
            self._solver.set_reference(name, Reference(times, own.rows.refresh(states)))

    # ------------------------------------------------------------------ after a solve
    def measure(self, t: float) -> None:
        """Measure the plan of a solve at ``t`` [s]: the pair that lacks most of its margin is ``last``."""
        plan = self._solver.trajectory(copy=False)
        times, states = t + plan.grid, plan.x
        found = [r.rows.clearance(self._snapshot, times, states) for r in self._around.values()]
        found += [r.rows.clearance(times, states) for r in self._within.values()]
        self.last = min(found, key=lambda c: c.excess)

    def unsafe(self, times: Array, states: Array, until: float) -> LeastClearance | None:
        """Where a plan comes much too near to something before ``until`` [s], and nearer than it is at its first node; None: nowhere."""
        count = max(int(np.searchsorted(times, until, side="right")), 2)
        times, states = times[:count], states[:count]
        share = 1.0 - TOLERATED
        found = [
            r.rows.deepest(self._snapshot, times, states, share * r.rows.margin, DEEPER) for r in self._around.values()
        ]
        found += [r.rows.deepest(times, states, share * r.rows.margin, DEEPER) for r in self._within.values()]
        return min((c for c in found if c is not None), key=lambda c: c.distance, default=None)

    def braking(self, t: float, x0: Array, delta: float) -> Callable[[], BrakingPlan]:
        """What makes the plan of a stop from ``x0`` (nx) at ``t`` [s] under the input that the last plan, ``delta`` [s] old, has then."""
        u0 = self._input(delta)
        return lambda: braking_plan(self._solver, self.robot, x0, u0, self._solver.node_times(t))

    def stopping_time(self, x0: Array, delta: float) -> float:
        """How long [s] that stop takes."""
        return braking_time(self._solver.ocp.dynamics, self.robot, x0, self._input(delta))

    def _input(self, delta: float) -> Array:
        plan = self._solver.trajectory(copy=False)
        k = min(int(np.searchsorted(plan.grid, delta + 1e-9, side="right")) - 1, len(plan.u) - 1)
        return plan.u[k].copy()
