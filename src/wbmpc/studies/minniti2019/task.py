"""What the ball robot's experiments share: the closed loop, pushes, recorded channels."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Any

import numpy as np

from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.defaults import rezero_mpc, set_home_references
from wbmpc.bases.ball.estimator import BallEstimator
from wbmpc.bases.ball.lean_control import LeanControl
from wbmpc.bases.ball.model import ball_base
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.ball.push import PushEstimator
from wbmpc.bases.base import System
from wbmpc.checks import whole
from wbmpc.errors import InputError
from wbmpc.experiment import Loop, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.result import Metric, Plot
from wbmpc.robots import load_description
from wbmpc.simulation.lockstep import Ending
from wbmpc.studies.minniti2019.baselines import Parts, make_controller
from wbmpc.studies.minniti2019.controller_parts import MpcDisturbance, NoisyTruth, PushFilter
from wbmpc.studies.minniti2019.controller_settings import ControllerSettings, Planner, PlanningController, WholeBodyMpc
from wbmpc.studies.minniti2019.metrics import estimator_metrics, fault_metrics
from wbmpc.studies.minniti2019.servo_plant import ServoPlant
from wbmpc.studies.minniti2019.settings import ControlledSettings, RezeroSettings
from wbmpc.studies.minniti2019.truth_record import TruthRecord
from wbmpc.tasks.joint_figures import JointRecord
from wbmpc.types import Timing
from wbmpc.units import force_unit

IDEALIZATIONS = [
    "encoders, gyro and accelerometer have noise, bias and 5 ms of age; the start (position, heading) is known, and the floor "
    "is flat; with controller.estimator=truth the controller gets the simulator's state instead, 5 ms old, with noise",
    "the geometry and masses of Rezero's arm are assumed (not published)",
    "the omni wheels act as torques between ball and base; their traction limit is a clamp (limits.wheel_effort: 4 N m)",
    "the computation takes a constant 10 ms; drives follow torque with a first-order lag",
]

#: Of so many ticks one is recorded of what plans say of joints and of what they do.
JOINT_ROWS = 4
#: Where an accurate end effector of Rezero starts, arm angles [rad]: it stays inside 85 % of its reach when the ball drives round it.
BENT_ARM = np.array([0.0, 0.5, 2.0])


def bent_arm(settings: RezeroSettings, robot: RobotModel) -> np.ndarray:
    """Where an accurate end effector starts, arm angles (m) [rad]: bent; other robots at their home, which is theirs to choose."""
    return BENT_ARM if settings.robot == "rezero" else robot.home[robot.state["arm"]]


@dataclass(frozen=True)
class Push:
    """A force (3) [N] in world axes at the base's center of mass, from ``start`` for ``length`` [s], whole controller periods."""

    start: float
    length: float
    force: tuple[float, float, float]


@dataclass(frozen=True)
class Task:
    """A start (arm angles), how long it goes on [s], references by term beside rest at the start, and pushes."""

    arm: np.ndarray
    duration: float
    references: dict[str, Reference] = field(default_factory=dict)
    pushes: tuple[Push, ...] = ()


def reaching(
    robot: RobotModel, times: np.ndarray, ball: np.ndarray, end_effector: np.ndarray, start: np.ndarray
) -> Reference:
    """The body (n, nx) at rest over times (n) [s] with the ball at ``ball`` (n, 2) and the end effector as near as it can be to ``end_effector``
    (n, 3) [m], from state ``start`` (nx) on, with its heading: the task of controllers that track the body alone."""
    from scipy.optimize import least_squares

    arm, velocity = start[robot.state["arm"]], robot.state["base_velocity"].start

    def state(place: np.ndarray, angles: np.ndarray) -> np.ndarray:
        x = ball_base(robot).numeric.equilibrium(angles, yaw=float(start[2]))[0]
        x[:2] = place
        return x

    states, angles = np.empty((times.size, start.size)), arm
    for k, (place, goal) in enumerate(zip(ball, end_effector, strict=True)):
        if k == 0 or not (np.array_equal(place, ball[k - 1]) and np.array_equal(goal, end_effector[k - 1])):
            away = lambda z, p=place, g=goal: np.concatenate([robot.pose(state(p, z))[0] - g, 1e-3 * (z - arm)])
            angles = least_squares(away, angles, diff_step=1e-5).x
        states[k] = state(place, angles)
    moves = np.gradient(states[:, :velocity], times, axis=0)
    states[:, velocity:] = moves
    return Reference(times, states)


