"""What the plug-ins of base types on fixed wheels have in common."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from wbmpc.bases.base import Base, BaseType, Calibration, System
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
    from wbmpc.obstacles.world import Obstacles
    from wbmpc.ros2.base_adapter import BaseAdapter
    from wbmpc.ros2.plants import RosPlant
    from wbmpc.ros2.settings import RosSettings
    from wbmpc.settings import StabilitySettings
    from wbmpc.simulation.perturbation import Perturbation, WheeledPerturbation
    from wbmpc.types import Edit

Array = NDArray[np.float64]
#: Condition of the wheel matrix, turns counted at the wheels' distance, above which it is reported.
ILL = 20.0


class PlanarBaseType(BaseType):
    """Checks and system; a base type adds ``Description``, ``model`` and ``plant``."""

    calibration_channels = ("wheel", "steer")

    def check(self, description: RobotDescription, model: mujoco.MjModel) -> None:
        """Joints that are wheels."""
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

    def mpc(
        self, robot: RobotModel, obstacles: Obstacles | None = None, stability: StabilitySettings | None = None, *,
        progress: str | None = None, **changes: Any,
    ) -> MPC:  # fmt: skip
        """Weights that follow from the robot's size and limits."""
        from wbmpc.default_problem import default_mpc, default_settings

        return default_mpc(
            robot, default_settings(**changes), obstacles=obstacles, stability=stability, progress=progress
        )

    def perturbation(self) -> type[WheeledPerturbation]:
        """Of a robot on wheels."""
        from wbmpc.simulation.perturbation import WheeledPerturbation

        return WheeledPerturbation

    def system(
        self,
        robot: RobotModel,
        seed: int,
        perturbation: Perturbation | None = None,
        mpc: MPC | None = None,
        edit: Edit | None = None,
        calibration: Calibration | None = None,
    ) -> System:
        """A perturbed plant at home with its controller and MPC, whose goal is home."""
        from wbmpc.settings import ACTUATOR_TIME_CONSTANT, COMPUTATION_DELAY, CONTROL_RATE
        from wbmpc.types import Timing

        plant, mpc = self.plant(robot, perturbation, seed, edit), mpc or self.mpc(robot)
        timing = Timing.of(plant.timestep, CONTROL_RATE, mpc.rate, COMPUTATION_DELAY)
        wheels = None if calibration is None else WheelErrors(**calibration)
        controller = self.controller()(
            robot, plant.truth().pose, timing.period, lag=ACTUATOR_TIME_CONSTANT, wheels=wheels
        )
        return System(plant, controller, mpc, timing)

    def calibrate(self, robot: RobotModel, channels: Mapping[str, Array], source: str) -> Calibration:
        """Radii, and what the base's speeds are by them."""
        odometry = lambda wheels: self.controller().make_odometry(robot, np.zeros(3), wheels)
        size = planar_base(robot).wheel_upper.size, robot.base.twist.shape[1]
        return vars(fit_errors(odometry, size, channels, source))

    def ros_settings(self, description: RobotDescription) -> type[RosSettings]:
        """Weights that scale with the robot, and the gyro."""
        from wbmpc.bases.planar_motion.ros_settings import PlanarRosSettings

        return PlanarRosSettings

    def ros(self, robot: RobotModel, settings: Any, period: float) -> BaseAdapter:
        """The adapter that reads joint states and publishes speeds."""
        from wbmpc.bases.planar_motion.ros import PlanarRosAdapter

        return PlanarRosAdapter(robot, settings, period, self.controller())

    def controller(self) -> type[PlanarController]:
        """What drives this base type."""
        from wbmpc.bases.planar_motion.controller import PlanarController

        return PlanarController

    def ros_plant(self, robot: RobotModel, perturbation: Perturbation | None, seed: int) -> RosPlant:
        """Follows speeds."""
        from wbmpc.bases.planar_motion.ros_plant import PlanarRosPlant

        return PlanarRosPlant(robot, self.plant(robot, perturbation, seed))
