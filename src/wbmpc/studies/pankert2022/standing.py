"""Standing before a run, while the gyro shows its bias."""

from __future__ import annotations

from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.simulation.lockstep import Timing


def stand_still(plant: SwervePlant, controller: SwerveController, timing: Timing, seconds: float) -> None:
    """Let the robot stand with closed brakes while the gyro shows its bias; ends before the run's time 0."""
    for _ in range(round(seconds / timing.period)):
        controller.measure(plant.measure())
        plant.step(
            SwerveCommand.stop(
                len(swerve_base(controller.robot).geometry.hinge), len(controller.robot.input.groups["arm"])
            ),
            timing.steps,
        )
