"""`wbmpc view ROBOT`: a simulated robot whose MPC follows goals that are dragged in the browser."""

from __future__ import annotations

import gc
from functools import partial
from typing import Any

from wbmpc.bases import base_type
from wbmpc.bases.base import System
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.runtime.clock import WallClock
from wbmpc.runtime.runner import RealTimeRunner
from wbmpc.runtime.safety import RealTimeSettings
from wbmpc.simulation.lockstep import LONGEST_STOP, Ending, Running, Watch, Watcher, run_lockstep
from wbmpc.types import SimulatedRobot
from wbmpc.view.live import View
from wbmpc.view.physics import Simulated
from wbmpc.view.realtime import RealtimeView

#: A machine that draws pictures beside it may hold the controller up for so long [s] without a stop: the robot is simulated.
_PATIENT = 2.0
#: A session ends by itself after this long [s].
LONGEST = 24 * 3600.0


def system_of(robot: RobotModel, seed: int) -> System:
    """Plant, controller, MPC and timing of a robot. Raises :class:`InputError` where its base type has none."""
    return base_type(robot.description.base.type).system(robot, seed)


class _WhileShown:
    """Ends a session that nobody sees or steers any more, its page's process being gone."""

    def __init__(self, view: View) -> None:
        self._view = view

    def begin(self, running: Running) -> None:
        """The view itself has begun."""

    def tick(self, t: float, command: Any, plans: PolicyQueue) -> None:
        """Look."""
        self._view.check_shown()

    def end(self, ending: Ending) -> None:
        """The view itself says so."""


def run_session(robot_name: str, seed: int, view: View, *others: Watcher) -> Ending:
    """Run in virtual time, paced to the clock, until the user ends it. A reset, or a fall, restarts.

    ``others`` watch too: a recorder.
    """
    robot = load_robot(robot_name)
    while True:
        view.restart()
        watch = Watch(None, (view, _WhileShown(view), *others))
        ending = run_lockstep(*system_of(robot, seed).parts, LONGEST, lambda t, command, plans: None, watch)
        if not (view.wants_reset or ending.fell):
            return ending


def run_realtime(robot_name: str, seed: int, view: RealtimeView) -> str:
    """Run the real-time runner on a simulated robot, which has a process of its own, until the user ends it; returns why.

    A reset, or a fall, restarts. Nothing waits here: controller, MPC, physics and view go by the clock.
    """
    while True:
        gc.collect()  # see View.restart
        runner, robot = runner_of(robot_name, seed, view)
        try:
            reason = view.follow(runner)
            # what stops a robot that loses its balance is often seen before the fall
            fell = robot.falls(LONGEST_STOP if view.stopped and view.robot.base.balances else 0.0)
        finally:
            robot.close()
        if not (view.wants_reset or fell):
            return reason


def runner_of(robot_name: str, seed: int, view: RealtimeView) -> tuple[RealTimeRunner, Simulated]:
    """A runner on a simulated robot, shown and steered by ``view``, which is opened if it is not open yet."""
    robot = load_robot(robot_name)
    # the controller's model is the first MPC: the memory of the runner's own belongs to its thread
    system, mpc = system_of(robot, seed), system_of(robot, seed).mpc
    controller, model, clock = system.controller, system.mpc, WallClock()
    make = partial(_plant_of, robot_name, seed)
    simulated = Simulated(
        make, system.plant.measure(), controller.stop(), clock, None, seen=view.seen, patience=_PATIENT
    )
    if view.process is None:
        view.open(mpc, simulated.seen)
    view.guide(mpc, controller, simulated.push)
    # the physics says itself when it is held up, and earlier
    times = RealTimeSettings(
        1.0 / system.timing.period, max_policy_age=_PATIENT, max_observation_age=2.0 * _PATIENT, watchdog=_PATIENT,
        keep_last_policy=robot.base.balances,
    )  # fmt: skip
    return RealTimeRunner(
        simulated, controller, mpc, times, clock, parameters=lambda: model.solver.parameters, watch=view.watch
    ), simulated


def _plant_of(robot_name: str, seed: int) -> SimulatedRobot:
    """The simulated robot at home, perturbed against the model; made in a process of its own."""
    robot = load_robot(robot_name)
    return base_type(robot.description.base.type).plant(robot, None, seed)