def ball_robot(settings: RezeroSettings, payload: bool = False, contact: str = "none") -> RobotModel:
    """The robot of the settings with what an experiment needs of its model, whatever its file says of that.

    Raises :class:`InputError` for a base of another type.
    """
    check_ball(settings.robot)
    return load_robot(settings.robot, contact=contact, contact_frame=(), payload=payload)


def check_ball(robot: str) -> None:
    """Raise :class:`InputError` for the name or file of a robot whose base is of another type."""
    kind = load_description(robot).base.type
    if kind != "ball":
        raise InputError(f"robot: '{robot}' has a base of type '{kind}'; valid: ball")


def robot_of(settings: RezeroSettings, chosen: ControllerSettings) -> RobotModel:
    """The ball robot as the ``chosen`` controller models it: with a mass at the end effector where that is estimated."""
    return ball_robot(settings, isinstance(chosen, Planner) and chosen.payload)


def estimator_of(chosen: ControllerSettings, robot: RobotModel, home: np.ndarray) -> BallEstimator | None:
    """The estimator of a controller for a robot that starts in the state ``home`` (nx); None: the simulator's state takes its place."""
    return None if isinstance(chosen.estimator, NoisyTruth) else BallEstimator(robot, home)


@dataclass(frozen=True)
class BallSystem:
    """A simulated ball robot with its controller. ``mpc`` holds the references; ``planner`` is what plans (None: nothing does)."""

    plant: BallPlant
    controller: BallController
    planner: MPC | None
    mpc: MPC
    timing: Timing

    def loop(self, duration: float, record: Callable[[float, Any, Any], None]) -> Loop:
        """These for ``duration`` [s]."""
        return Loop(self.plant, self.controller, self.planner, self.timing, duration, record)


def ball_system(
    settings: RezeroSettings,
    chosen: ControllerSettings,
    seed: int,
    arm: np.ndarray,
    references: Mapping[str, Reference],
) -> BallSystem:
    """The ``chosen`` controller on a perturbed plant, at rest with its ``arm`` (m) [rad] there, the estimator in the loop."""
    robot = robot_of(settings, chosen)
    home, torque = ball_base(robot).numeric.equilibrium(arm)
    plans = (
        chosen if isinstance(chosen, PlanningController) else PlanningController()
    )  # of baselines it has the references alone
    mpc = rezero_mpc(robot, plans.planning(settings.mpc), plans.weights)
    set_home_references(mpc, robot, torque, home)
    position, quaternion = robot.pose(home)
    mpc.reference["end_effector"] = Reference.poses([0.0], position, quaternion)
    for term, reference in references.items():
        mpc.reference[term] = reference
    plant = ServoPlant(robot.description, home, torque, settings.perturbation, seed, payload=settings.payload)
    timing = Timing.of(plant.timestep, settings.control.rate, settings.mpc.rate, settings.mpc.computation_delay)
    parts = Parts(robot, mpc, torque, timing.period, estimator_of(chosen, robot, home), arm)
    controller, planner = make_controller(settings, chosen, parts)
    mpc.reset(home, torque)
    return BallSystem(plant, controller, planner, mpc, timing)


