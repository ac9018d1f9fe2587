"""Whether what a solve leaves is a plan, and what the next solve starts from where it is none."""

from __future__ import annotations

import logging

from wbmpc.logs import RateLimit
from wbmpc.solver import Solver, Status

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
