"""`swerve-unified`: the end effector holds a pose in the world while the base drives, turns and reconfigures itself.

The title's "simultaneous navigation, reconfiguration, and manipulation" (Pankert et al. 2022, abstract and section III-A).
With ``legs=support`` the leg targets are left out, and the margin of the zero-moment point in the support triangles is the
objective in their place: the alternative that section III-A names.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from wbmpc.bases.base import System
from wbmpc.bases.swerve.brake_control import BrakeControl
from wbmpc.bases.swerve.brake_supervision import SupervisionSettings
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import ROLLING_SOFTNESS, swerve_problem
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.plant import SwervePlant, reject_two_wheels
from wbmpc.bases.swerve.steering_planner import SteeringGuess
from wbmpc.bases.swerve.tracking import TrackingSettings
from wbmpc.errors import InputError
from wbmpc.experiment import Experiment, Loop, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Constraint, Reference, RelaxedBarrier, residuals, sets
from wbmpc.stability import StanceOf, configuration_positions, region_margin, support_triangles
from wbmpc.stability.geometry import Triangle
from wbmpc.studies.pankert2022.definitions import DEFINITIONS
from wbmpc.studies.pankert2022.metrics import in_frame
from wbmpc.studies.pankert2022.mission import Leg, Mission, Reconfiguration, at_home
from wbmpc.studies.pankert2022.standing import stand_still
from wbmpc.studies.pankert2022.track_references import END_EFFECTOR_ORIENTATION
from wbmpc.studies.pankert2022.unified_figures import metrics, plots
from wbmpc.studies.pankert2022.unified_settings import AT_HOME, SwerveUnifiedSettings
from wbmpc.studies.pankert2022.wheel_log import swerve_robot
from wbmpc.studies.paths import Approach
from wbmpc.tasks.joint_figures import JointRecord
from wbmpc.types import Timing

NAME = "swerve-unified"
SUMMARY = "the end effector holds a world pose while the base drives 2 m, turns 90 degrees and goes from X to A"

IDEALIZATIONS = [
    "the contact points lie under the steer axes; tires are soft contacts, not a tire model",
    "the arm's joints are velocity servos; the weight that is fed forward is that of the simulated arm",
    "the computation takes a constant 10 ms; legs' and arm's encoder offsets are not calibrated",
    "the time that a brake takes to open and to close is assumed, and known to the planner",
]
#: Where the end effector holds still [m], how long the base drives [s], when the brakes open and close after that began [s].
HOLD, DRIVE, OPENS, CLOSES = (1.0, 0.5, 0.9), 15.0, 1.0, 11.0
#: Where the base goes: 2 m ahead, turned by 90°.
GOAL = (2.0, 0.0, 0.5 * np.pi)


def rear_triangles(robot: RobotModel, legs: np.ndarray) -> tuple[Triangle, ...]:
    """The support triangles over the two rearmost feet and each other one, legs at ``legs`` (n) [rad]: of four feet two, whose
    overlap is the large region of A; of three the one that there is."""
    feet = swerve_base(robot).geometry.steer_axes(legs)
    rear = set(np.argsort(feet[:, 0], kind="stable")[:2].tolist())
    return tuple(t for t in support_triangles(feet) if rear < set(t))


def _start(robot: RobotModel, settings: SwerveUnifiedSettings) -> np.ndarray:
    """The state (nx) with the legs where they begin."""
    if settings.leg_start == AT_HOME:
        return robot.home
    return at_home(robot, configuration_positions(robot, settings.leg_start))


def _reconfigurations(robot: RobotModel, settings: SwerveUnifiedSettings, opens: float) -> tuple[Reconfiguration, ...]:
    """To the legs' goal, once the brakes are open; none without a goal."""
    if settings.legs.kind == "support":
        return ()
    try:
        return (Reconfiguration(opens, configuration_positions(robot, settings.legs.goal)),)
    except InputError as error:
        legs = swerve_base(robot).geometry.modules
        raise InputError(
            f"{error}; valid for legs.goal: angles, as [{', '.join(['0.2'] * legs)}]; or legs=support"
        ) from None


def _problem(robot: RobotModel, home: np.ndarray, settings: SwerveUnifiedSettings) -> Any:
    cost = settings.cost
    legs = settings.legs
    if legs.kind == "support":
        cost = cost.model_copy(update={"state": cost.state.model_copy(update={"leg": 0.0})})
    ocp = swerve_problem(robot, settings.mpc, cost, ROLLING_SOFTNESS, accelerations=True)
    if legs.kind == "support":
        margin = residuals.SupportMargin(robot, rear_triangles(robot, home[robot.state["leg"]]))
        barrier = RelaxedBarrier(legs.weight, legs.reserve)
        ocp.add(Constraint("support", margin, sets.NonNegative(), at="path+terminal", penalty=barrier))
    return ocp


