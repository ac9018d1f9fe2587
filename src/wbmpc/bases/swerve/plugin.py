"""The base type ``swerve``: steered and driven wheels, on fixed legs or on hinges with brakes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import mujoco

from wbmpc.bases.base import BaseType, Calibration, Proposal, System
from wbmpc.bases.swerve.description import SwerveBaseDescription
from wbmpc.bases.swerve.model import SwerveBase
from wbmpc.model.robot import RobotModel
from wbmpc.model.tree import read_tree
from wbmpc.robots import RobotDescription

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from wbmpc.bases.swerve.calibrator import SwerveCalibrator
    from wbmpc.bases.swerve.leg_folding import LegFolding
    from wbmpc.bases.swerve.perturbation import SwervePerturbation
    from wbmpc.bases.swerve.plant import SwervePlant
    from wbmpc.bases.swerve.ros import SwerveRosAdapter
    from wbmpc.bases.swerve.ros_plant import SwerveRosPlant
    from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
    from wbmpc.control.protocols import Controller
    from wbmpc.mpc.mpc import MPC
    from wbmpc.obstacles.world import Obstacles
    from wbmpc.robots.mechanism import Mechanism
    from wbmpc.robots.wheel_search import Wheel
    from wbmpc.settings import StabilitySettings
    from wbmpc.simulation.perturbation import Perturbation
    from wbmpc.types import Edit

    Array = NDArray[np.float64]


class SwerveBaseType(BaseType):
    """What generic code may ask of swerve bases."""

    Description = SwerveBaseDescription
    calibration_channels = ("wheel", "steer", "leg")

    def check(self, description: RobotDescription, model: mujoco.MjModel) -> None:
        """Nothing of the whole file: :meth:`model` checks each module."""

    def propose(self, mechanism: Mechanism, wheels: Sequence[Wheel]) -> Proposal | None:
        """Two wheels or more, each under its own steering axis."""
        from wbmpc.bases.swerve.proposal import propose

        return propose(mechanism, wheels)

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> SwerveBase:
        """The kinematic model; wheels that cannot roll in every direction are logged."""
        base = SwerveBase(description, read_tree(spec, description.base.body))
        base.warn(description)
        return base

    def perturbation(self) -> type[SwervePerturbation]:
        """Steering encoders and brakes."""
        from wbmpc.bases.swerve.perturbation import SwervePerturbation

        return SwervePerturbation

    def plant(
        self, robot: RobotModel, perturbation: Perturbation | None, seed: int, edit: Edit | None = None
    ) -> SwervePlant:
        """The simulated robot at home."""
        from wbmpc.bases.swerve.plant import SwervePlant

        return SwervePlant(robot.description, perturbation=perturbation, seed=seed, edit=edit)

    def mpc(
        self, robot: RobotModel, obstacles: Obstacles | None = None, stability: StabilitySettings | None = None, *,
        progress: str | None = None, **changes: Any,
    ) -> MPC:  # fmt: skip
        """Weights for goals of end effector, base and legs."""
        from wbmpc.bases.swerve.system import make_mpc

        return make_mpc(robot, obstacles, stability, progress=progress, **changes)

    def system(
        self,
        robot: RobotModel,
        seed: int,
        perturbation: Perturbation | None = None,
        mpc: MPC | None = None,
        edit: Edit | None = None,
        calibration: Calibration | None = None,
    ) -> System:
        """A perturbed plant at home, whose controller brings end effector, base and legs to goals set while it runs."""
        from wbmpc.bases.swerve.system import make_system

        plant = self.plant(robot, perturbation, seed, edit)
        return make_system(robot, plant, mpc or self.mpc(robot), calibration)

    def calibrate(self, robot: RobotModel, channels: Mapping[str, Array], source: str) -> Calibration:
        """Steer zeros and radii."""
        from wbmpc.bases.swerve.wheel_calibration import WheelCalibration

        calibrator = self.calibrator(robot)
        return vars(calibrator.fit(channels, WheelCalibration.unknown(calibrator.geometry), source).calibration)

    def reshaping(self, robot: RobotModel, mpc: MPC, controller: Controller) -> LegFolding | None:
        """Hinged legs fold where it is narrow; None for fixed legs."""
        from wbmpc.bases.swerve.leg_folding import LegFolding

        if "leg" not in robot.state or mpc.obstacles is None or "state" not in mpc.reference:
            return None
        folding = LegFolding(robot, mpc)
        folding.attach(controller)
        return folding

    def configurations(self, robot: RobotModel) -> Mapping[str, Array]:
        """H, X and A of a base with two front and two rear legs."""
        from wbmpc.bases.swerve.configurations import configurations

        return configurations(robot)

    def ros_settings(self, description: RobotDescription) -> type[SwerveRosSettings]:
        """Weights of the swerve problem, gyro and legs."""
        from wbmpc.bases.swerve.ros_settings import SwerveRosSettings

        return SwerveRosSettings

    def ros(self, robot: RobotModel, settings: Any, period: float) -> SwerveRosAdapter:
        """The adapter that reads joint states and publishes speeds."""
        from wbmpc.bases.swerve.ros import SwerveRosAdapter

        return SwerveRosAdapter(robot, settings, period)

    def ros_plant(self, robot: RobotModel, perturbation: Perturbation | None, seed: int) -> SwerveRosPlant:
        """Follows speeds and brakes."""
        from wbmpc.bases.swerve.ros_plant import SwerveRosPlant

        return SwerveRosPlant(robot, self.plant(robot, perturbation, seed))

    def calibrator(self, robot: RobotModel) -> SwerveCalibrator:
        """From encoders, gyro and global poses."""
        from wbmpc.bases.swerve.calibrator import SwerveCalibrator

        return SwerveCalibrator(robot)
