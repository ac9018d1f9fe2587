"""The base type ``omnidirectional``: any number of omni or mecanum wheels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco

from wbmpc.bases.omnidirectional.description import OmnidirectionalBaseDescription
from wbmpc.bases.omnidirectional.model import omnidirectional_base
from wbmpc.bases.planar.model import PlanarBase
from wbmpc.bases.planar.plugin import PlanarBaseType
from wbmpc.model.robot import RobotModel
from wbmpc.robots import RobotDescription

if TYPE_CHECKING:
    from wbmpc.bases.omnidirectional.plant import OmnidirectionalPlant
    from wbmpc.simulation.perturbation import Perturbation


class OmnidirectionalBaseType(PlanarBaseType):
    """What generic code may ask of omnidirectional bases."""

    Description = OmnidirectionalBaseDescription

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> PlanarBase:
        """The kinematic model."""
        return omnidirectional_base(description, *self.read(description, spec))

    def plant(self, robot: RobotModel, perturbation: Perturbation | None, seed: int) -> OmnidirectionalPlant:
        """The simulated robot at home."""
        from wbmpc.bases.omnidirectional.plant import OmnidirectionalPlant

        return OmnidirectionalPlant(robot, perturbation=perturbation, seed=seed)
