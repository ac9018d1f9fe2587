"""Commands for legs and brakes of the controller's node: they start a robot that stands, and change the task of one that runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wbmpc.ros2.base_adapter import LegCommands
from wbmpc.ros2.convert import error_message
from wbmpc.stability.configurations import leg_group

if TYPE_CHECKING:
    from wbmpc.ros2.control import ControlNode

#: Brakes are scheduled this long before they are to act [s]: the control thread is never between two entries.
BRAKE_LEAD = 0.02


class LegControl:
    """``commands`` from the bus; None for a robot without hinged legs."""

    def __init__(self, control: ControlNode) -> None:
        self.control = control
        self.commands = control.adapter.leg_commands(control.node, self._rejection_reason, self._state)

    def _rejection_reason(self) -> str:
        """Why legs cannot be moved now; empty if they can."""
        return "" if self.control.running else self.control.waiting_reason()

    def _brake_time(self) -> float:
        """Time [s] from which on brakes can still be scheduled."""
        return self.control.clock.now() + BRAKE_LEAD

    def _legs(self, x: np.ndarray) -> np.ndarray:
        """The legs (n) [rad] of the state x (nx)."""
        robot = self.control.robot
        return x[robot.state[leg_group(robot)]]

    def _state(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Brakes (n, 1 = open) and legs (n) [rad] now; None before the first state."""
        control = self.control
        seen, brakes = control.adapter.snapshot(), control.adapter.brakes
        if seen is None or brakes is None:
            return None
        return brakes.commanded(self._brake_time() if control.running else 0.0), self._legs(seen[1])

    def update(self) -> None:
        """Take in what has come. The first command starts a robot that stands, and its base stays where it is."""
        control, commands = self.control, self.commands
        if commands is None or not (commands.waiting or control.running) or control.planning.busy or control.stopping:
            return
        seen = control.adapter.snapshot()
        if seen is None:
            return
        try:
            self.start_or_apply(commands, seen[1])
        except Exception as error:
            commands.drop()
            commands.reject(f"a command for the legs is rejected: {error_message(error)}")

    def start_or_apply(self, commands: LegCommands, x: np.ndarray) -> None:
        """At the state x (nx): start the run if there is none; then brakes, leg targets and references as commanded."""
        control, adapter = self.control, self.control.adapter
        if not control.running:
            if not commands.waiting:  # it has stopped just now
                return
            task = adapter.planner.hold(x, 0.0)
            control.start(x, task, adapter.references(task, x))
        assert adapter.brakes is not None
        leg, t = self._legs(x), self._brake_time()
        if commands.apply(adapter.brakes, t, leg):
            assert commands.angles is not None
            adapter.swing(commands.angles)
            self._follow_targets(commands, x)
        if commands.watch(adapter.brakes, t, leg):
            self._follow_targets(commands, x)

    def _follow_targets(self, commands: LegCommands, x: np.ndarray) -> None:
        """The active task, with the legs where they are to go now."""
        control = self.control
        control.adapter.legs = commands.aims
        assert control.active_task is not None
        control.set_task(control.active_task, control.adapter.references(control.active_task, x))
