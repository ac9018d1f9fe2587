"""The base type ``omnidirectional``: any number of omni or mecanum wheels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import mujoco
import numpy as np

from wbmpc.bases.base import Proposal, Question
from wbmpc.bases.omnidirectional.description import OmnidirectionalBaseDescription
from wbmpc.bases.omnidirectional.model import omnidirectional_base
from wbmpc.bases.planar_motion.model import PlanarBase
from wbmpc.bases.planar_motion.plugin import PlanarBaseType
from wbmpc.bases.planar_motion.proposal import axles, headings, propose
from wbmpc.robots import RobotDescription
from wbmpc.robots.wheel_search import CASTER

if TYPE_CHECKING:
    from wbmpc.robots.mechanism import Mechanism
    from wbmpc.robots.wheel_search import Wheel

#: Wheels point in one direction above this cosine; axles are two if so far [m] apart.
ALIKE, APART = 0.97, 0.05
ROLLERS = partial(Question, "rollers", "rollers of the wheels: omni, mecanum, or an angle [deg] for each")


class OmnidirectionalBaseType(PlanarBaseType):
    """What generic code may ask of omnidirectional bases."""

    Description = OmnidirectionalBaseDescription
    parts: ClassVar[Mapping[str, str]] = {
        **PlanarBaseType.parts,
        "plant": "bases.omnidirectional.plant:OmnidirectionalPlant",
    }

    def propose(self, mechanism: Mechanism, wheels: Sequence[Wheel]) -> Proposal | None:
        """Three wheels or more in different directions, or four parallel ones on two axles; steering axes of a file that stand for
        rollers are held."""
        steers = {w.steer for w in wheels if w.steer}
        if len(wheels) < 3 or 0 < len(steers) < len(wheels):
            return None
        fixed = [replace(w, steer=None, held=(*w.held, *((w.steer,) if w.steer else ()))) for w in wheels]
        along = headings(fixed)
        if np.abs(along @ along[0]).min() < ALIKE:
            return propose(
                fixed, 0.2 if steers else 0.9, f"{len(fixed)} wheels in different directions", {"rollers": "omni"},
                ROLLERS("omni"),
            )  # fmt: skip
        if len(fixed) < 4 or np.ptp(axles(fixed, along[0])) < APART or np.ptp(axles(fixed, fixed[0].axle[:2])) < APART:
            return None
        seen = any(w.rollers or "mecanum" in f"{mechanism.file.path.name} {w.joint}".lower() for w in fixed)
        stand_in = all(w.right_below and CASTER.search(str(w.steer)) for w in wheels)
        reason = f"{len(fixed)} parallel wheels on two axles" + (
            "; its steering axes only stand for rollers" if steers else "" if seen else "; wheels that skid: planar"
        )
        fit = 0.95 if stand_in else 0.2 if steers else 0.9 if seen else 0.5
        return propose(fixed, fit, reason, {"rollers": "mecanum"}, ROLLERS("mecanum"))

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> PlanarBase:
        return omnidirectional_base(description, *self.read(description, spec))
