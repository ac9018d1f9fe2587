"""Clearance rows of an MPC: set before every solve, watched after it; plans that would run into something are replaced."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from wbmpc.arrays import Array
from wbmpc.clearance.nearest import with_sides
from wbmpc.clearance.rows import Clearance as LeastClearance
from wbmpc.clearance.rows import ObstacleRows, SelfRows
from wbmpc.errors import InputError
from wbmpc.mpc.braking import BrakingPlan, braking_plan, braking_time
from wbmpc.mpc.guess import predicted
from wbmpc.obstacles.world import Obstacles, Snapshot
from wbmpc.ocp import OptimalControlProblem, Reference
from wbmpc.ocp.symbols import KeepsClear
from wbmpc.solver import Solver, Trajectory
from wbmpc.solver.warm_start import restart_from, take_as_result

#: Share of a margin that a plan may lack before it is replaced: one iteration misses rows by some of it.
TOLERATED = 0.5
#: A plan that penetrates by less than this [m] more than the current one is no worse.
DEEPER = 0.003
#: Solves from a braking plan, and the barriers of the interior point: with a small one from the start its steps are cut where many
#: rows become active at once.
BRAKING_SOLVES, FIRST_BARRIER, BARRIER_SHARE = 5, 0.1, 0.4
#: What is left [s] of a stop that should have ended.
ENDING = 0.01
#: Of plans that run into something later than that: how long [s] they do before another one is sought, how long [s] from one search to
#: the next, and how much [m] clearer than the present plan it has to be.
LATER, AGAIN, CLEARER = 0.06, 0.1, 0.05
#: A plan has to be clear from now on for the duration of a stop and so much longer [s].
REACTION = 0.2


class ClearanceRows:
    """The clearance terms of a problem. ``obstacles``: what they keep clear of; ``active``: whether there are any terms, ``around`` it and
    ``within`` the robot, by name; ``last``: the least clearance of the last plan."""

    def __init__(self, ocp: OptimalControlProblem, solver: Solver, obstacles: Obstacles | None) -> None:
        self._solver, self.obstacles = solver, obstacles
        none = np.zeros(0)
        clear: dict[str, Any] = {n: t.residual for n, t in ocp.terms.items() if isinstance(t.residual, KeepsClear)}
        self.around = {n: ObstacleRows(r) for n, r in clear.items() if r.clear_of == "obstacles"}
        self.within = {n: SelfRows(r) for n, r in clear.items() if r.clear_of == "self"}
        self.active = bool(self.around or self.within)
        self.last = LeastClearance()
        #: when the stop ends [s] that the last plan is; None: it is none
        self._stops_at: float | None = None
        #: when [s] another plan is searched for, and how many have found none; None: the last plan is clear
        self._search: tuple[float, int] | None = None
        self._snapshot = Snapshot()
        #: time and age, states of the plan, and what was predicted from it
        self._predicted: tuple[tuple[float, float], Array, tuple[Array, Array]] = (np.nan, np.nan), none, (none, none)
        if self.around and obstacles is None:
            raise InputError(
                f"mpc: term '{next(iter(self.around))}' needs obstacles: MPC(ocp, obstacles=wb.Obstacles())"
            )
        if obstacles is not None and not self.around:
            raise InputError(
                "mpc: obstacles are given, but no term keeps clear of them; valid: a hard residuals.Clearance"
            )
        self.robot: Any = next((r.robot for r in clear.values()), None)

    # ------------------------------------------------------------------ before a solve
    def update_snapshot(self, t: float) -> None:
        """Take the obstacles as they are at ``t`` [s]."""
        if self.obstacles is not None:
            self._snapshot = with_sides(self.obstacles.snapshot(t))

    def predicted(self, t: float, delta: float) -> tuple[Array, Array]:
        """See :func:`wbmpc.mpc.guess.predicted`; before a solve it is asked for twice of one plan."""
        plan, (key, last, found) = self._solver.trajectory(copy=False), self._predicted
        if key != (t, delta) or not np.array_equal(plan.x, last):
            found = predicted(self._solver, t, delta)
            self._predicted = (t, delta), plan.x.copy(), found
        return found

    def refresh(self, t: float, delta: float) -> None:
        """Set all rows for a solve at ``t`` [s] that goes on from a plan which is ``delta`` [s] old."""
        times, states = self.predicted(t, delta)
        for name, rows in self.around.items():
            self._solver.set_reference(name, Reference(times, rows.refresh(self._snapshot, times, states)))
        for name, own in self.within.items():
            self._solver.set_reference(name, Reference(times, own.refresh(states)))

    # ------------------------------------------------------------------ after a solve
    def measure(self, t: float) -> None:
        """Measure the plan of a solve at ``t`` [s]: the pair that lacks most of its margin is ``last``."""
        plan = self._solver.trajectory(copy=False)
        times, states = t + plan.grid, plan.x
        found = [r.clearance(self._snapshot, times, states) for r in self.around.values()]
        found += [r.clearance(times, states) for r in self.within.values()]
        self.last = min(found, key=lambda c: c.excess)

    def unsafe(self, times: Array, states: Array, until: float) -> LeastClearance | None:
        """Where a plan comes much too near to something before ``until`` [s], and nearer than it is at its first node; None: nowhere."""
        count = max(int(np.searchsorted(times, until, side="right")), 2)
        share = 1.0 - TOLERATED
        found = [r.deepest(times, states, count, share, DEEPER) for r in self.within.values()]
        times, states = times[:count], states[:count]
        found += [r.deepest(self._snapshot, times, states, share * r.margin, DEEPER) for r in self.around.values()]
        return min((c for c in found if c is not None), key=lambda c: c.distance, default=None)

    def evades(self, times: Array, states: Array) -> bool:
        """See :meth:`wbmpc.mpc.mpc.MPC.evades`."""
        moving = tuple(o for o in self._snapshot.obstacles if o.velocity.any())
        world = Snapshot(moving, self._snapshot.frames)
        around = self.around.values() if moving else ()
        return all(r.deepest(world, times, states, (1.0 - TOLERATED) * r.margin, DEEPER) is None for r in around)

    # ------------------------------------------------------------------ solves that end clear, or in a stop
    def solve(
        self, t: float, x0: Array, delta: float | None, passes: int, run: Callable[[float, int], None],
        unusable: Callable[[], bool],
    ) -> LeastClearance | None:  # fmt: skip
        """Solve at ``t`` [s] from ``x0`` (nx) with ``run(age of the last plan [s], passes)``; ``delta`` is that age, None of the first plan.

        Where the robot would come much too near to something before it can stop, solve from a plan that stops, with more passes. If that
        does not help, the stop is the result: what it is for is returned. A robot that falls when it stands is not stopped.
        """
        self.update_snapshot(t)
        if delta is None or self.robot.base.balances:
            self._stops_at = self._search = None  # of plans that are forgotten
            run(delta or 0.0, passes)
            self.measure(t)
            return None
        duration, stop = self._braking(t, x0, delta)
        until, self._stops_at = t + duration + REACTION, None
        cause = self.unsafe(*self.predicted(t, delta), until)
        if cause is None:
            run(delta, passes)
            cause = self._runs_into(t, until)
        if cause is not None and self._avoided(t, stop(), until, run, unusable):
            cause = None
        if cause is not None:
            self._stops_at = t + duration
        self.measure(t)
        return cause

    def _runs_into(self, t: float, until: float) -> LeastClearance | None:
        plan = self._solver.trajectory(copy=False)
        return self.unsafe(t + plan.grid, plan.x, until)

    def _avoided(
        self, t: float, stop: BrakingPlan, until: float, run: Callable[[float, int], None], unusable: Callable[[], bool]
    ) -> bool:
        """Whether solves from a stop find a plan that is clear, or clearer than the stop; else the stop is the result."""
        self._restart(stop.x, stop.u, run)
        found = self._runs_into(t, until)
        standing = self.unsafe(t + self._solver.node_times(t), stop.x, until)
        clearer = found is None or (standing is not None and standing.distance <= found.distance)
        if clearer and not unusable():
            return True
        take_as_result(self._solver, stop.x, stop.u)
        return False

    def _restart(self, x: Array, u: Array, run: Callable[[float, int], None]) -> None:
        """Solve from states x (N + 1, nx) and inputs u (N, nu) of now, with slacks and multipliers that restart."""
        restart_from(self._solver, x, u)
        for k in range(BRAKING_SOLVES):
            with self._solver.barrier(FIRST_BARRIER * BARRIER_SHARE**k):
                run(0.0, 1)

    def search_is_due(self, t: float) -> bool:
        """Whether the plan of a solve at ``t`` [s] runs into something, if only later than the robot can stop, as plans have done for a while:
        slacks that are used up in rows which exclude each other hold a plan where it is, however many iterations follow."""
        if self.robot.base.balances or self._stops_at is not None or self._runs_into(t, np.inf) is None:
            self._search = None
            return False
        if self._search is None:
            self._search = t + LATER, 0
        return t >= self._search[0] - 1e-9

    def search(
        self, t: float, x0: Array, plan: Trajectory, run: Callable[[float, int], None], unusable: Callable[[], bool]
    ) -> bool:
        """Solve at ``t`` [s] from ``x0`` (nx) once more: from the ``plan`` that is there, the next time from a stop. Whether what comes of it
        is clear, or clearer by :data:`CLEARER`; if not, the solver has lost the plan."""
        assert self._search is not None
        before, (_, count) = self._runs_into(t, np.inf), self._search
        start = plan if count % 2 == 0 else self._braking(t, x0, 0.0)[1]()
        self._restart(start.x, start.u, run)
        found = self._runs_into(t, np.inf)
        clearer = before is None or found is None or found.distance > before.distance + CLEARER
        taken = clearer and not unusable()
        self._search = t + AGAIN, 0 if taken else count + 1
        return taken

    def _braking(self, t: float, x0: Array, delta: float) -> tuple[float, Callable[[], BrakingPlan]]:
        """How long [s] a stop from ``x0`` (nx) at ``t`` [s] takes under the input that the last plan, ``delta`` [s] old, has then, and
        what makes its plan. A stop that has begun goes on: it does not take longer because it is replanned."""
        solver, u0 = self._solver, self._input(delta)
        duration = braking_time(solver.ocp.dynamics, self.robot, x0, u0)
        if self._stops_at is not None:
            duration = min(duration, max(self._stops_at - t, ENDING))
        return duration, lambda: braking_plan(solver, x0, u0, solver.node_times(t), duration)

    def _input(self, delta: float) -> Array:
        plan = self._solver.trajectory(copy=False)
        k = min(int(np.searchsorted(plan.grid, delta + 1e-9, side="right")) - 1, len(plan.u) - 1)
        return plan.u[k].copy()
