"""The base type ``fixed``: a table, a wall or a ceiling that carries an arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import mujoco

from wbmpc.bases.base import Calibration, Proposal
from wbmpc.bases.common.plugin import SpeedBaseType
from wbmpc.bases.fixed.description import FixedBaseDescription
from wbmpc.bases.fixed.model import FixedBase
from wbmpc.model.robot import RobotModel
from wbmpc.model.tree import read_tree
from wbmpc.robots import RobotDescription

if TYPE_CHECKING:
    from wbmpc.control.direct import DirectController
    from wbmpc.mpc.mpc import MPC
    from wbmpc.robots.mechanism import Mechanism
    from wbmpc.robots.wheel_search import Wheel


class FixedBaseType(SpeedBaseType):
    """What generic code may ask of robots whose base does not move."""

    Description = FixedBaseDescription
    parts: ClassVar[Mapping[str, str]] = {
        "perturbation": "simulation.perturbation:ArmPerturbation", "plant": "bases.fixed.plant:FixedPlant",
        "ros_settings": "bases.common.ros_settings:FixedRosSettings", "ros": "bases.fixed.ros:FixedRosAdapter",
        "ros_plant": "bases.fixed.ros_plant:FixedRosPlant",
    }  # fmt: skip

    def check(self, description: RobotDescription, model: mujoco.MjModel) -> None:
        """Any body can stand still."""

    def propose(self, mechanism: Mechanism, wheels: Sequence[Wheel]) -> Proposal:
        """Everything can stand still; a robot on wheels should not."""
        reason = "its wheels stand still" if wheels else "no wheels"
        return Proposal({}, 0.1 if wheels else 0.9, reason)

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> FixedBase:
        """The arm's tree on the body's pose in the file."""
        model = spec.compile()
        data, body = mujoco.MjData(model), model.body(description.base.body).id
        mujoco.mj_kinematics(model, data)
        tree = read_tree(spec, description.base.body)
        return FixedBase(description, tree, data.xpos[body].copy(), data.xquat[body].copy())

    def controller(
        self, robot: RobotModel, mpc: MPC, plant: Any, period: float, calibration: Calibration | None
    ) -> DirectController:
        from wbmpc.control.direct import DirectController
        from wbmpc.settings import ACTUATOR_TIME_CONSTANT

        return DirectController(robot, mpc, period, ACTUATOR_TIME_CONSTANT, rate=robot.limits.input_rate)
