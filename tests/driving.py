"""A swerve robot driven along a base motion in physics: what the gate tests share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbmpc import lie
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import StateCost, SwerveCost, swerve_mpc
from wbmpc.bases.swerve.perturbation import SwervePerturbation
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.bases.swerve.steering_planner import SteeringGuess
from wbmpc.bases.swerve.tracking import TrackingSettings
from wbmpc.model.robot import load_robot
from wbmpc.ocp import Reference
from wbmpc.settings import MpcSettings
from wbmpc.simulation.lockstep import run_lockstep
from wbmpc.types import Timing

#: Leg angles [rad] of the configurations of Pankert et al. 2022, Table I (signs of LF, RF, LB, RB).
SIGNS = np.array([1.0, -1.0, -1.0, 1.0])
CONFIGURATIONS = {"H": 0.0 * SIGNS, "X": np.pi / 4 * SIGNS, "A": SIGNS * np.array([-0.498, -0.498, 0.747, 0.747])}


@dataclass(frozen=True)
class Motion:
    """From rest at the origin a constant body twist direction, smoothly: ``twist`` (3) at full speed for ``length`` [s]."""

    twist: tuple[float, float, float]
    length: float
    start: float = 0.5
    ramp: float = 1.0

    def share(self, t: np.ndarray) -> np.ndarray:
        """Speed over full speed."""
        rise = lambda s: 0.5 - 0.5 * np.cos(np.pi * np.clip(s / self.ramp, 0.0, 1.0))
        return rise(t - self.start) - rise(t - self.start - self.length)

    @property
    def end(self) -> float:
        return self.start + self.length + self.ramp

    def poses(self, t: np.ndarray) -> np.ndarray:
        """Base poses (n, 3) at increasing times that start at 0."""
        gone = np.concatenate([[0.0], np.cumsum(np.diff(t) * 0.5 * (self.share(t)[1:] + self.share(t)[:-1]))])
        return np.array([lie.se2_step(np.zeros(3), np.array(self.twist) * g) for g in gone])

    def preview(self, times: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Body twists (n, 3) of the reference at absolute times."""
        return self.share(times)[:, None] * np.array(self.twist)


@dataclass(frozen=True)
class Drive:
    """What came out: planned base twists (n, 3) and true base poses (n, 3) over time; the end pose (3) that was asked for,
    of the odometry, and the true one. ``steer`` (n, modules): measured angles."""

    times: np.ndarray
    planned: np.ndarray
    poses: np.ndarray
    reference: np.ndarray
    odometry: np.ndarray
    truth: np.ndarray
    reason: str
    steer: np.ndarray


def drive(
    motion: Motion,
    name: str = "swerve-ur10",
    legs: np.ndarray | None = None,
    steer: np.ndarray | None = None,
    perturbation: SwervePerturbation | None = None,
    seed: int = 0,
    guess: bool = True,
    planned_steering: bool = True,
    rest: float = 1.0,
) -> Drive:
    """Follow the base motion with the end effector riding along; MPC at 50 Hz, controller at 400 Hz, 10 ms delay."""
    robot = load_robot(name)
    state = robot.state
    home = robot.home.copy()
    if legs is not None:
        home[state["leg"]] = legs
        home[state["steer"]] = -legs
    if steer is not None:
        home[state["steer"]] = steer
    settings = MpcSettings(horizon=6.0, intervals=40)
    cost = SwerveCost(state=StateCost(position=20.0, yaw=20.0))
    mpc = swerve_mpc(robot, settings, cost, guess=SteeringGuess(robot, motion.preview) if guess else None)
    t = np.arange(0.0, motion.end + rest + 0.02, 0.02)
    poses = motion.poses(t)
    end_effector, orientation = robot.pose(home)
    turned = [lie.quaternion_about((0, 0, 1), p[2]) for p in poses]
    place = [[*lie.se2_compose(p, [end_effector[0], end_effector[1], 0.0])[:2], end_effector[2]] for p in poses]
    mpc.reference["end_effector"] = Reference.poses(t, place, [lie.quaternion_multiply(q, orientation) for q in turned])
    states = np.tile(home, (t.size, 1))
    states[:, state["base"]] = poses
    mpc.reference["state"] = Reference(t, states)
    inputs = np.zeros((t.size, robot.input.size))
    inputs[:, robot.input["base"]] = motion.preview(t, np.zeros(3))
    mpc.reference["input"] = Reference(t, inputs)
    plant = SwervePlant(robot.description, state.split(home), perturbation, seed)
    timing = Timing.of(plant.timestep, 400.0, 50.0, 0.010)
    controller = SwerveController(
        robot, plant.truth().pose, timing.period, tracking=TrackingSettings(planned_steering=planned_steering)
    )
    mpc.reset(home)
    times, planned, true, steered = [], [], [], []

    def record(now: float, command: object, plans: object) -> None:
        times.append(now)
        planned.append(plans.current.feedforward(now)[robot.input["base"]])
        true.append(plant.truth().pose)
        steered.append(controller.estimator.steer)

    ending = run_lockstep(plant, controller, mpc, timing, motion.end + rest, record)
    end = np.array([poses[-1], controller.estimator.odometry.pose, plant.truth().pose])
    return Drive(
        np.array(times), np.array(planned), np.array(true), end[0], end[1], end[2], ending.reason, np.array(steered)
    )
