"""The base type ``differential``: driven wheels on one axle, and casters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from wbmpc.bases.base import Proposal
from wbmpc.bases.differential.description import DifferentialBaseDescription
from wbmpc.bases.differential.model import differential_base
from wbmpc.bases.planar_motion.model import PlanarBase
from wbmpc.bases.planar_motion.plugin import PlanarBaseType
from wbmpc.bases.planar_motion.proposal import axles, fixed_wheels, headings, propose
from wbmpc.model.robot import RobotModel
from wbmpc.robots import RobotDescription

if TYPE_CHECKING:
    from wbmpc.bases.differential.plant import DifferentialPlant
    from wbmpc.robots.mechanism import Mechanism
    from wbmpc.robots.wheel_search import Wheel
    from wbmpc.simulation.perturbation import Perturbation
    from wbmpc.types import Edit

#: Axles are one if they are parallel within 1 - cosine and cross a line within so much [m]; a pair is so far [m] apart at least.
PARALLEL, BESIDE, APART = 1e-3, 0.002, 0.05


class DifferentialBaseType(PlanarBaseType):
    """What generic code may ask of differential bases."""

    Description = DifferentialBaseDescription

    def propose(self, mechanism: Mechanism, wheels: Sequence[Wheel]) -> Proposal | None:
        """Wheels on one axle, and no other that is driven."""
        fixed = fixed_wheels(wheels)
        if len(fixed) < 2 or len(fixed) < len(wheels) or any(w.rollers for w in fixed):
            return None
        along = headings(fixed)
        parallel = np.abs(along @ along[0]).min() > 1.0 - PARALLEL
        if not parallel or np.ptp(axles(fixed, along[0])) > BESIDE or np.ptp(axles(fixed, fixed[0].axle[:2])) < APART:
            return None
        return propose(fixed, 0.9, f"{len(fixed)} driven wheels on one axle", {})

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> PlanarBase:
        """The kinematic model."""
        return differential_base(description, *self.read(description, spec))

    def plant(
        self, robot: RobotModel, perturbation: Perturbation | None, seed: int, edit: Edit | None = None
    ) -> DifferentialPlant:
        """The simulated robot at home."""
        from wbmpc.bases.differential.plant import DifferentialPlant

        return DifferentialPlant(robot, perturbation=perturbation, seed=seed, edit=edit)
