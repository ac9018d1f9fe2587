"""The base type ``differential``: driven wheels on one axle, and casters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

import mujoco
import numpy as np

from wbmpc.bases.base import Proposal
from wbmpc.bases.differential.description import DifferentialBaseDescription
from wbmpc.bases.differential.model import differential_base
from wbmpc.bases.planar_motion.model import PlanarBase
from wbmpc.bases.planar_motion.plugin import PlanarBaseType
from wbmpc.bases.planar_motion.proposal import axles, fixed_wheels, headings, propose
from wbmpc.robots import RobotDescription

if TYPE_CHECKING:
    from wbmpc.robots.mechanism import Mechanism
    from wbmpc.robots.wheel_search import Wheel

#: Axles are one if they are parallel within 1 - cosine and cross a line within so much [m]; a pair is so far [m] apart at least.
PARALLEL, BESIDE, APART = 1e-3, 0.002, 0.05


class DifferentialBaseType(PlanarBaseType):
    """What generic code may ask of differential bases."""

    Description = DifferentialBaseDescription
    parts: ClassVar[Mapping[str, str]] = {**PlanarBaseType.parts, "plant": "bases.differential.plant:DifferentialPlant"}

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
        return differential_base(description, *self.read(description, spec))
