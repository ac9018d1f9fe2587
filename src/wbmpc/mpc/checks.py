"""What an MPC asks of its settings, its problem's limits and of vectors."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence

import numpy as np

from wbmpc.checks import real_numbers
from wbmpc.errors import InputError, NotFinite
from wbmpc.logs import RateLimit
from wbmpc.ocp import ModeSchedule, OptimalControlProblem
from wbmpc.ocp.input_rows import nonlinear_rows
from wbmpc.ocp.problem import check_problem
from wbmpc.solver import SQP, Solver, Status
from wbmpc.solver.events import one_jump
from wbmpc.solver.settings import check_settings_type

_LOG = logging.getLogger("wbmpc")


class PlanCheck:
    """Of the solves of one ``solver``, one after the other; ``lines`` limits what it logs."""

    def __init__(self, solver: Solver, lines: RateLimit) -> None:
        self._solver, self._lines = solver, lines
        self._broken = 0  # passes in a row that ended with numbers that are not finite
        self._faults = 0  # passes in a row without a plan, whatever the reason

    def reason(self, code: int) -> str:
        """Why the last pass, which ended with a status ``code``, gave no plan; empty if it did."""
        return self._not_finite_part(code) or self._rejection(code)

    def broken(self, code: int) -> bool:
        """Whether the last pass ended with numbers that are not finite or beyond all bounds."""
        return bool(self._not_finite_part(code))

    def fault(self, t: float, code: int) -> str:
        """The same of a pass at ``t`` [s] that counts; the first of a row of them is logged."""
        broken = self._not_finite_part(code)
        self._broken = self._broken + 1 if broken else 0
        found = broken or self._rejection(code)
        self._faults = self._faults + 1 if found else 0
        if self._faults == 1:
            cause = "not finite" if broken else self._solver.status(code).value
            self._lines.log(_LOG, logging.WARNING, cause, f"MPC at {t:.3f} s: {found}")
        return found

    def recovery(self, code: int) -> int:
        """What the next pass starts from: see :data:`wbmpc.solver.controller.RESTART` and ``RESUME``."""
        from wbmpc.solver.controller import recovery

        return int(recovery.python(code, self._broken, self._faults))

    def _not_finite_part(self, code: int) -> str:
        """What of the last pass is not finite or beyond all bounds; empty if nothing is."""
        status = self._solver.status(code)
        if status in (Status.NOT_FINITE, Status.DIVERGED):
            return status.value
        bad = self._solver.non_finite_part()
        return f"failed: the {bad} is not finite" if bad else ""

    def _rejection(self, code: int) -> str:
        """Which limit or equality the last plan misses so that it is not used; empty if none."""
        status = self._solver.status(code)
        rejected = status in (Status.INPUT_INFEASIBLE, Status.EQUALITY_INFEASIBLE)
        return f"{status.value} ({self._solver.violation_message(status)})" if rejected else ""


def check_settings(ocp: OptimalControlProblem, settings: SQP) -> None:
    """Raise :class:`InputError` for settings under which nothing would say that a plan misses hard limits or equalities,
    and for what is no problem or are no settings."""
    check_problem("mpc", ocp)
    check_settings_type("mpc, solver", settings)
    limits = any(term.hard for term in ocp.inequalities)
    unreported = limits and settings.interior_point.mode != "real_time"
    if unreported or (settings.compute_kkt and (limits or ocp.equalities)):
        name = type(settings).__name__
        raise InputError(
            f"mpc: {name}(compute_kkt={settings.compute_kkt}, interior point '{settings.interior_point.mode}') does not say in every plan"
            f" by how much it misses constraints; valid: {name}.real_time(...), with as many iterations as you like"
        )


def check_limits(solver: Solver, rates: Iterable[str]) -> None:
    """Raise :class:`InputError` for a hard row of inputs that no policy can hold. The terms named in ``rates`` limit how fast inputs
    change; they count for plans alone, because a policy does not know the last command."""
    rows = nonlinear_rows(solver.problem)
    unheld = [row for row in rows if not any(row.startswith(f"{name}.") for name in rates)]
    if unheld:
        raise InputError(
            f"mpc: hard row '{unheld[0]}' limits inputs in a way that is not linear: a policy's feedback cannot be held to it; "
            "valid: rows that are linear in inputs and references, hard=False, or MPC(..., plan_only_limits=True), where your "
            "own code limits what the feedback adds"
        )


def check_vector(where: str, names: Sequence[str], value: np.ndarray) -> None:
    """Raise :class:`InputError` unless ``value`` has one finite number for each name."""
    vector = real_numbers(where, value)
    if vector.shape != (len(names),):
        raise InputError(f"{where}: {len(names)} numbers are needed, got shape {vector.shape}")
    if not np.isfinite(vector).all():
        raise NotFinite(f"{where}: '{names[int(np.argmax(~np.isfinite(vector)))]}' is not finite")


def check_events_fit(solver: Solver, schedule: ModeSchedule, since: float) -> None:
    """Raise :class:`InputError` if plans from ``since`` [s] on cannot follow the events of a schedule."""
    ocp = solver.ocp
    nodes = ocp.intervals - 1
    events = np.array([t for t in schedule.events if t > since])
    if not ocp.align_events:
        close = np.flatnonzero(np.diff(events) < np.diff(ocp.grid).max() - 2e-9)
        if solver.problem.jumps and close.size:
            raise InputError(one_jump(*events[close[0] : close[0] + 2]))
        return
    first, last = events[: max(events.size - nodes, 0)], events[nodes:]
    crowded = np.flatnonzero(last - first < ocp.horizon - 2e-6)
    if crowded.size:
        i = crowded[0]
        raise InputError(
            f"mode schedule: {nodes + 1} events from {first[i]:g} to {last[i]:g} s are within one horizon, but it has"
            f" {nodes} inner nodes: more intervals are needed"
        )
