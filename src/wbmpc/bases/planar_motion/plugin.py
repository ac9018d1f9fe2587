"""What the plug-ins of base types on fixed wheels have in common."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import mujoco
import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.base import Base, Calibration
from wbmpc.bases.common.plugin import SpeedBaseType
from wbmpc.bases.planar_motion.calibration import fit_errors
from wbmpc.bases.planar_motion.model import PlanarBase, planar_base
from wbmpc.bases.planar_motion.wheel_errors import WheelErrors
from wbmpc.bases.planar_motion.wheels import FixedWheels, check_wheels, read_wheels, wheel_radius
from wbmpc.model.robot import RobotModel
from wbmpc.model.tree import Tree, read_tree
from wbmpc.robots import RobotDescription
from wbmpc.robots.findings import Finding

if TYPE_CHECKING:
    from wbmpc.bases.planar_motion.controller import PlanarController
    from wbmpc.mpc.mpc import MPC

#: Condition of the wheel matrix, turns counted at the wheels' distance, above which it is reported.
ILL = 20.0


class PlanarBaseType(SpeedBaseType):
    """Checks and system; a base type adds ``Description``, ``model`` and the part ``plant``."""

    calibration_channels = ("wheel", "steer")
    parts: ClassVar[Mapping[str, str]] = {
        "perturbation": "simulation.perturbation:WheeledPerturbation", "ros_settings": "bases.common.ros_settings:PlanarRosSettings",
        "ros": "bases.planar_motion.ros:PlanarRosAdapter", "ros_plant": "bases.planar_motion.ros_plant:PlanarRosPlant",
        "controller": "bases.planar_motion.controller:PlanarController",
    }  # fmt: skip

    def check(self, description: RobotDescription, model: mujoco.MjModel) -> None:
        check_wheels(description, model)

    def diagnose(self, description: RobotDescription, base: Base) -> list[Finding]:
        """How well the wheels' rates determine each motion of the base."""
        assert isinstance(base, PlanarBase)
        condition = base.condition()
        if condition <= ILL:
            return []
        text = f"errors of wheel rates grow {condition:.3g}-fold in the worst motion of the base"
        return [
            Finding("warning", "wheels", "key 'base.wheels'", text, "check positions, axes and rollers of the wheels")
        ]

    def read(self, description: RobotDescription, spec: mujoco.MjSpec) -> tuple[Tree, FixedWheels]:
        """The file's tree and its wheels."""
        tree = read_tree(spec, description.base.body)
        return tree, read_wheels(description, tree, wheel_radius(description, spec.compile()))

    def calibrate(self, robot: RobotModel, channels: Mapping[str, Array], source: str) -> Calibration:
        """Radii, and what the base's speeds are by them."""
        odometry = lambda wheels: self.part("controller").make_odometry(robot, np.zeros(3), wheels)
        size = planar_base(robot).wheel_upper.size, robot.base.twist.shape[1]
        return vars(fit_errors(odometry, size, channels, source))

    def controller(
        self, robot: RobotModel, mpc: MPC, plant: Any, period: float, calibration: Calibration | None
    ) -> PlanarController:
        from wbmpc.settings import ACTUATOR_TIME_CONSTANT

        wheels = None if calibration is None else WheelErrors(**calibration)
        return self.part("controller")(robot, plant.truth().pose, period, lag=ACTUATOR_TIME_CONSTANT, wheels=wheels)  # type: ignore[no-any-return]

    def ros(self, robot: RobotModel, settings: Any, period: float) -> Any:
        return self.part("ros")(robot, settings, period, self.part("controller"))
