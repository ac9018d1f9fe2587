"""`swerve-fast`: a swerve base drives an S-curve faster than it can, after a clock or at its own speed along the path.

The wheels' friction and loads are no part of the kinematic plan: what it asks of the tyres is seen in tilt and slip.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from pydantic import Field

from wbmpc import lie
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import (
    ROLLING_SOFTNESS,
    EndEffectorCost,
    InputCost,
    StateCost,
    SwerveCost,
    swerve_problem,
)
from wbmpc.bases.swerve.path_guess import PathGuess
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.bases.swerve.tracking import TrackingSettings
from wbmpc.experiment import Experiment, Loop, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.path import Along
from wbmpc.ocp import Cost, Path, Reference, path_problem, residuals
from wbmpc.result import Metric, Plot, Series
from wbmpc.settings import ExperimentSettings, MpcSettings
from wbmpc.simulation.lockstep import Timing
from wbmpc.stability import leg_angles
from wbmpc.studies.pankert2022.mission import at_home
from wbmpc.studies.pankert2022.standing import stand_still
from wbmpc.studies.pankert2022.wheel_log import swerve_robot
from wbmpc.tasks.path_settings import Curve, timed
from wbmpc.tasks.paths import nearest_distance

#: Weights of the base's position [1/m²] and yaw [1/rad²], the same for both references; seconds of them at the end of the horizon.
POSITION, YAW, TERMINAL = 2000.0, 300.0, 1.0
#: Within this [m] of its end the path has been driven; points of the path.
THERE, POINTS = 0.02, 1001
IDEALISATIONS = ["tyres are soft contacts, not a tyre model", "the computation takes a constant 10 ms"]


class SwerveFastSettings(ExperimentSettings):
    """``reference``: clock or progress; ``speed`` [m/s] along the path, which rises and falls over ``ramp`` [s]; ``width`` and ``length`` [m] of
    one bend of the curve; ``configuration`` of the legs; ``limit_factor``: of the robot file's limits of base and wheel speeds, in the plan and in
    the simulated drives; ``time_limit`` [s] of a run; ``actuator_time_constant`` [s] that the controller assumes."""

    mpc: MpcSettings = MpcSettings(horizon=2.0, intervals=40)
    robot: str = "swerve-ur10"
    reference: Literal["clock", "progress"] = "progress"
    speed: float = Field(2.0, ge=0.01, le=10.0)
    ramp: float = Field(0.5, ge=0.01, le=60.0)
    width: float = Field(0.8, gt=0.0, le=10.0)
    length: float = Field(1.2, gt=0.0, le=10.0)
    configuration: str = "H"
    limit_factor: float = Field(1.0, gt=0.0, le=10.0)
    time_limit: float = Field(15.0, gt=0.0, le=600.0)
    settle_time: float = Field(2.0, ge=0.0, le=120.0)
    actuator_time_constant: float = Field(0.020, ge=0.0, le=0.5)


def faster(robot: RobotModel, factor: float) -> RobotModel:
    """The same robot with drives that are ``factor`` times as fast."""
    if factor == 1.0:
        return robot
    d = robot.description
    wheels = {m.wheel for m in d.base.modules}  # type: ignore[attr-defined]
    velocity = {n: (factor if n in wheels else 1.0) * v for n, v in d.limits.velocity.items()}
    update: dict[str, Any] = {"velocity": velocity}
    update |= {k: factor * getattr(d.limits, k) for k in ("base_linear", "base_angular")}
    return RobotModel(d.model_copy(update={"limits": d.limits.model_copy(update=update)}))


def s_curve(settings: SwerveFastSettings, height: float) -> Curve:
    """One bend to the left and one back, [m], with the yaw of its direction, from the origin on."""
    x = np.linspace(0.0, 2.0 * settings.length, POINTS)
    phase = np.pi * x / settings.length
    y = 0.5 * settings.width * (1.0 - np.cos(phase))
    yaw = np.arctan(0.5 * settings.width * np.pi / settings.length * np.sin(phase))
    turns = np.array([lie.quaternion_about((0.0, 0.0, 1.0), float(a)) for a in yaw])
    return Curve(np.stack([x, y, np.full(POINTS, height)], axis=1), turns)


def make_mpc(settings: SwerveFastSettings, robot: RobotModel, home: np.ndarray, curve: Curve) -> MPC:
    """The base follows the curve, the arm keeps its posture; begins at rest at ``home`` (nx)."""
    cost = SwerveCost(
        end_effector=EndEffectorCost(weight=0.0, orientation=0.0),
        state=StateCost(position=0.0, yaw=0.0, arm=60.0),
        input=InputCost(base=0.0),
    )
    ocp = swerve_problem(robot, settings.mpc, cost, ROLLING_SOFTNESS, accelerations=True)
    pose = np.array([POSITION, POSITION, 0.0, 0.0, 0.0, YAW])
    frame = residuals.FramePose(robot, robot.description.base.body)
    ocp.add(Cost("base", frame, list(pose), at="path+terminal", terminal_weight=list(TERMINAL * pose)))
    progress = settings.reference == "progress"
    if progress:
        ocp = path_problem(ocp, "base")
    mpc = MPC(ocp, settings.mpc.solver(), settings.mpc.rate, guess=PathGuess(robot) if progress else None)
    if progress:
        path = Path(curve.points, curve.turns)
        mpc.path.follow(path, settings.speed, settings.speed / settings.ramp, along={"state": on(robot, home, path)})
    else:
        mpc.reference["base"] = timed(curve, settings.speed, settings.ramp, 0.0)[0]
    position, orientation = robot.pose(home)
    mpc.reference["end_effector"] = Reference.poses([0.0], [position], orientation)
    mpc.reference["state"] = Reference.constant(home)
    mpc.reference["input"] = Reference.constant(np.zeros(robot.input.size))
    mpc.reset(home)
    return mpc


def on(robot: RobotModel, home: np.ndarray, path: Path) -> Along:
    """States (n, nx) with the base on the path at arc lengths (n) [m], else as at ``home`` (nx)."""
    part = robot.state["base"].start

    def states(s: np.ndarray) -> np.ndarray:
        values, poses = np.tile(home, (len(s), 1)), path.at(s)
        values[:, part : part + 2] = poses[:, :2]
        values[:, part + 2] = [lie.quaternion_log(q)[2] for q in poses[:, 3:]]
        return values

    return states


def build(settings: SwerveFastSettings, seed: int) -> Scenario:
    """One run."""
    robot = faster(swerve_robot(settings.robot), settings.limit_factor)
    home = at_home(robot, leg_angles(robot, settings.configuration)) if "leg" in robot.state else robot.home
    curve = s_curve(settings, float(robot.pose(home, robot.description.base.body)[0][2]))
    mpc = make_mpc(settings, robot, home, curve)
    plant = SwervePlant(robot.description, robot.state.split(home), settings.plant, seed)
    timing = Timing.of(plant.timestep, settings.control.rate, settings.mpc.rate, settings.mpc.computation_delay)
    tracking = TrackingSettings(lag=settings.actuator_time_constant)
    controller = SwerveController(robot, plant.truth().pose, timing.period, tracking=tracking)
    stand_still(plant, controller, timing, settings.settle_time)
    mpc.reset(home)
    log = Log()

    def record(t: float, command: Any, plans: Any) -> None:
        truth = plant.truth()
        log.add("base", t, truth.pose)
        log.add("base_odometry", t, controller.pose)
        log.add("tilt", t, truth.tilt)
        log.add("wheel_slip", t, truth.slip)
        log.add("wheel_force", t, truth.wheel_force)
        goal = mpc.path.pose(t) if mpc.path.active else mpc.reference["base"].at(t)
        log.add("base_reference", t, goal[:3])

    loop = Loop(plant, controller, mpc, timing, settings.time_limit, record)
    return Scenario.single(
        log, loop.run, lambda run: metrics(log, curve, run.ending.fell), lambda run: plots(log, curve), IDEALISATIONS
    )


def metrics(log: Log, curve: Curve, fell: bool) -> dict[str, Metric]:
    """Time to the end of the path, and what happened up to there, in the world. Goals: those of a dynamic plan."""
    t, base = log.times("base"), log.array("base")
    points = np.concatenate([base[:, :2], np.zeros((len(t), 1))], axis=1)
    way = np.concatenate([curve.points[:, :2], np.zeros((len(curve.points), 1))], axis=1)
    there = np.linalg.norm(points - way[-1], axis=1) <= THERE
    arrival = float(t[np.argmax(there)]) if there.any() else np.inf
    use = t <= arrival
    off = nearest_distance(points[use], way)
    return {
        "fell": Metric(float(fell), "1", goal=0.0),
        "path_time": Metric(arrival, "s", goal=2.4),
        "contour_error_rms_world": Metric(float(np.sqrt(np.mean(off**2))), "m"),
        "contour_error_max_world": Metric(float(off.max()), "m", goal=0.015),
        "tilt_max": Metric(float(log.array("tilt")[use].max()), "rad"),
        "wheel_slip_max": Metric(float(log.array("wheel_slip")[use].max()), "m/s", goal=0.05),
        "wheel_unloaded_time": Metric(
            float(np.mean(np.diff(t[:2])) * (log.array("wheel_force")[use].min(axis=1) < 1.0).sum()), "s"
        ),
    }


def plots(log: Log, curve: Curve) -> list[Plot]:
    """The way, tilt and slip."""
    t, base, odometry = log.times("base"), log.array("base"), log.array("base_odometry")
    return [
        Plot("Way of the base", "x [m]", "y [m]", [
            Series("path", curve.points[:, 0], curve.points[:, 1], dashed=True),
            Series("world", base[:, 0], base[:, 1]),
            Series("estimated frame", odometry[:, 0], odometry[:, 1]),
        ], equal_axes=True),
        Plot("Tilt", "time [s]", "tilt [°]", [Series("tilt", t, np.rad2deg(log.array("tilt").ravel()))]),
        Plot("Wheel slip", "time [s]", "slip [m/s]", [Series("largest", t, log.array("wheel_slip").max(axis=1))]),
    ]  # fmt: skip


EXPERIMENT = Experiment.of(
    "swerve-fast", "an S-curve faster than a swerve base can drive it: a clock against progress along the path",
    SwerveFastSettings, build,
)  # fmt: skip
