"""`swerve-wobble`: one wheel on a block, the stretched arm turns slowly (Pankert et al. 2022, section IV-A, Fig. 5 and 6).

Before that the robot learns from three other turns how far its masses are from the model's.
"""

from __future__ import annotations

from functools import cache, partial
from typing import Annotated, Literal

import mujoco
import numpy as np
from pydantic import Field

from wbmpc.bases.swerve.brake_monitor import SwerveReadings
from wbmpc.bases.swerve.brake_supervision import brake_monitor
from wbmpc.bases.swerve.configurations import CONFIGURATIONS, corners
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.perturbation import SwervePerturbation
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.experiment import Experiment, Outcome, Part, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.settings import Robot, Settings
from wbmpc.simulation.contacts import GROUND
from wbmpc.simulation.lockstep import Ending, Progress, watched
from wbmpc.stability import assess
from wbmpc.studies.pankert2022.definitions import DEFINITIONS
from wbmpc.studies.pankert2022.support_prediction import RAISE, REST, Case
from wbmpc.studies.pankert2022.wobble_figures import RATE, TURN, Predictions, metrics, plots

NAME = "swerve-wobble"
SUMMARY = "wobble with one wheel on a block while the stretched arm turns (Pankert et al. 2022, Fig. 5, 6)"

IDEALIZATIONS = [
    "body, legs and arm are rigid, tires are soft contacts: nothing swings after a switch as the real robot does",
    "the block is raised under the standing robot; the wheels' drives hold them still, the brakes are closed",
    "predictions know the block's height and the planned arm motion, not the plant: masses and centers of mass are nominal, "
    "shifted by what the gyro saw in three turns before",
    "the gyro's bias is averaged over the rest before the motion",
]
#: Heights [m] of the block: the paper's and two that a floor may have.
HEIGHTS = (0.15, 0.02, 0.005)
Wheel = Literal["LF", "RF", "LB", "RB"]
#: The turns that come first, on a block of another height: (configuration, wheel on the block). Together they show what the
#: switches of H and X depend on: edges of two directions, and the arm at other angles to them.
CALIBRATION: tuple[tuple[Literal["H", "X", "A"], Wheel], ...] = (("H", "LF"), ("H", "RB"), ("X", "RB"))
CALIBRATION_HEIGHT, CALIBRATION_TURN = 0.10, 30.0


class SwerveWobbleSettings(Settings):
    """``heights`` [m]: of the block under the left front wheel, the first one gives the rates; ``turn`` [s]: duration of a turn;
    ``calibration``: the turns that come first, as (configuration, wheel on the block); ``calibration_turn`` [s]: duration of each of these turns.
    """

    plant: SwervePerturbation = SwervePerturbation()
    robot: Robot = "swerve-ur10"
    heights: tuple[Annotated[float, Field(ge=0, le=1)], ...] = Field(HEIGHTS, min_length=1, max_length=100)
    turn: float = Field(TURN, ge=20, le=600)
    calibration: tuple[tuple[Literal["H", "X", "A"], Wheel], ...] = CALIBRATION
    calibration_turn: float = Field(CALIBRATION_TURN, ge=20, le=600)


def build(settings: SwerveWobbleSettings, seed: int) -> Scenario:
    """The calibration, then all configurations and heights, each on its own plant of the same seed."""
    robot, log = load_robot(settings.robot), Log()
    first = [
        Case(name, CALIBRATION_HEIGHT, settings.calibration_turn, wheel, f"calibration_{k}_")
        for k, (name, wheel) in enumerate(settings.calibration)
    ]
    cases = [Case(name, height, settings.turn) for height in settings.heights for name in CONFIGURATIONS]
    for case in cases[: len(CONFIGURATIONS)]:  # what this robot cannot do is said before anything is simulated
        assess(robot, case.configuration, arm=case.arm(np.zeros(1), len(robot.input.groups["arm"]))[0])

    def part(case: Case) -> Part:
        what = ("calibration: " if case in first else "") + f"{case.configuration}, {1e3 * case.height:g} mm"
        return Part(what, partial(_simulate, robot, settings, seed, case, case in cases, log))

    @cache
    def predictions() -> Predictions:
        return Predictions.of(robot, log, first, cases)

    return Scenario(
        log, [part(case) for case in [*first, *cases]],
        lambda run: metrics(log, settings.heights[0], cases, predictions()),
        lambda run: plots(robot, log, settings, cases, predictions()), IDEALIZATIONS,
    )  # fmt: skip


def _simulate(
    robot: RobotModel, settings: SwerveWobbleSettings, seed: int, case: Case, judged: bool, log: Log,
    progress: Progress | None,
) -> Outcome:  # fmt: skip
    """Raise the block under its wheel, then turn the arm; channel gyro of this case, and if it is ``judged`` the truth: rate and
    force. Brakes that did not hold."""
    joints, height = len(robot.input.groups["arm"]), case.height
    start = assess(robot, case.configuration, arm=case.arm(np.zeros(1), joints)[0])
    x, y = start.stance.feet[corners(robot)[case.wheel]]

    def block(spec: mujoco.MjSpec) -> None:
        body = spec.worldbody.add_body(name="block", mocap=True, pos=[x, y, -0.5 * height - 1e-3])
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.15, 0.15, height / 2], friction=[0.8, 0.005, 1e-4],
            solref=[0.01, 1.0], rgba=[0.8, 0.5, 0.2, 1.0], **GROUND,
        )  # fmt: skip

    plant = SwervePlant(robot.description, robot.state.split(start.x), settings.plant, seed, edit=block)
    modules, key = swerve_base(robot).geometry.modules, case.key
    steps = round(1.0 / RATE / plant.timestep)
    monitor, still = brake_monitor(robot), np.zeros(modules)
    assert monitor is not None  # of a robot whose legs have brakes
    with watched(plant, 1.0 / RATE, case.end, progress) as tick:
        for k in range(round(case.end * RATE)):
            t = k / RATE
            plant.data.mocap_pos[0, 2] = min(RAISE * t, height) - 0.5 * height
            measured = plant.measure()
            monitor.update(SwerveReadings(t, measured.leg, still, still))
            if t >= case.start - REST + 0.5:
                log.add(f"gyro_{key}", t - case.start, measured.gyro[:2])
                if judged:
                    log.label(f"rate_{key}", "xy", "rad/s")
                    log.add(f"rate_{key}", t - case.start, plant.data.qvel[3:5])
                    log.add(f"force_{key}", t - case.start, plant.truth().wheel_force)
            now, later = case.arm(np.array([t, t + 1.0 / RATE]), joints)
            arm = (later - now) * RATE + 2.0 * (now - measured.arm)
            command = SwerveCommand(still, still, arm, still)
            tick(t, command)
            plant.step(command, steps)
    return Outcome(Ending.of(plant), [str(fault) for fault in monitor.real])


EXPERIMENT = Experiment.of(NAME, SUMMARY, SwerveWobbleSettings, build, DEFINITIONS[NAME])
