"""`swerve-plaster`: the end effector sprays a wall in long lines while the base drives along it (Pankert et al. 2022, section IV-D)."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from wbmpc import lie
from wbmpc.bases.swerve.brake_supervision import SupervisionSettings
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import swerve_mpc
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.bases.swerve.tracking import TrackingSettings
from wbmpc.errors import RunAborted
from wbmpc.experiment import Experiment, Loop, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.simulation.contacts import GROUND, OBSTACLE
from wbmpc.studies.pankert2022 import plaster_wall as wall
from wbmpc.studies.pankert2022.definitions import DEFINITIONS
from wbmpc.studies.pankert2022.driving import LidarPoses, closed_brakes
from wbmpc.studies.pankert2022.metrics import in_frame
from wbmpc.studies.pankert2022.plaster_figures import metrics, plots
from wbmpc.studies.pankert2022.standing import stand_still
from wbmpc.studies.pankert2022.wheel_log import swerve_robot
from wbmpc.types import Timing

NAME = "swerve-plaster"
SUMMARY = "five lines of 3.5 m on a wall, ten times, over cables and bumps (Pankert et al. 2022, section IV-D)"

IDEALIZATIONS = [
    "the wall is exact and where the plan has it; what is sprayed stays where it hits, as a cone of constant rate",
    "the distance sensor's beam is the tool's axis; its noise is independent; the LIDAR's too",
    "the contact points lie under the steer axes; tires are soft contacts, not a tire model; the floor's bumps are smooth",
    "the computation takes a constant 10 ms; the arm's encoder offsets are not calibrated",
]
#: Noise [m] and rate [Hz] of the distance sensor; what it says nothing of has these deviations [m, rad].
DISTANCE_NOISE, DISTANCE_RATE, UNKNOWN = 0.002, 50.0, (10.0, 10.0)
#: Cables (x) [m] of 10 mm height, bumps (x, y) [m] of 10 mm.
CABLES, CABLE_RADIUS, BUMPS, BUMP_HEIGHT, BUMP_RADIUS = (0.9, 2.6), 0.005, ((0.6, 0.5), (1.9, -0.5)), 0.010, 0.30


def room(spec: mujoco.MjSpec) -> None:
    """The wall on a flat floor."""
    half = [0.5 * wall.LENGTH + 2.0, 0.05, 1.0]
    spec.worldbody.add_geom(
        name="wall", type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=[half[0] - 1.0, wall.WALL + half[1], half[2]],
        rgba=[0.85, 0.83, 0.78, 0.4], **OBSTACLE,
    )  # fmt: skip


def terrain(spec: mujoco.MjSpec) -> None:
    """The wall, on a floor that is not even."""
    room(spec)
    uneven_floor(spec)


def uneven_floor(spec: mujoco.MjSpec) -> None:
    """Cables across the way, smooth bumps."""
    common = {"friction": [0.75, 0.005, 1e-4], "solref": [0.01, 1.0], **GROUND}
    for x in CABLES:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[x, -2, 0, x, 2, 0], size=[CABLE_RADIUS, 0, 0], **common
        )
    for x, y in BUMPS:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
            size=[BUMP_RADIUS, BUMP_RADIUS, BUMP_HEIGHT],
            pos=[x, y, 0.0],
            **common,
        )


class _WallSensor:
    """Distance from the end effector to the wall along the tool's axis, turned into what it says of the base's place across."""

    def __init__(self, robot: RobotModel, period: float, seed: int) -> None:
        self.robot, self._rng = robot, np.random.default_rng([seed, 2])
        self._every, self._count = max(round(1.0 / (DISTANCE_RATE * period)), 1), 0

    def __call__(self, plant: SwervePlant, controller: SwerveController) -> None:
        """Correct the odometry at the sensor's rate: the end effector by the planner's kinematics, the base as estimated."""
        self._count += 1
        if self._count % self._every:
            return
        truth = plant.truth()
        axis = truth.tool_rotation[:, 2]
        distance = (wall.WALL - truth.tool[1]) / axis[1] + DISTANCE_NOISE * self._rng.normal()
        x = controller.state()
        end_effector, quaternion = self.robot.pose(x)
        beam = lie.quaternion_to_rotation(quaternion)[1, 2]
        pose = x[self.robot.state["base"]].copy()
        pose[1] += wall.WALL - distance * beam - end_effector[1]
        assert controller.measured is not None
        controller.estimator.odometry.correct(
            controller.measured.time, pose, np.diag([UNKNOWN[0] ** 2, DISTANCE_NOISE**2, UNKNOWN[1] ** 2])
        )


def build(settings: wall.SwervePlasterSettings, seed: int) -> Scenario:
    """All passes; docs/reference/metrics.md says what each metric means."""
    robot = swerve_robot(settings.robot)
    references = wall.WallReferences(settings, robot)
    mpc = swerve_mpc(robot, settings.mpc, settings.cost)
    references.set(mpc, robot)
    plant = SwervePlant(
        robot.description, robot.state.split(robot.home), settings.plant, seed,
        edit=terrain if settings.terrain else room, localization=settings.global_poses(seed),
    )  # fmt: skip
    timing = Timing.of(plant.timestep, settings.control.rate, settings.mpc.rate, settings.mpc.computation_delay)
    estimation = settings.estimation(robot, seed)
    controller = SwerveController(
        robot, plant.truth().pose, timing.period, tracking=TrackingSettings(lag=settings.actuator_time_constant),
        estimation=estimation, supervision=SupervisionSettings(report=closed_brakes(robot, mpc)),
    )  # fmt: skip
    stand_still(plant, controller, timing, settings.settle_time)
    mpc.reset(robot.home)
    log = Log()
    sensor = _WallSensor(robot, timing.period, seed) if isinstance(settings.localization, LidarPoses) else None

    def record(t: float, command: Any, plans: Any) -> None:
        if sensor is not None and t >= references.lines.start - 0.5:
            sensor(plant, controller)
        if round(t / timing.period) % 4:
            return
        truth, pose = plant.truth(), controller.estimator.odometry.pose
        log.add("base", t, truth.pose)
        log.add("base_odometry", t, pose)
        log.add("hand", t, truth.tool)
        log.add("hand_odometry", t, in_frame(pose, truth.tool_in_base, truth.tool[2]))
        log.add("hand_reference", t, references.end_effector(np.array([t]))[0])
        log.add("wheel_slip", t, truth.slip)
        if wall.WALL - truth.tool[1] < wall.NEAREST:
            raise RunAborted(
                f"the end effector's switch stopped it {1e3 * (wall.WALL - truth.tool[1]):.0f} mm before the wall"
            )

    loop = Loop(plant, controller, mpc, timing, references.duration, record)
    measured = lambda _: metrics(log, references, sensor is not None)
    return Scenario.single(log, loop.run, measured, lambda _: plots(log, references), IDEALIZATIONS)


EXPERIMENT = Experiment.of(NAME, SUMMARY, wall.SwervePlasterSettings, build, DEFINITIONS[NAME])
