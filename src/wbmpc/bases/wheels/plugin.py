"""The base type ``wheels``: any mix of tires and roller wheels, fixed or steered, with or without an offset."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from wbmpc.bases.base import Base, Proposal
from wbmpc.bases.planar_motion.plugin import PlanarBaseType
from wbmpc.bases.planar_motion.proposal import RADIUS, RIM_ACCELERATION, RIM_SPEED
from wbmpc.bases.wheels.description import WheelsBaseDescription
from wbmpc.bases.wheels.model import WheelsBase
from wbmpc.model.robot import RobotModel
from wbmpc.robots import RobotDescription
from wbmpc.robots.findings import Finding

if TYPE_CHECKING:
    from wbmpc.bases.wheels.control import WheelsController
    from wbmpc.bases.wheels.plant import WheelsPlant
    from wbmpc.robots.mechanism import Mechanism
    from wbmpc.robots.wheel_search import Wheel
    from wbmpc.simulation.perturbation import Perturbation
    from wbmpc.types import Edit

#: Steering rate [rad/s] and acceleration [rad/s²] where a file has no limit.
STEER_RATE, STEER_ACCELERATION = 5.0, 60.0


class WheelsBaseType(PlanarBaseType):
    """What generic code may ask of bases on a mix of wheels."""

    Description = WheelsBaseDescription

    def propose(self, mechanism: Mechanism, wheels: Sequence[Wheel]) -> Proposal | None:
        """One steered wheel at least: tricycles, cars, powered casters. Others have a base type of their own."""
        steered = [w for w in wheels if w.steer]
        if not steered or len({w.steer for w in steered}) < len(steered):
            return None
        known = [w.radius for w in wheels if w.radius is not None]
        radius = float(np.median(known)) if known else RADIUS
        section = {
            "wheels": [
                {"joint": w.joint} | ({"steer": w.steer} if w.steer else {}) | ({} if w.driven else {"driven": False})
                for w in wheels
            ],
            **(
                {}
                if len(known) == len(wheels) and not any(w.assumed for w in wheels)
                else {"wheel_radius": round(radius, 4)}
            ),
        }
        names = {w.joint: (RIM_SPEED / radius, RIM_ACCELERATION / radius) for w in wheels}
        names |= {str(w.steer): (STEER_RATE, STEER_ACCELERATION) for w in steered}
        speed, acceleration = ({n: round(v[k], 2) for n, v in names.items()} for k in (0, 1))
        held = tuple(n for w in wheels for n in w.held)
        reason = f"{len(steered)} steered and {len(wheels) - len(steered)} other wheels"
        return Proposal(section, 0.7, reason, tuple(names), held, speed, acceleration)

    def diagnose(self, description: RobotDescription, base: Base) -> list[Finding]:
        """Also wheels that do not support the robot alone."""
        found = super().diagnose(description, base)
        if base.footprint is None:
            text = "its wheels stand on one line: in the simulator the robot falls over"
            fix = "say where casters carry it, in the axes of the body: 'base: {casters: [[x, y]]}'"
            found.append(Finding("warning", "casters", "key 'base.casters'", text, fix))
        return found

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> WheelsBase:
        """The kinematic model."""
        return WheelsBase(description, *self.read(description, spec))

    def plant(
        self, robot: RobotModel, perturbation: Perturbation | None, seed: int, edit: Edit | None = None
    ) -> WheelsPlant:
        """The simulated robot at home."""
        from wbmpc.bases.wheels.plant import WheelsPlant

        return WheelsPlant(robot, perturbation=perturbation, seed=seed, edit=edit)

    def controller(self) -> type[WheelsController]:
        """Of wheels that steer."""
        from wbmpc.bases.wheels.control import WheelsController

        return WheelsController
