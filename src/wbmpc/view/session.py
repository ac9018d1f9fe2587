"""`wbmpc view ROBOT`: a robot stands in MuJoCo with its MPC, and goes where its goals are dragged."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.defaults import rezero_mpc, set_home_references
from wbmpc.bases.ball.description import BallBaseDescription
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.bases.ball.settings import STEPS_AND_PUSHES, leaning_of
from wbmpc.bases.ball.settings import BallControllerSettings as RezeroSettings
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import StateCost, SwerveCost, swerve_mpc
from wbmpc.bases.swerve.description import SwerveBaseDescription
from wbmpc.bases.swerve.goal_guess import GoalGuess
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.bases.swerve.tracking import TrackingSettings
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.runtime.clock import WallClock
from wbmpc.runtime.runner import RealTimeRunner
from wbmpc.runtime.safety import RealTimeSettings
from wbmpc.settings import MpcSettings
from wbmpc.simulation.lockstep import Ending, Timing, Watch, Watcher, run_lockstep
from wbmpc.view.live import View
from wbmpc.view.physics import Simulated
from wbmpc.view.realtime import RealtimeView

#: Rate of the controller [Hz], drive lag that it assumes [s].
_CONTROL, _LAG = 400.0, 0.020
#: A machine that draws pictures beside it may hold the controller up for so long [s] without a stop: the robot is simulated.
_PATIENT = 2.0
#: A session ends by itself after this long [s].
LONGEST = 24 * 3600.0
#: Legs pull harder than in tracking: their configuration is asked for, not left over.
_LEG_WEIGHT = 20.0


def kind_of(robot: RobotModel) -> Callable[[RobotModel, int], tuple[Any, Any, MPC, Timing]]:
    """Makes plant, agent, MPC and timing of a robot from a seed. Raises :class:`InputError` for bases that have no plant."""
    base = robot.description.base
    kinds: dict[type, Callable[..., Any]] = {SwerveBaseDescription: _swerve, BallBaseDescription: _ball}
    if type(base) not in kinds:
        raise InputError(f"view: '{robot.description.name}' has a base of type '{base.type}'; valid: swerve, ball")
    return kinds[type(base)]


def run_session(robot_name: str, seed: int, view: View, *others: Watcher) -> Ending:
    """Run in virtual time, paced to the clock, until the user ends it. A reset, or a fall, begins anew.

    ``others`` watch too: a recorder.
    """
    robot = load_robot(robot_name)
    make = kind_of(robot)
    while True:
        view.anew()
        plant, agent, mpc, timing = make(robot, seed)
        watch = Watch(None, (view, *others))
        ending = run_lockstep(plant, agent, mpc, timing, LONGEST, lambda t, command, plans: None, watch)
        if not (view.wants_reset or ending.fell):
            return ending


def run_realtime(robot_name: str, seed: int, view: RealtimeView) -> str:
    """Run the real-time runner on a simulated robot, which has a process of its own, until the user ends it; returns why.

    A reset, or a fall, begins anew. Nothing waits for anybody here: controller, MPC, physics and view go by the clock.
    """
    while True:
        runner, robot = runner_of(robot_name, seed, view)
        try:
            reason = view.follow(runner)
        finally:
            robot.close()
        if not (view.wants_reset or robot.board["fell"]):
            return reason


def runner_of(robot_name: str, seed: int, view: RealtimeView) -> tuple[RealTimeRunner, Simulated]:
    """A runner on a simulated robot, shown and steered by ``view``, which is opened if it is not open yet."""
    robot = load_robot(robot_name)
    make = kind_of(robot)
    # the agent's model is the first MPC: the memory of the runner's own belongs to its thread
    (plant, agent, model, timing), (_, _, mpc, _) = make(robot, seed), make(robot, seed)
    clock = WallClock()
    simulated = Simulated(partial(_plant_of, robot_name, seed), plant.measure(), agent.stop(), clock, None)
    if view.process is None:
        view.open(mpc, simulated.seen)
    view.guide(mpc, agent, simulated.push)
    times = RealTimeSettings(
        1.0 / timing.period, max_policy_age=_PATIENT, max_observation_age=_PATIENT, watchdog=_PATIENT,
        keep=isinstance(robot.description.base, BallBaseDescription),
    )  # fmt: skip
    return RealTimeRunner(
        simulated, agent, mpc, times, clock, parameters=lambda: model.solver.parameters, watch=view.watch
    ), simulated


def _plant_of(robot_name: str, seed: int) -> BallPlant | SwervePlant:
    return _plant(load_robot(robot_name), seed)


def _plant(robot: RobotModel, seed: int) -> BallPlant | SwervePlant:
    """The simulated robot at home, perturbed against the model."""
    if isinstance(robot.description.base, BallBaseDescription):
        home, torque = robot.base.numeric.equilibrium(robot.home[robot.state["arm"]])
        return BallPlant(robot.description, home, torque, None, seed)
    return SwervePlant(robot.description, robot.state.split(robot.home), None, seed)


def _swerve(robot: RobotModel, seed: int) -> tuple[Any, ...]:
    settings = MpcSettings(horizon=4.0, intervals=40)
    mpc = swerve_mpc(robot, settings, SwerveCost(state=StateCost(leg=_LEG_WEIGHT)), GoalGuess(robot))
    position, orientation = robot.pose(robot.home)
    mpc.reference["hand"] = Reference.poses([0.0], [position], orientation)
    mpc.reference["state"] = Reference.constant(robot.home)
    mpc.reference["input"] = Reference.constant(np.zeros(robot.input.size))
    plant = _plant(robot, seed)
    timing = Timing.of(plant.timestep, _CONTROL, settings.rate, settings.delay)
    agent = SwerveController(robot, plant.truth().pose, timing.period, tracking=TrackingSettings(lag=_LAG))
    mpc.reset(robot.home)
    return plant, agent, mpc, timing


def _ball(robot: RobotModel, seed: int) -> tuple[Any, ...]:
    settings = RezeroSettings().mpc
    home, torque = robot.base.numeric.equilibrium(robot.home[robot.state["arm"]])
    mpc = rezero_mpc(robot, settings, STEPS_AND_PUSHES)
    set_home_references(mpc, robot, torque)
    mpc.reference["hand"] = Reference.poses([0.0], [robot.pose(home)[0]], robot.pose(home)[1])
    plant = _plant(robot, seed)
    timing = Timing.of(plant.timestep, _CONTROL, settings.rate, settings.delay)
    agent = BallController(robot, mpc, torque, timing.period, DriveSettings(_LAG))
    agent.leaning = leaning_of(RezeroSettings(), robot, robot.home[robot.state["arm"]])
    mpc.reset(home, torque)
    return plant, agent, mpc, timing
