"""Whether the controller keeps up with time, and whether its robot still stands; what is wrong is said in words."""

from __future__ import annotations

import logging
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from wbmpc.ros2.clock import BusClock

if TYPE_CHECKING:
    from wbmpc.ros2.control import ControlNode

_LOG = logging.getLogger("wbmpc")
#: Figures are those of the last so many seconds.
WINDOW = 2.0
#: A controller is late that runs at less than this share of real time, or of whose ticks more than this share are late.
SLOW, OFTEN = 0.95, 0.05
#: How the reason of a stop for a fall begins.
FELL = "the robot fell"


class Health:
    """Of a controller's node; :meth:`update` is called now and then by its own thread.

    Of the last :data:`WINDOW`: ``factor``, the real-time factor, the time of the ticks that ran by that of the wall (NaN before it is
    known); with simulated time that of the simulator. ``late_ticks``: of ``due_ticks`` those that were skipped, and those whose
    command left late (:class:`wbmpc.runtime.statistics.Punctuality`). ``late`` and ``fell``: what is wrong, empty if nothing is.
    """

    def __init__(self, controller: ControlNode) -> None:
        self.controller = controller
        self.factor, self.late_ticks, self.due_ticks, self.late, self.fell = np.nan, 0, 0, "", ""
        self._began: tuple[Any, float, int, int, int] | None = None

    def update(self) -> None:
        """Judge again."""
        self._check_lean()  # first: what is late is forgotten where a run has ended
        self._check_timing()

    def _check_timing(self) -> None:
        c = self.controller
        runner, now = c.runner, time.perf_counter()
        if runner is None or not c.running or runner.plans.current is None:
            self._began, self.late = None, ""
            return
        counted = runner.punctuality.late, int(runner.own["skipped"]), int(runner.own["ticks"])
        began, self._began = self._began, (runner, now, *counted)
        if began is None or began[0] is not runner:
            return
        passed = now - began[1]
        if passed < WINDOW:
            self._began = began
            return
        late, skipped, ran = (new - old for new, old in zip(counted, began[2:], strict=True))
        self.factor, self.due_ticks = ran * c.period / passed, ran + skipped
        self.late_ticks = skipped + min(late, ran)  # the tick that runs is counted at its end
        self._judge(passed)

    def _judge(self, passed: float) -> None:
        """A simulator's time may be slow as it likes: it is the wall's that a robot does not wait for."""
        behind = self.factor < SLOW or self.late_ticks > OFTEN * self.due_ticks
        if isinstance(self.controller.clock, BusClock) or not behind:
            self.late = ""
            return
        message = f"{self.late_ticks} of {self.due_ticks} ticks were late in the last {passed:.1f} s"
        if not self.late:
            _LOG.warning("the controller is late: real-time factor %.2f, %s", self.factor, message)
        self.late = f"the controller is late: real-time factor {self.factor:.2f}, {message}"

    def _check_lean(self) -> None:
        """Only who balances falls, and only who has been balanced."""
        c = self.controller
        seen = c.adapter.snapshot() if c.adapter.must_keep_running and c.runner is not None else None
        if seen is None:
            self.fell = ""
            return
        fallen = c.adapter.fall(seen[1])
        if not fallen:
            self.fell = ""
        elif not self.fell:
            self.fell = f"{fallen}, because {self._cause()}"
            _LOG.error("%s", self.fell)

    def _cause(self) -> str:
        """What is known to have gone wrong before it fell, the first cause first."""
        c = self.controller
        assert c.runner is not None
        if c.runner.stopped and FELL not in c.runner.state:
            return c.runner.state
        known = [c.runner.kept, c.robot_io.fault, self.late, *c.adapter.faults]
        return "; ".join(filter(None, known)) or "the torques that it has could not catch it: no fault was found"

    def diagnostics(self) -> dict[str, str]:
        message = {"late": self.late, "fell": self.fell}
        known = {"real-time factor": f"{self.factor:.3f}", "late ticks": str(self.late_ticks)}
        return {**(known if np.isfinite(self.factor) else {}), **{k: v for k, v in message.items() if v}}