def _labeled_log(robot: RobotModel) -> Log:
    """A log with the names and units of its channels by joints."""
    log, joints = Log(), robot.description.base.joint_groups()
    for channel, group in (("leg", "leg"), ("leg_reference", "leg"), ("steer", "steer")):
        log.label(channel, joints[group], "rad")
    log.label("wheel_slip", joints["wheel"], "m/s")
    log.label("state", robot.state.names, robot.state.units)
    return log


def build(settings: SwerveUnifiedSettings, seed: int) -> Scenario:
    """One run; docs/reference/metrics.md says what each metric means."""
    robot = swerve_robot(settings.robot)
    if "leg" not in robot.state:
        raise InputError(f"robot: '{settings.robot}' has fixed legs, it cannot reconfigure; valid: a base with hinges")
    reject_two_wheels(robot.description)  # before advice about their legs
    approach = Approach(robot.pose(robot.home), (np.array(HOLD), END_EFFECTOR_ORIENTATION))
    begin = approach.duration + 1.0
    home = _start(robot, settings)
    opens = begin + OPENS + settings.plant.brake_delay
    mission = Mission(
        (Leg(begin, DRIVE, GOAL),), home[robot.state["leg"]],
        _reconfigurations(robot, settings, opens),
        ((begin + OPENS, 1.0), (begin + CLOSES, 0.0)),
    )  # fmt: skip
    duration = float(np.ceil((begin + DRIVE + 3.0) * 10.0) / 10.0)
    guess = SteeringGuess(robot, mission.preview)
    mpc = MPC(_problem(robot, home, settings), settings.mpc.solver(), settings.mpc.rate, guess=guess)
    mission.set(mpc, robot, home, duration)
    t = np.arange(0.0, duration + 0.02, 0.02)
    mpc.reference["end_effector"] = Reference.poses(t, np.array(HOLD) + approach.offset(t)[0], approach.offset(t)[1])
    brakes = BrakeControl(robot, delay=settings.plant.brake_delay, changed=mpc.set_schedule)
    mission.apply(brakes)
    plant = SwervePlant(
        robot.description, robot.state.split(home), settings.plant, seed, localization=settings.global_poses(seed)
    )
    timing = Timing.of(plant.timestep, settings.control.rate, settings.mpc.rate, settings.mpc.computation_delay)
    controller = SwerveController(
        robot, plant.truth().pose, timing.period, brakes, tracking=TrackingSettings(lag=settings.actuator_time_constant),
        estimation=settings.estimation(robot, seed),
        supervision=SupervisionSettings(guard=settings.leg_guard, report=brakes.accept),
    )  # fmt: skip
    stand_still(plant, controller, timing, settings.settle_time)
    mpc.reset(home)
    log, stance_of = _labeled_log(robot), StanceOf(robot)
    joints = JointRecord(log, robot, System(plant, controller, mpc, timing))

    def record(now: float, command: Any, plans: Any) -> None:
        if round(now / timing.period) % 4:
            return
        truth, pose, m = plant.truth(), controller.estimator.odometry.pose, controller.measured
        assert m is not None
        stance = stance_of(truth.state)
        log.add("base", now, truth.pose)
        log.add("base_odometry", now, pose)
        log.add("base_reference", now, mission.base(now)[0][0])
        log.add("hand", now, truth.tool)
        log.add("hand_odometry", now, in_frame(pose, truth.tool_in_base, truth.tool[2]))
        log.add("hand_reference", now, np.array(HOLD) + approach.offset(now)[0][0])
        log.add("leg", now, truth.state[robot.state["leg"]])
        log.add("leg_reference", now, mission.leg(now)[0][0])
        log.add("brake", now, command.brake)
        log.add("steer", now, m.steer)
        log.add("state", now, truth.state)
        log.add("input", now, plans.current.feedforward(now))
        joints.tick(now, truth, plans)
        log.add("wheel_slip", now, truth.slip)
        log.add("support_margin", now, [float(region_margin(stance.feet, stance.zmp)), stance.polygon_margin])

    return Scenario.single(
        log, Loop(plant, controller, mpc, timing, duration, record).run,
        lambda run: metrics(log, begin, settings.legs.kind == "support", len(controller.faults), controller.holds),
        lambda run: [*plots(log, robot, begin), *joints.plots()], IDEALIZATIONS,
    )  # fmt: skip


EXPERIMENT = Experiment.of(NAME, SUMMARY, SwerveUnifiedSettings, build, DEFINITIONS[NAME])
