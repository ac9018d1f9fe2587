"""The base type ``differential``: driven wheels on one axle, and casters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco

from wbmpc.bases.differential.description import DifferentialBaseDescription
from wbmpc.bases.differential.model import differential_base
from wbmpc.bases.planar.model import PlanarBase
from wbmpc.bases.planar.plugin import PlanarBaseType
from wbmpc.model.robot import RobotModel
from wbmpc.robots import RobotDescription

if TYPE_CHECKING:
    from wbmpc.bases.differential.plant import DifferentialPlant
    from wbmpc.simulation.perturbation import Perturbation


class DifferentialBaseType(PlanarBaseType):
    """What generic code may ask of differential bases."""

    Description = DifferentialBaseDescription

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> PlanarBase:
        """The kinematic model."""
        return differential_base(description, *self.read(description, spec))

    def plant(self, robot: RobotModel, perturbation: Perturbation | None, seed: int) -> DifferentialPlant:
        """The simulated robot at home."""
        from wbmpc.bases.differential.plant import DifferentialPlant

        return DifferentialPlant(robot, perturbation=perturbation, seed=seed)
