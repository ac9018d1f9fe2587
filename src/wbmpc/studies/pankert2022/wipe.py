"""`swerve-wipe`: the end effector wipes a wall whose place and friction are unknown, with a target force, while the base drives along it.

Pankert et al. 2022 spray a wall from a distance (section IV-D, `swerve-plaster`); this is plastering with contact.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field, field_validator

from wbmpc.bases.swerve.brake_supervision import SupervisionSettings
from wbmpc.bases.swerve.defaults import StateCost, SwerveCost, swerve_mpc
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.tracking import TrackingSettings
from wbmpc.experiment import Experiment, Loop, Scenario
from wbmpc.log import Log
from wbmpc.settings import Robot
from wbmpc.studies.force_tip import TIP_MASS, TIP_RADIUS
from wbmpc.studies.pankert2022.definitions import DEFINITIONS
from wbmpc.studies.pankert2022.driving import DrivingSettings, closed_brakes
from wbmpc.studies.pankert2022.metrics import in_frame
from wbmpc.studies.pankert2022.plaster import uneven_floor
from wbmpc.studies.pankert2022.standing import stand_still
from wbmpc.studies.pankert2022.wheel_log import swerve_robot
from wbmpc.studies.pankert2022.wipe_control import BEGIN, HEIGHT, WALL, Order, Wipe, WipeController
from wbmpc.studies.pankert2022.wipe_figures import metrics, plots
from wbmpc.studies.pankert2022.wipe_plant import Wall, WipePlant
from wbmpc.types import Timing

NAME = "swerve-wipe"
SUMMARY = "the end effector presses on a wall of unknown place and friction while the swerve base drives along it"
IDEALIZATIONS = [
    "the wall is flat and rigid, the floor too without `terrain`; the tip is round, rigid, and slides without play on a linear spring",
    "the force sensor has noise of 0.1 N and a bias of 0.1 N for each axis; it stands between end effector and tip",
    "the contact points lie under the steer axes; tires are soft contacts, not a tire model",
    "the arm's joints are velocity servos; the weight that is fed forward is that of the simulated arm",
    "the computation takes a constant 10 ms; the zeros of the arm's encoders are calibrated with 20 tracked poses",
]
Coefficient = Annotated[float, Field(ge=0, le=2)]


class SwerveWipeSettings(DrivingSettings):
    """``force`` [N] along the normal; ``length`` [m] of the way on the wall; ``speed`` [m/s] along it; ``touch_speed`` [m/s] towards the wall,
    until it is touched. What the robot does not know, drawn per seed: ``wall_error`` [m]: both ends of the wall are up to this off;
    ``grip``: friction coefficient of tip and wall, between two numbers; ``spring`` [N/m]: stiffness of the tip; ``spring_error``: share by
    which the true one may differ. ``terrain``: cables and bumps on the floor, as of `swerve-plaster`. The other settings are those of all
    experiments that drive."""

    cost: SwerveCost = SwerveCost(state=StateCost(position=20.0, yaw=100.0))
    robot: Robot = "swerve-ur10"
    tracked_poses: int = Field(20, ge=0, le=1000)
    force: float = Field(15.0, ge=5, le=60)
    length: float = Field(3.0, ge=0.2, le=20)
    speed: float = Field(0.2, ge=0.02, le=0.5)
    touch_speed: float = Field(0.02, ge=0.002, le=0.1)
    wall_error: float = Field(0.02, ge=0, le=0.04)
    grip: tuple[Coefficient, Coefficient] = (0.2, 0.8)
    spring: float = Field(5000.0, ge=500, le=20000)
    spring_error: float = Field(0.2, ge=0, le=0.5)
    terrain: bool = False

    @field_validator("grip")
    @classmethod
    def _range_in_order(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] > value[1]:
            raise ValueError("two numbers with lower ≤ upper are needed")
        return value

    def draw(self, seed: int) -> tuple[Wall, float]:
        """The wall, and the stiffness [N/m] of the spring."""
        rng = np.random.default_rng([seed, 29])
        first, last = WALL + self.wall_error * rng.uniform(-1.0, 1.0, 2)
        wall = Wall((BEGIN, BEGIN + self.length), (float(first), float(last)), float(rng.uniform(*self.grip)))
        return wall, self.spring * (1.0 + self.spring_error * float(rng.uniform(-1.0, 1.0)))


def build(settings: SwerveWipeSettings, seed: int) -> Scenario:
    """One run; docs/reference/metrics.md says what each metric means."""
    robot = swerve_robot(settings.robot)
    mpc = swerve_mpc(robot, settings.mpc, settings.cost)
    wall, spring = settings.draw(seed)
    plant = WipePlant(
        robot.description, wall, spring, robot.state.split(robot.home), settings.plant, seed,
        localization=settings.global_poses(seed), floor=uneven_floor if settings.terrain else None,
    )  # fmt: skip
    timing = Timing.of(plant.timestep, settings.control.rate, settings.mpc.rate, settings.mpc.computation_delay)
    estimation = settings.estimation(robot, seed)
    controller = WipeController(
        robot, plant.truth().pose, timing.period, tracking=TrackingSettings(lag=settings.actuator_time_constant),
        estimation=estimation, supervision=SupervisionSettings(report=closed_brakes(robot, mpc)),
    )  # fmt: skip
    # the model's base has one height: what the true one lacks of it, the end effector makes up for
    height = HEIGHT - controller.estimator.calibration.rise(swerve_base(robot).geometry)
    order = Order(
        settings.force, settings.length, settings.speed, settings.touch_speed, settings.spring, TIP_RADIUS, TIP_MASS
    )
    controller.mpc, controller.wipe = mpc, (wipe := Wipe(robot, order, height))
    stand_still(plant, controller, timing, settings.settle_time)
    settled = len(plant.steps) * plant.timestep
    mpc.reset(robot.home)
    log = Log()

    def record(t: float, command: Any, plans: Any) -> None:
        if round(t / timing.period) % 4:
            return
        truth, pose = plant.truth(), controller.estimator.odometry.pose
        target = wipe.end_effector(np.array([t]))[0]
        log.add("base", t, truth.pose)
        log.add("base_odometry", t, pose)
        log.add("state", t, truth.state)
        log.add("hand", t, truth.tool)
        log.add("hand_odometry", t, in_frame(pose, truth.tool_in_base, truth.tool[2]))
        log.add("hand_reference", t, target)
        log.add("wall", t, [wipe.line.at(target[:1])[0], np.interp(target[0], wall.along, wall.across)])
        log.add("coefficient", t, wipe.coefficient)
        log.add("force_normal", t, plant.steps[-1][1])

    def steps() -> np.ndarray:
        return np.array(plant.steps) - [settled, 0.0, 0.0]

    loop = Loop(plant, controller, mpc, timing, wipe.longest, record, lambda: plant.time - settled > wipe.done)
    return Scenario.single(
        log,
        loop.run,
        lambda _: metrics(log, wipe, steps(), wall.grip),
        lambda _: plots(log, wipe, steps()),
        IDEALIZATIONS,
    )


EXPERIMENT = Experiment.of(NAME, SUMMARY, SwerveWipeSettings, build, DEFINITIONS[NAME])
