"""What a user of the view may do to joints that brakes hold, such as hinges of legs: a configuration by name, brakes open or closed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, cast

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.optional import ChecksBrakes
from wbmpc.control.protocols import RobotController
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Mode, ModeSchedule, Reference
from wbmpc.simulation.lockstep import Running
from wbmpc.stability import configuration_positions, configurations
from wbmpc.view import bounds

#: Joints are where they should be within this [rad]; then their brakes close.
_THERE = 0.01


class _Braked(RobotController, Protocol):
    """A controller of joints with brakes also takes ``brakes(t)`` (n, 1 = open)."""

    brakes: Callable[[float], Array]


def braked_joints(mpc: MPC | None) -> tuple[str, str] | None:
    """Brakes of the base that the problem knows as a mode: the group of the mode, and the group of joints that they hold. None: there are
    none."""
    if mpc is None:
        return None
    inner = mpc.dynamics
    while hasattr(inner, "dynamics"):  # of wrappers
        inner = inner.dynamics
    held = getattr(getattr(inner, "base", None), "brakes", {}).items()
    return next(((b, j) for b, j in held if b in mpc.dynamics.mode and j in mpc.dynamics.state), None)


class BrakedJoints:
    """Applies commands to the ``joints`` of one run that the ``brakes`` hold: groups of the problem's state and mode."""

    def __init__(self, mpc: MPC, controller: _Braked, brakes: str, joints: str) -> None:
        self._mpc, self._controller, self._brakes, self._joints = mpc, controller, brakes, joints
        self._part = mpc.dynamics.state[joints]
        self._target: Array | None = None

    @classmethod
    def of(cls, running: Running) -> BrakedJoints | None:
        """None where there are no such joints."""
        groups = braked_joints(running.mpc)
        if running.mpc is None or groups is None:
            return None
        return cls(running.mpc, cast(_Braked, running.controller), *groups)

    def configure(self, number: Array) -> None:
        """Go to a configuration by its place among the robot's; :class:`InputError` if there is none, or joints do not reach it."""
        robot = self._controller.robot
        names = list(configurations(robot))
        self._move(configuration_positions(robot, names[bounds.choice("configuration", number, len(names))]))

    def _move(self, angles: Array) -> None:
        """To ``angles`` (n) [rad] from now on; a base that is on its way goes on along its path."""
        self._refer("state", self._part, angles)
        layout = self._mpc.dynamics.input
        if "input" in self._mpc.reference and self._joints in layout:
            self._refer("input", layout[self._joints], 0.0)
        self._target = angles
        self._set_brakes(True)

    def _refer(self, name: str, part: slice, values: Array | float) -> None:
        """Part of a reference becomes constant."""
        reference = self._mpc.reference[name]
        changed = reference.values.copy()
        changed[:, part] = values
        self._mpc.reference[name] = Reference(reference.times, changed, reference.kind)

    def click(self, is_open: bool) -> None:
        """Brakes opened or closed by hand; where they would hold the base against nothing, :class:`InputError`."""
        base = self._controller.robot.base
        if is_open and isinstance(base, ChecksBrakes):
            positions = self._controller.state()[self._part]
            base.check_brakes(positions, np.ones(positions.size))
        self._target = None
        self._set_brakes(is_open)

    def update(self) -> None:
        """Close the brakes of joints that have come to where they should be."""
        if self._target is not None and np.abs(self._controller.state()[self._part] - self._target).max() < _THERE:
            self._target = None
            self._set_brakes(False)

    def are_open(self, t: float) -> bool:
        """Whether all brakes are commanded to be open at time t [s]."""
        return bool(np.all(self._controller.brakes(t) > 0.5))

    def _set_brakes(self, is_open: bool) -> None:
        values = np.full(self._part.stop - self._part.start, float(is_open))
        mode = Mode("brakes open" if is_open else "brakes closed", {self._brakes: tuple(values)})
        self._mpc.set_schedule(ModeSchedule((mode,)))
        self._controller.brakes = lambda t: values
