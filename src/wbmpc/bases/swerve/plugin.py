"""The base type ``swerve``: steered and driven wheels, on fixed legs or on hinges with brakes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco

from wbmpc.bases.base import System
from wbmpc.bases.swerve.description import SwerveBaseDescription
from wbmpc.bases.swerve.model import SwerveBase
from wbmpc.model.robot import RobotModel
from wbmpc.model.tree import read_tree
from wbmpc.robots import RobotDescription

if TYPE_CHECKING:
    from wbmpc.bases.swerve.plant import SwervePlant
    from wbmpc.simulation.perturbation import Perturbation


class SwerveBaseType:
    """What generic code may ask of swerve bases."""

    Description = SwerveBaseDescription

    def check(self, description: RobotDescription, model: mujoco.MjModel) -> None:
        """Nothing of the whole file: :meth:`model` checks each module."""

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> SwerveBase:
        """The kinematic model; wheels that cannot roll in every direction are logged."""
        base = SwerveBase(description, read_tree(spec, description.base.body))
        base.warn(description)
        return base

    def plant(self, robot: RobotModel, perturbation: Perturbation | None, seed: int) -> SwervePlant:
        """The simulated robot at home."""
        from wbmpc.bases.swerve.plant import SwervePlant

        return SwervePlant(robot.description, perturbation=perturbation, seed=seed)

    def system(self, robot: RobotModel, seed: int) -> System:
        """A perturbed plant at home, whose controller brings hand, base and legs to goals that come by and by."""
        from wbmpc.bases.swerve.system import make_system

        return make_system(robot, self.plant(robot, None, seed))

    def ros(self, robot: RobotModel, settings: Any, period: float) -> Any:
        """The adapter that reads joint states and publishes speeds."""
        from wbmpc.bases.swerve.ros import SwervePilot

        return SwervePilot(robot, settings, period)
