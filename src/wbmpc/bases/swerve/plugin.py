"""The base type ``swerve``: steered and driven wheels, on fixed legs or on hinges with brakes.

How a swerve base is found in a model without a robot file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import mujoco
import numpy as np

from wbmpc.bases.base import Calibration, Proposal, Question
from wbmpc.bases.common.plugin import CommonBaseType
from wbmpc.bases.swerve.description import SwerveBaseDescription
from wbmpc.bases.swerve.model import LARGEST_OFFSET, SwerveBase
from wbmpc.model.robot import RobotModel
from wbmpc.model.tree import read_tree
from wbmpc.robots import RobotDescription

if TYPE_CHECKING:
    from wbmpc.arrays import Array
    from wbmpc.bases.swerve.calibrator import SwerveCalibrator
    from wbmpc.bases.swerve.controller import SwerveController
    from wbmpc.bases.swerve.leg_folding import LegFolding
    from wbmpc.bases.swerve.plant import SwervePlant
    from wbmpc.control.protocols import Controller
    from wbmpc.mpc.mpc import MPC
    from wbmpc.obstacles.world import Obstacles
    from wbmpc.robots.mechanism import Mechanism
    from wbmpc.robots.wheel_search import Wheel
    from wbmpc.settings import StabilitySettings
    from wbmpc.simulation.perturbation import Perturbation
    from wbmpc.types import Edit

#: Rim speed [m/s], steering and leg rates [rad/s], of legs that slide [m/s], where a file has no limit; radius [m] where nothing shows it.
RIM_SPEED, STEER_RATE, LEG_RATE, SLIDE_RATE, RADIUS = 1.5, 5.0, 0.4, 0.17, 0.1
#: How fast they change: rim [m/s²] without slipping, steering and legs [rad/s²], legs that slide [m/s²].
RIM_ACCELERATION, STEER_ACCELERATION, LEG_ACCELERATION, SLIDE_ACCELERATION = 4.0, 60.0, 5.0, 2.0


def propose(mechanism: Mechanism, wheels: Sequence[Wheel]) -> Proposal | None:
    """Wheels under steering axes that turn about +z, on fixed legs, on hinges or on slides; None for others."""
    steered = [w for w in wheels if w.steer is not None]
    if len(steered) < 2 or len(steered) < len(wheels) or len({w.steer for w in steered}) < len(steered):
        return None
    upright = all(mechanism.joints[str(w.steer)].axis[2] > 0.0 for w in steered)
    if not upright or max(w.offset for w in steered) > LARGEST_OFFSET:
        return None
    known = [w.radius for w in steered if w.radius is not None]
    radius = round(float(np.median(known)), 4) if known else RADIUS
    sure = len(known) == len(steered) and not any(w.assumed for w in steered)
    asked = () if sure else (Question("wheel_radius", "radius of the wheels [m]", radius),)
    moved = all(w.leg for w in steered)
    modules = [_module(mechanism, w, moved) for w in steered]
    held = [n for w in steered for n in (*w.held, *(() if moved or not w.leg else (w.leg,)))]
    rates = {"hinge": LEG_RATE, "slide": SLIDE_RATE, "steer": STEER_RATE, "wheel": RIM_SPEED / radius}
    changes = {
        "hinge": LEG_ACCELERATION, "slide": SLIDE_ACCELERATION, "steer": STEER_ACCELERATION,
        "wheel": RIM_ACCELERATION / radius,
    }  # fmt: skip
    speed, acceleration = ({n: round(v[part], 2) for m in modules for part, n in m.items()} for v in (rates, changes))
    reason = f"{len(steered)} wheels under steering axes" + (
        f", on {'sliding' if 'slide' in modules[0] else 'hinged'} legs" if moved else ""
    )
    section: dict[str, Any] = {"wheel_radius": radius, "modules": modules}
    return Proposal(section, 0.9, reason, tuple(speed), tuple(held), speed, acceleration, asked)


def _module(mechanism: Mechanism, wheel: Wheel, moved: bool) -> dict[str, str]:
    leg = {mechanism.joints[wheel.leg].kind: wheel.leg} if moved and wheel.leg else {}
    return {**leg, "steer": str(wheel.steer), "wheel": wheel.joint}


class SwerveBaseType(CommonBaseType):
    """What generic code may ask of swerve bases."""

    Description = SwerveBaseDescription
    parts: ClassVar[Mapping[str, str]] = {
        "perturbation": "bases.swerve.perturbation:SwervePerturbation", "plant": "bases.swerve.plant:SwervePlant",
        "ros_settings": "bases.swerve.ros_settings:SwerveRosSettings", "ros": "bases.swerve.ros:SwerveRosAdapter",
        "ros_plant": "bases.swerve.ros_plant:SwerveRosPlant",
    }  # fmt: skip
    calibration_channels = ("wheel", "steer", "leg")

    def check(self, description: RobotDescription, model: mujoco.MjModel) -> None:
        """Nothing of the whole file: :meth:`model` checks each module."""

    def propose(self, mechanism: Mechanism, wheels: Sequence[Wheel]) -> Proposal | None:
        """Two wheels or more, each under its own steering axis."""

        return propose(mechanism, wheels)

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> SwerveBase:
        """The kinematic model; wheels that cannot roll in every direction are logged."""
        base = SwerveBase(description, read_tree(spec, description.base.body))
        base.warn(description)
        return base

    def plant(
        self, robot: RobotModel, perturbation: Perturbation | None, seed: int, edit: Edit | None = None
    ) -> SwervePlant:
        from wbmpc.bases.swerve.plant import SwervePlant

        return SwervePlant(robot.description, perturbation=perturbation, seed=seed, edit=edit)

    def mpc(
        self, robot: RobotModel, obstacles: Obstacles | None = None, stability: StabilitySettings | None = None, *,
        progress: str | None = None, **changes: Any,
    ) -> MPC:  # fmt: skip
        """Weights for goals of end effector, base and legs."""
        from wbmpc.bases.swerve.system import make_mpc

        return make_mpc(robot, obstacles, stability, progress=progress, **changes)

    def controller(
        self, robot: RobotModel, mpc: MPC, plant: SwervePlant, period: float, calibration: Calibration | None
    ) -> SwerveController:
        from wbmpc.bases.swerve.system import make_controller

        return make_controller(robot, plant.truth().pose, period, calibration)

    def calibrate(self, robot: RobotModel, channels: Mapping[str, Array], source: str) -> Calibration:
        from wbmpc.bases.swerve.wheel_calibration import WheelCalibration

        calibrator = self.calibrator(robot)
        return vars(calibrator.fit(channels, WheelCalibration.unknown(calibrator.geometry), source).calibration)

    def reshaping(self, robot: RobotModel, mpc: MPC, controller: Controller) -> LegFolding | None:
        """Hinged legs fold where it is narrow and stand wider where the arm pulls; None for fixed legs."""
        from wbmpc.bases.swerve.leg_folding import LegFolding
        from wbmpc.bases.swerve.leg_widening import knows_load
        from wbmpc.obstacles.geometry import readable_shapes

        if "leg" not in robot.state or "state" not in mpc.reference:
            return None
        if mpc.obstacles is None and not (knows_load(mpc) and readable_shapes(robot)):
            return None
        folding = LegFolding(robot, mpc)
        folding.attach(controller)
        return folding

    def configurations(self, robot: RobotModel) -> Mapping[str, Array]:
        """H, X and A of a base with two front and two rear legs."""
        from wbmpc.bases.swerve.configurations import configurations

        return configurations(robot)

    def calibrator(self, robot: RobotModel) -> SwerveCalibrator:
        from wbmpc.bases.swerve.calibrator import SwerveCalibrator

        return SwerveCalibrator(robot)
