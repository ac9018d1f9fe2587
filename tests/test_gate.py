"""What everything on a swerve base rests on: it moves as fast as asked with inexact steering, and it starts from rest.

Independent truth: the reference's speed and end pose against the true pose of the base in MuJoCo physics; the odometry,
which the controller believes, must say the same within its drift.
"""

from __future__ import annotations

import numpy as np
import pytest

from driving import CONFIGURATIONS, Motion, drive
from effort import some, thorough
from wbmpc.bases.swerve.defaults import EndEffectorCost, StateCost, SwerveCost, swerve_problem
from wbmpc.bases.swerve.perturbation import SwervePerturbation
from wbmpc.bases.swerve.steering_planner import SteeringGuess
from wbmpc.model.robot import load_robot
from wbmpc.ocp import Reference
from wbmpc.settings import MpcSettings
from wbmpc.solver import SQP, Solver, Status

#: Quantized encoders (2^14 per turn) and N(0, 5 mrad) on every steering message, on top of the usual perturbations.
NOISY = SwervePerturbation(steer_noise=0.005)


def speed_ratio(result, motion: Motion) -> float:
    steady = (result.times > motion.start + motion.ramp) & (result.times < motion.start + motion.length)
    asked = np.hypot(*motion.twist[:2])
    return float(np.hypot(*result.planned[steady][:, :2].T).mean() / asked)


def true_speed_ratio(result, motion: Motion) -> float:
    """Way of the base in the world over the way asked for, while the reference is at full speed."""
    steady = (result.times > motion.start + motion.ramp) & (result.times < motion.start + motion.length)
    way, t = result.poses[steady][:, :2], result.times[steady]
    return float(np.linalg.norm(way[-1] - way[0]) / ((t[-1] - t[0]) * np.hypot(*motion.twist[:2])))


@pytest.mark.parametrize("seed", some([3, 4, 5], [0]))
@pytest.mark.parametrize("name", some(["H", "X", "A", "fixed"], [1, 3]))
def test_commanded_speed_with_noisy_steering(name: str, seed: int) -> None:
    motion = Motion((0.3, 0.0, 0.0), 2.0)
    robot = "swerve-fixed-ur10" if name == "fixed" else "swerve-ur10"
    result = drive(motion, robot, legs=CONFIGURATIONS.get(name), perturbation=NOISY, seed=seed, guess=False, rest=0.0)
    assert result.reason == ""
    assert speed_ratio(result, motion) == pytest.approx(1.0, abs=0.02)
    assert true_speed_ratio(result, motion) == pytest.approx(1.0, abs=0.02)


@thorough
def test_measured_steering_in_the_state_shakes_the_plan() -> None:
    """Why the planned steering is in the state: the rows of measured angles contradict each other for any motion, so that the
    planned speed swings with the noise. (It would stand still if commands might change as fast as they liked.)"""
    motion, spread = Motion((0.3, 0.0, 0.0), 4.0), {}
    for planned in (True, False):
        result = drive(motion, perturbation=NOISY, seed=3, guess=False, planned_steering=planned)
        steady = (result.times > 1.5) & (result.times < 4.5)
        spread[planned] = np.hypot(*result.planned[steady][:, :2].T).std()
    assert spread[False] > 5.0 * spread[True]
    assert spread[True] < 0.02 * 0.3


GOALS = {
    "left": (0.0, 0.25, 0.0),
    "right": (0.0, -0.25, 0.0),
    "diagonal": (0.18, 0.18, 0.0),
    "back diagonal": (-0.18, 0.18, 0.0),
    "turn": (0.0, 0.0, 0.4),
    "turn and go": (0.2, 0.1, 0.3),
}


STARTS = (0.0, np.pi / 2, -np.pi / 2, 3.1)


# the part: each goal once or not at all, each angle of the wheels at least once
@pytest.mark.parametrize(("goal", "start"), some([(g, s) for g in GOALS for s in STARTS], [1, 12]))
def test_goal_from_rest(goal: str, start: float) -> None:
    """At least 90 % of the way, wheels parallel to the body (and turned by ``start`` from that) at first."""
    motion = Motion(GOALS[goal], 2.0, start=1.5)
    # the home's wheels stand parallel to the body; the branch nearest to it stays within the steering's range
    steer = -CONFIGURATIONS["X"] + start
    steer = np.where(np.abs(steer) > 3.1, steer - np.sign(steer) * np.pi, steer)
    result = drive(motion, steer=steer, seed=1)
    assert result.reason == ""
    way = np.linalg.norm(result.reference * [1, 1, 0.8])
    missing = np.linalg.norm((result.truth - result.reference) * [1, 1, 0.8])
    assert missing <= 0.1 * way, f"{result.truth} instead of {result.reference}"
    lost = np.linalg.norm((result.truth - result.odometry) * [1, 1, 0.8])
    assert lost <= 0.03 * way, f"the odometry says {result.odometry}, the base is at {result.truth}"


def test_sideways_is_stationary_without_the_guess() -> None:
    """Straight wheels at rest are an exact stationary point of a sideways goal: the solver says "converged" and stays."""
    robot = load_robot("swerve-ur10")
    cost = SwerveCost(
        end_effector=EndEffectorCost(weight=0.0, orientation=0.0), state=StateCost(position=20.0, yaw=20.0)
    )
    ocp = swerve_problem(robot, MpcSettings(horizon=6.0, intervals=40, limits="soft"), cost)
    solver = Solver(ocp, SQP(iterations=200))
    goal = robot.home.copy()
    goal[robot.state["base"]] = [0.0, 1.0, 0.0]
    end_effector, orientation = robot.pose(robot.home)
    solver.set_reference("end_effector", Reference.poses([0.0], [end_effector], orientation))
    solver.set_reference("state", Reference.constant(goal))
    solver.set_reference("input", Reference.constant(np.zeros(robot.input.size)))
    solver.warm_start(robot.home)
    stuck = solver.solve(robot.home)
    assert stuck.status is Status.CONVERGED
    assert abs(stuck.x[-1, 1]) < 1e-3
    solver.warm_start(robot.home)
    guess = SteeringGuess(robot, lambda times, pose: np.tile([0.0, 0.2, 0.0], (times.size, 1)))
    start = guess(0.0, robot.home, solver.trajectory())
    assert start is not None
    solver.warm_start(start.x, start.u)
    freed = solver.solve(robot.home)
    assert freed.x[-1, 1] > 0.9
    assert freed.cost < 0.5 * stuck.cost
