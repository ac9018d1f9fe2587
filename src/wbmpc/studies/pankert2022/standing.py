"""Standing before a run, while the gyro shows its bias, and holding the arm where no plan does."""

from __future__ import annotations

from dataclasses import replace

from wbmpc.arrays import Array
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.types import Timing

#: Gain [1/s] of the arm's position servos.
ARM_GAIN = 5.0


def hold_arm(held: Array, measured: Array) -> Array:
    """Joint rates (m) [rad/s] that keep an arm at ``held`` (m) [rad], of angles ``measured`` (m) [rad]: drives that hold a speed of 0 give
    way to an unknown load, slowly and without end."""
    return ARM_GAIN * (held - measured)


def stand_still(plant: SwervePlant, controller: SwerveController, timing: Timing, seconds: float) -> None:
    """Let the robot stand with closed brakes, its arm held where it is, while the gyro shows its bias; ends before the run's time 0."""
    held = plant.measure().arm
    stop = SwerveCommand.stop(len(swerve_base(controller.robot).geometry.hinge), len(held))
    for _ in range(round(seconds / timing.period)):
        m = plant.measure()
        controller.measure(m)
        plant.step(replace(stop, arm=hold_arm(held, m.arm)), timing.steps)
