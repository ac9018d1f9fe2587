"""What the plug-ins of this package share: their parts by name, imported when they are asked for."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar

from wbmpc.bases.base import BaseType, Calibration, System
from wbmpc.model.robot import RobotModel
from wbmpc.robots import RobotDescription

if TYPE_CHECKING:
    from wbmpc.control.protocols import RobotController
    from wbmpc.mpc.mpc import MPC
    from wbmpc.obstacles.world import Obstacles
    from wbmpc.ros2.plants import RosPlant
    from wbmpc.settings import StabilitySettings
    from wbmpc.simulation.perturbation import Perturbation
    from wbmpc.types import Edit, SimulatedRobot


class CommonBaseType(BaseType):
    """``parts``: classes as "module:class", in packages below ``wbmpc``: ``perturbation``, ``plant``, ``ros_settings``, ``ros`` (of the
    controller's node), ``ros_plant``, and what a base type asks for besides."""

    parts: ClassVar[Mapping[str, str]] = {}

    def part(self, name: str) -> Any:
        """The class of a part."""
        module, _, attribute = self.parts[name].partition(":")
        return getattr(import_module(f"wbmpc.{module}"), attribute)

    def perturbation(self) -> type[Perturbation]:
        return self.part("perturbation")  # type: ignore[no-any-return]

    def plant(
        self, robot: RobotModel, perturbation: Perturbation | None, seed: int, edit: Edit | None = None
    ) -> SimulatedRobot:
        return self.part("plant")(robot, perturbation=perturbation, seed=seed, edit=edit)  # type: ignore[no-any-return]

    def controller(
        self, robot: RobotModel, mpc: MPC, plant: Any, period: float, calibration: Calibration | None
    ) -> RobotController:
        """What drives a ``plant`` that rests, every ``period`` [s]."""
        raise NotImplementedError

    def system(
        self, robot: RobotModel, seed: int, perturbation: Perturbation | None = None, mpc: MPC | None = None,
        edit: Edit | None = None, calibration: Calibration | None = None,
    ) -> System:  # fmt: skip
        from wbmpc.settings import COMPUTATION_DELAY, CONTROL_RATE
        from wbmpc.types import Timing

        plant, mpc = self.plant(robot, perturbation, seed, edit), mpc or self.mpc(robot)
        timing = Timing.of(plant.timestep, CONTROL_RATE, mpc.rate, COMPUTATION_DELAY)
        return System(plant, self.controller(robot, mpc, plant, timing.period, calibration), mpc, timing)

    def ros_settings(self, description: RobotDescription) -> Any:
        return self.part("ros_settings")

    def ros(self, robot: RobotModel, settings: Any, period: float) -> Any:
        return self.part("ros")(robot, settings, period)

    def ros_plant(self, robot: RobotModel, perturbation: Perturbation | None, seed: int) -> RosPlant:
        return self.part("ros_plant")(robot, self.plant(robot, perturbation, seed))  # type: ignore[no-any-return]


class SpeedBaseType(CommonBaseType):
    """Robots whose drives take speeds and whose problem is the default one."""

    def mpc(
        self, robot: RobotModel, obstacles: Obstacles | None = None, stability: StabilitySettings | None = None, *,
        progress: str | None = None, **changes: Any,
    ) -> MPC:  # fmt: skip
        """Weights that follow from the robot's size and limits."""
        from wbmpc.default_problem import default_mpc, default_mpc_settings

        return default_mpc(
            robot, default_mpc_settings(**changes), obstacles=obstacles, stability=stability, progress=progress
        )
