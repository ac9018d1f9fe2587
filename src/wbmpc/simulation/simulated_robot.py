"""What views and runs ask of a simulated robot beside what controllers do."""

from __future__ import annotations

from typing import Any, Protocol

import mujoco

from wbmpc.arrays import Array
from wbmpc.robots import RobotDescription
from wbmpc.types import Plant


class SimulatedRobot(Plant[Any, Any], Protocol):
    """A plant that can be shown: its robot's ``description``, MuJoCo's ``model`` and ``data``, and ``world.frames(height)`` (see
    :class:`wbmpc.simulation.world.World`)."""

    @property
    def description(self) -> RobotDescription: ...

    @property
    def model(self) -> mujoco.MjModel: ...

    @property
    def data(self) -> mujoco.MjData: ...

    @property
    def world(self) -> Any: ...

    def push(self, force: Array) -> None:
        """Push the base with a force (3) [N] until changed."""

    def arrange(self, state: Array) -> None:
        """Put the bodies where a state (nx) has them."""
