"""`wbmpc view ROBOT`: a robot stands in MuJoCo with its MPC, and goes where its goals are dragged."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from wbmpc.control import RezeroAgent, SwerveAgent
from wbmpc.errors import InputError
from wbmpc.experiments.rezero_problem import rezero_mpc
from wbmpc.experiments.rezero_task import STEPS_AND_PUSHES, RezeroSettings, set_home_references
from wbmpc.experiments.settings import MpcSettings
from wbmpc.experiments.swerve_problem import StateCost, SwerveCost, swerve_mpc
from wbmpc.loop import Ending, Timing, Watch, run_lockstep
from wbmpc.model import RobotModel, load_robot
from wbmpc.ocp import Reference
from wbmpc.plant import RezeroPlant, SwervePlant
from wbmpc.robots import BallBaseDescription, SwerveBaseDescription
from wbmpc.view.live import View

#: Rate of the controller [Hz], drive lag that it assumes [s].
_CONTROL, _LAG = 400.0, 0.020
#: A session ends by itself after this long [s].
LONGEST = 24 * 3600.0
#: Legs pull harder than in tracking: their configuration is asked for, not left over.
_LEG_WEIGHT = 20.0


def run_session(robot_name: str, seed: int, view: View) -> Ending:
    """Run until the user ends it. A reset, or a fall, begins anew.

    Raises :class:`InputError` for a robot whose base has no plant.
    """
    robot = load_robot(robot_name)
    base = robot.description.base
    kinds: dict[type, Callable[..., Any]] = {SwerveBaseDescription: _swerve, BallBaseDescription: _ball}
    if type(base) not in kinds:
        raise InputError(f"view: '{robot_name}' has a base of type '{base.type}'; valid: swerve, ball")
    while True:
        plant, agent, mpc, timing = kinds[type(base)](robot, seed)
        watch = Watch(None, (view,))
        ending = run_lockstep(plant, agent, mpc, timing, LONGEST, lambda t, command, plans: None, watch)
        if not (view.wants_reset or ending.fell):
            return ending


def _swerve(robot: RobotModel, seed: int) -> tuple[Any, ...]:
    settings = MpcSettings(horizon=4.0, intervals=40)
    mpc = swerve_mpc(robot, settings, SwerveCost(state=StateCost(leg=_LEG_WEIGHT)))
    position, orientation = robot.pose(robot.home)
    mpc.reference["hand"] = Reference.poses([0.0], [position], orientation)
    mpc.reference["state"] = Reference.constant(robot.home)
    mpc.reference["input"] = Reference.constant(np.zeros(robot.input.size))
    plant = SwervePlant(robot.description, robot.state.split(robot.home), None, seed)
    timing = Timing.of(plant.timestep, _CONTROL, settings.rate, settings.delay)
    agent = SwerveAgent(robot, plant.truth().pose, timing.period, lag=_LAG)
    mpc.reset(robot.home)
    return plant, agent, mpc, timing


def _ball(robot: RobotModel, seed: int) -> tuple[Any, ...]:
    settings = RezeroSettings().mpc
    home, torque = robot.equilibrium(robot.home[robot.state["arm"]])
    mpc = rezero_mpc(robot, settings, STEPS_AND_PUSHES)
    set_home_references(mpc, robot, torque)
    mpc.reference["hand"] = Reference.poses([0.0], [robot.pose(home)[0]], robot.pose(home)[1])
    plant = RezeroPlant(robot.description, home, torque, None, seed)
    timing = Timing.of(plant.timestep, _CONTROL, settings.rate, settings.delay)
    agent = RezeroAgent(robot, mpc, torque, timing.period, _LAG)
    mpc.reset(home, torque)
    return plant, agent, mpc, timing
