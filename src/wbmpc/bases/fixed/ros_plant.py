"""The simulated arm on a base that does not move, on a ROS 2 bus: speeds in, encoders out."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.optional import mounting
from wbmpc.constants import GRAVITY
from wbmpc.control.direct import InputCommand
from wbmpc.ros2.plants import Reading, RosPlant
from wbmpc.types import Truth

#: What an accelerometer at rest says [m/s²].
_GRAVITY = np.array([0.0, 0.0, GRAVITY])


class FixedRosPlant(RosPlant):
    """Of speeds; the inertial unit is one at rest."""

    def rest(self) -> dict[str, Array]:
        return {"arm": np.zeros(self.robot.input.size)}

    def command(self, groups: dict[str, Array]) -> InputCommand:
        return InputCommand(groups["arm"], np.zeros(1))

    def read(self) -> Reading:
        self.last = Reading({"wheel": np.zeros(0), "arm": self.plant.measure().state}, np.zeros(3), _GRAVITY)
        return self.last

    def base(self, truth: Truth) -> tuple[Array, Array]:
        return mounting(self.robot.base)