def task_scenario(
    settings: ControlledSettings,
    seed: int,
    task: Task,
    metrics: Callable[[Log, Ending], dict[str, Metric]],
    plots: Callable[[Log], list[Plot]],
    idealizations: list[str],
    previous: Callable[[MPC, Timing, float], None] | None = None,
) -> Scenario:
    """One run of a task. ``previous`` is called at every tick. Raises :class:`InputError` for pushes that are no whole number of
    controller periods."""
    for push in task.pushes:
        whole("length", push.length, 1.0 / settings.control.rate, "controller periods")
    chosen = settings.controller
    system = ball_system(settings, chosen, seed, task.arm, task.references)
    plant, controller, log = system.plant, system.controller, Log()
    joints: JointRecord | None = None
    if isinstance(chosen, WholeBodyMpc):
        robot = controller.robot
        if isinstance(chosen.disturbance, MpcDisturbance):
            speed = chosen.disturbance.max_pushed_speed
            controller.learned.lean_control = LeanControl(robot, task.arm, chosen.cost.lean, speed)
        if isinstance(chosen.estimator, PushFilter) and chosen.estimator.expected_push_time > 0.0:
            controller.learned.push_estimator = PushEstimator(robot, task.arm, chosen.estimator.expected_push_time)
        joints = JointRecord(log, robot, System(plant, controller, system.mpc, system.timing))
    rows, ticks = RezeroRecord(log, plant, controller), count()

    def record(t: float, command: Any, plans: Any) -> None:
        if previous is not None:
            previous(system.mpc, system.timing, t)
        rows.add(t, controller.torque)
        log.add("feedback", t, controller.target - controller.feedforward)
        if joints is not None and next(ticks) % JOINT_ROWS == 0:
            log.add("input", t, plans.current.feedforward(t))
            joints.tick(t, plant.truth(), plans)
        if task.pushes:
            active = [p.force for p in task.pushes if p.start <= t + 1e-9 < p.start + p.length]
            plant.push(np.sum(active, axis=0) if active else np.zeros(3))

    loop = system.loop(task.duration, record)
    return Scenario.single(
        log, lambda progress: replace(loop.run(progress), mpc=system.planner or system.mpc),
        lambda run: {**metrics(log, run.ending), **estimator_metrics(log), **fault_metrics(controller)},
        lambda run: [*plots(log), *(joints.plots() if joints else ())], [*idealizations, *IDEALIZATIONS],
    )  # fmt: skip


class RezeroRecord:
    """The channels of every experiment: truth, torques, disturbance and, with an estimator, what it believes."""

    def __init__(self, log: Log, plant: BallPlant, controller: BallController) -> None:
        self._controller, robot = controller, controller.robot
        others: dict[str, int | None] = {"torque": controller.torque.size, "disturbance": ball_base(robot).nq}
        if controller.learned.payload is not None:
            others["payload"] = None
        if controller.estimator is not None:
            others["rolling_fault"] = None
        self._record = TruthRecord(log, plant, others, controller.estimator is not None)
        self._size = robot.state.size
        _label(log, robot)

    def add(self, t: float, torque: np.ndarray) -> None:
        """A row at time t [s], with the ``torque`` (nu) of the drives [N m]."""
        values, controller = self._record.values, self._controller
        values["torque"][:], values["disturbance"][:] = torque, controller.learned.disturbance
        if controller.learned.payload is not None:
            values["payload"][0] = controller.learned.payload.mass
        if controller.estimator is None:
            self._record.add(t)
            return
        faults = controller.estimator.filter.faults
        values["rolling_fault"][0] = float(any(not f.startswith("imu") for f in faults))
        self._record.add(t, controller.state()[: self._size])


def _label(log: Log, robot: RobotModel) -> None:
    own, inputs = robot.state, robot.input
    driven, torques = ([*groups["wheel"], *groups["arm"]] for groups in (inputs.groups, inputs.unit_groups))
    forces = [force_unit(unit) for unit in (*own.unit_groups["base"], *own.unit_groups["arm"])]
    for channel, names, units in (
        ("state", own.names, own.units), ("estimate", own.names, own.units), ("torque", driven, torques), ("feedback", driven, torques),
        ("disturbance", robot.base.parameters["disturbance"], forces),
    ):  # fmt: skip
        log.label(channel, names, units)
