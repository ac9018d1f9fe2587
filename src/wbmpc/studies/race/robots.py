"""The robots of the two papers as problems of ``wbmpc bench``, and what is raced on."""

from __future__ import annotations

from functools import partial
from typing import Literal

import numpy as np

from wbmpc.bases.ball.defaults import RezeroCost, rezero_problem
from wbmpc.bases.ball.model import ball_base
from wbmpc.bases.swerve.defaults import SwerveCost, swerve_problem
from wbmpc.benchmark.problems import Problem, RaceProblems
from wbmpc.model.robot import load_robot
from wbmpc.ocp import Mode, ModeSchedule, Reference
from wbmpc.settings import MpcSettings
from wbmpc.solver import SQP, Solver
from wbmpc.studies.paths import SinePath
from wbmpc.studies.race.ballbot import ballbot
from wbmpc.studies.race.differential import differential_manipulator
from wbmpc.studies.race.swerve import swerve

Limits = Literal["hard", "soft"]


def swerve_bench(
    intervals: int = 100, settings: SQP | None = None, brakes: str = "closed", limits: Limits = "hard"
) -> Problem:
    """Swerve base with arm on the way along a gentle sine: nx 21, nu 21, 10 s.

    With closed brakes the twelve rows of rolling and brakes depend on each other; with open ones eight rows remain.
    """
    robot = load_robot("swerve-ur10")
    ocp = swerve_problem(robot, MpcSettings(intervals=intervals, first_interval=0.0, limits=limits), SwerveCost())
    if brakes == "open":
        del ocp.terms["brakes"]
    solver = Solver(ocp, settings or SQP(iterations=300))
    if brakes == "open":
        solver.set_schedule(ModeSchedule((Mode("open", {"brake": [1.0] * 4}),)))
    path = SinePath(0.15, 2.66, 1, 0.255, start=0.5, ramp=2.0)
    t = np.arange(0.0, 12.0, 0.05)
    along, across = path.point(t)
    position, orientation = robot.pose(robot.home)
    hand = position + np.stack([along, across, 0.0 * along], axis=1)
    solver.set_reference("end_effector", Reference.poses(t, hand, orientation))
    states, inputs = np.tile(robot.home, (t.size, 1)), np.zeros((t.size, robot.input.size))
    arc, rate = path.arc(t)
    states[:, 0], inputs[:, 0] = arc * path.length / path.arc_length, rate * path.length / path.arc_length
    solver.set_reference("state", Reference(t, states))
    solver.set_reference("input", Reference(t, inputs))
    return Problem(
        f"swerve base with arm, brakes {brakes}, {limits} limits, N = {intervals}",
        solver,
        robot.home,
        np.zeros(robot.input.size),
    )


def rezero_bench(
    intervals: int = 65,
    settings: SQP | None = None,
    limits: Limits = "hard",
    horizon: float | None = None,
) -> Problem:
    """Ball robot with arm and a hand force as an input, a step of the hand: nx 16, nu 9, 20 ms per interval (or ``horizon``)."""
    robot = load_robot("rezero", contact="force")
    horizon = horizon or (0.02 * intervals if intervals > 40 else 1.3)
    mpc = MpcSettings(horizon=horizon, intervals=intervals, first_interval=0.0, barrier_mu=1e-2, limits=limits)
    solver = Solver(rezero_problem(robot, mpc, RezeroCost()), settings or SQP(iterations=300))
    home, torque = ball_base(robot).numeric.equilibrium(robot.home[robot.state["arm"]])
    u0 = np.concatenate([torque, np.zeros(3)])
    position, orientation = robot.pose(home)
    solver.set_reference("end_effector", Reference.poses([0.0], [position + [0.1, 0.0, 0.0]], orientation))
    solver.set_reference("body", Reference.constant(home))
    solver.set_reference("twist", Reference.constant(np.zeros(6)))
    solver.set_reference("torque", Reference.constant(u0))
    return Problem(f"ball robot with arm, {limits} limits, N = {intervals}", solver, home, u0)


#: With open brakes the swerve robot's rows do not depend on each other, which Fatrop asks for. Milliseconds: one SQP iteration of OCS2
#: (C++, one thread, quiet, on an AMD Zen 5) on problems of the same sizes, not the same problems.
RACE = RaceProblems(
    robots=(swerve_bench, partial(swerve_bench, brakes="open"), rezero_bench),
    limited={
        "swerve base with arm, 100 intervals": lambda settings: swerve_bench(100, settings),
        "ball robot with arm, 65 intervals": lambda settings: rezero_bench(65, settings),
    },
    sizes={
        "ballbot": (ballbot, 0.62, 5.0),
        "differential-manipulator": (differential_manipulator, 0.26, 5.0),
        "swerve-base": (partial(swerve, arm=False), 3.1, 5.0),
        "swerve-arm": (partial(swerve, arm=True), 4.7, 4.0),
    },
)
