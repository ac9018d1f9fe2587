"""Commands for legs and brakes of the controller's node: they start a robot that stands, and change the task of one that runs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from wbmpc.bases.swerve.ros_legs import Legs
from wbmpc.ros2.base_adapter import BaseCommands
from wbmpc.ros2.convert import error_message

if TYPE_CHECKING:
    from wbmpc.bases.swerve.ros import SwerveRosAdapter
    from wbmpc.ros2.control import ControlNode

#: Brakes are scheduled this long before they are to act [s]: the control thread is never between two entries.
BRAKE_LEAD = 0.02


class LegControl(BaseCommands):
    """``commands`` from the bus for the hinged legs of a robot."""

    def __init__(self, control: ControlNode, adapter: SwerveRosAdapter) -> None:
        self.control, self.adapter = control, adapter
        self._came = np.inf  # when [s] the last command came
        self._changed = False  # where legs are to go, since the goal was taken that is being planned
        self.commands = Legs(control.node, adapter.robot, adapter.settings, self._rejection_reason, self._state)

    def _rejection_reason(self) -> str:
        """Why a command that comes now cannot move legs; empty if it can."""
        control = self.control
        why = control.hold_ups.too_old("the command") or ("" if control.running else control.waiting_reason())
        if not why:
            self._came = control.hold_ups.wall()
        return why

    def _brake_time(self) -> float:
        """Time [s] from which on brakes can still be scheduled."""
        return self.control.clock.now() + BRAKE_LEAD

    def _legs(self, x: np.ndarray) -> np.ndarray:
        """The legs (n) [rad] of the state x (nx)."""
        return x[self.adapter.robot.state["leg"]]

    def _state(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Brakes (n, 1 = open) and legs (n) [rad] now; None before the first state."""
        control = self.control
        seen, brakes = self.adapter.snapshot(), self.adapter.brakes
        if seen is None or brakes is None:
            return None
        return brakes.commanded(self._brake_time() if control.running else 0.0), self._legs(seen[1])

    def update(self) -> None:
        """Take in what has come. The first command starts a robot that stands, and its base stays where it is. While a goal is planned commands
        wait, but legs that arrive do not."""
        control, commands = self.control, self.commands
        waits = commands.waiting and not control.planning.busy
        if not (waits or control.running) or control.stopping:
            return
        seen = self.adapter.snapshot()
        if seen is None:
            return
        was = control.request_queue.running  # also of a run whose stop has not been seen yet
        try:
            if waits:
                control.hold_ups.check(self._came)
            self.start_or_apply(seen[1])
        except Exception as error:
            if not waits:
                raise  # of a run, not of a command
            control.request_queue.running = control.request_queue.running if control.running else was
            commands.drop()
            commands.reject(f"a command for the legs is rejected: {error_message(error)}")

    def start_or_apply(self, x: np.ndarray) -> None:
        """At the state x (nx): start the run if there is none; then brakes, leg targets and references as commanded."""
        control, adapter, commands = self.control, self.adapter, self.commands
        if not control.running:
            if not commands.waiting or control.planning.busy:  # it has stopped just now
                return
            task = adapter.planner.hold(x, 0.0)
            control.start(x, task, adapter.references(task, x))
        assert adapter.brakes is not None
        leg, t, busy = self._legs(x), self._brake_time(), control.planning.busy
        changed = self._changed and not busy  # the plan's references are of before
        if not busy and commands.apply(adapter.brakes, t, leg):
            assert commands.angles is not None
            adapter.swing(commands.angles)
            changed = True
        if commands.watch(adapter.brakes, t, leg) or changed:
            self._follow_targets(x)

    def _follow_targets(self, x: np.ndarray) -> None:
        """The active task, with the legs where they are to go now."""
        control, adapter = self.control, self.adapter
        self._changed = control.planning.busy
        adapter.legs = self.commands.aims
        assert control.active_task is not None
        control.set_task(control.active_task, adapter.references(control.active_task, x))

    def stop(self, had_task: bool) -> None:
        """Commands of before a stop do not count after it."""
        if had_task and self.commands.waiting:
            self.commands.drop()
            self.commands.reject("a command for the legs is rejected: the robot has stopped meanwhile")
        self.commands.stop()
        self._changed = False

    def rejections(self) -> dict[str, str]:
        """Commands that were not taken, and legs that have ended on their way."""
        return {"rejected command for the legs": self.commands.rejected, "legs stopped short": self.commands.short}

    def counts(self) -> dict[str, Any]:
        """How often the guard has held a leg."""
        return {"legs held": self.adapter.controller.holds}
