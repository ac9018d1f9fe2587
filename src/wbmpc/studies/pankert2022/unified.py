"""`swerve-unified`: the hand holds a pose in the world while the base drives, turns and reconfigures itself.

The title's "simultaneous navigation, reconfiguration, and manipulation" (Pankert et al. 2022, abstract and section III-A).
With ``legs=support`` the leg targets are left out, and the margin of the zero-moment point in the support triangles is the
objective in their place: the alternative that section III-A names.
"""

from __future__ import annotations

from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from wbmpc.bases.swerve.brake_control import BrakeControl
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import ROLLING_COMPLIANCE, StateCost, SwerveCost, swerve_problem
from wbmpc.bases.swerve.plant import SwervePlant, refuse_two_wheels
from wbmpc.bases.swerve.steering_planner import SteeringGuess
from wbmpc.errors import InputError
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Constraint, Reference, RelaxedBarrier, residuals, sets
from wbmpc.result import Drawing, Metric, Plot, RunResult, Series
from wbmpc.settings import ExperimentSettings, Weight, finished
from wbmpc.simulation.lockstep import Progress, Timing, run_lockstep
from wbmpc.stability import StanceOf, draw, leg_angles, region_margin, support_triangles
from wbmpc.stability.assessment import Assessment
from wbmpc.stability.geometry import Triangle, overlap_regions
from wbmpc.studies.pankert2022.calibrate import swerve_robot
from wbmpc.studies.pankert2022.mission import Leg, Mission, Reconfiguration, at_home
from wbmpc.studies.pankert2022.track import HAND_ORIENTATION, in_frame, stand_still
from wbmpc.studies.paths import Approach

NAME = "swerve-unified"
SUMMARY = "the hand holds a world pose while the base drives 2 m, turns 90 degrees and goes from X to A"

IDEALISATIONS = [
    "the contact points lie under the steer axes; tyres are soft contacts, not a tyre model",
    "the arm's joints are velocity servos; the weight that is fed forward is that of the simulated arm",
    "the computation takes a constant 10 ms; legs' and arm's encoder offsets are not calibrated",
    "the time that a brake takes to open and to close is assumed, and known to the planner",
]
#: Where the hand holds still [m], how long the base drives [s], when the brakes open and close after that began [s].
HOLD, DRIVE, OPENS, CLOSES = (1.0, 0.5, 0.9), 15.0, 1.0, 11.0
#: Where the base goes: 2 m ahead, turned by 90°.
GOAL = (2.0, 0.0, 0.5 * np.pi)
#: Errors of the base [m, rad] at the end with which it counts as there; what may keep it from there.
THERE, TURNED = 0.05, 0.05
REACH_NOTE = "the hand weighs more: where the arm does not reach what it holds from the goal, the base ends short of it"
#: Where the legs begin if nothing else is said.
AT_HOME = "home"
#: A configuration by name (H, X, A), or angles [rad], one for each leg.
Configuration = str | tuple[float, ...]


class SwerveUnifiedSettings(ExperimentSettings):
    """``legs``: by targets (from ``leg_start`` to ``leg_goal``: H, X, A, or angles [rad] in brackets, one for each leg; the robot's
    home and A if nothing is said) or free, with the zero-moment point's margin in the support triangles over the two rearmost feet
    as the objective of ``support`` weight per second (a logarithmic barrier, quadratic below ``reserve`` [m]), and without a goal;
    ``use_gyro``, ``rest``, ``drive_lag``: as in swerve-track; ``leg_guard``: see :class:`wbmpc.bases.swerve.controller.SwerveController`."""

    cost: SwerveCost = SwerveCost(state=StateCost(position=20.0, yaw=20.0, leg=100.0))
    robot: str = "swerve-ur10"
    legs: Literal["targets", "support"] = "targets"
    leg_start: Configuration = AT_HOME
    leg_goal: Configuration = "A"
    support: Weight = 0.05
    reserve: float = Field(0.05, gt=0, le=0.5)
    use_gyro: bool = True
    rest: float = Field(20.0, ge=0, le=120)
    drive_lag: float = Field(0.020, ge=0, le=0.5)
    leg_guard: bool = True

    @model_validator(mode="after")
    def _read(self) -> Self:
        """What the chosen way of the legs does not read is refused."""
        unread = ("leg_goal",) if self.legs == "support" else ("support", "reserve")
        self.refuse_unread(f"with legs={self.legs}", *unread)
        return self


def rear_triangles(robot: RobotModel, legs: np.ndarray) -> tuple[Triangle, ...]:
    """The support triangles over the two rearmost feet and each other one, legs at ``legs`` (n) [rad]: of four feet two, whose
    overlap is the large region of A; of three the one that there is."""
    feet = robot.base.geometry.steer_axes(legs)
    rear = set(np.argsort(feet[:, 0], kind="stable")[:2].tolist())
    return tuple(t for t in support_triangles(feet) if rear < set(t))


def _start(robot: RobotModel, settings: SwerveUnifiedSettings) -> np.ndarray:
    """The state (nx) with the legs where they begin."""
    if settings.leg_start == AT_HOME:
        return robot.home
    return at_home(robot, leg_angles(robot, settings.leg_start))


def _goal(robot: RobotModel, settings: SwerveUnifiedSettings) -> np.ndarray:
    """Leg angles (n) [rad] of the goal."""
    try:
        return leg_angles(robot, settings.leg_goal)
    except InputError as error:
        legs = robot.base.geometry.modules
        raise InputError(
            f"{error}; valid for leg_goal: angles, as [{', '.join(['0.2'] * legs)}]; or legs=support"
        ) from None


def _problem(robot: RobotModel, home: np.ndarray, settings: SwerveUnifiedSettings) -> Any:
    cost = settings.cost
    free = settings.legs == "support"
    if free:
        cost = cost.model_copy(update={"state": cost.state.model_copy(update={"leg": 0.0})})
    ocp = swerve_problem(robot, settings.mpc, cost, ROLLING_COMPLIANCE, accelerations=True)
    if free:
        margin = residuals.SupportMargin(robot, rear_triangles(robot, home[robot.state["leg"]]))
        barrier = RelaxedBarrier(settings.support, settings.reserve)
        ocp.add(Constraint("support", margin, sets.NonNegative(), at="all", penalty=barrier))
    return ocp


def run(settings: SwerveUnifiedSettings, seed: int, progress: Progress | None = None) -> RunResult:
    """One run; docs/reference/metrics.md says what each metric means."""
    robot = swerve_robot(settings.robot)
    if "leg" not in robot.state:
        raise InputError(f"robot: '{settings.robot}' has fixed legs, it cannot reconfigure; valid: a base with hinges")
    refuse_two_wheels(robot.description)  # before advice about their legs
    approach = Approach(robot.pose(robot.home), (np.array(HOLD), HAND_ORIENTATION))
    begin = approach.duration + 1.0
    home, free = _start(robot, settings), settings.legs == "support"
    opens = begin + OPENS + settings.plant.brake_delay
    mission = Mission(
        (Leg(begin, DRIVE, GOAL),), home[robot.state["leg"]],
        () if free else (Reconfiguration(opens, _goal(robot, settings)),),
        ((begin + OPENS, 1.0), (begin + CLOSES, 0.0)),
    )  # fmt: skip
    duration = float(np.ceil((begin + DRIVE + 3.0) * 10.0) / 10.0)
    guess = SteeringGuess(robot, mission.preview)
    mpc = MPC(_problem(robot, home, settings), settings.mpc.solver(), settings.mpc.rate, guess=guess)
    mission.set(mpc, robot, home, duration)
    t = np.arange(0.0, duration + 0.02, 0.02)
    mpc.reference["hand"] = Reference.poses(t, np.array(HOLD) + approach.offset(t)[0], approach.offset(t)[1])
    brakes = BrakeControl(robot, delay=settings.plant.brake_delay, changed=mpc.set_schedule)
    mission.apply(brakes)
    plant = SwervePlant(robot.description, robot.state.split(home), settings.plant, seed)
    timing = Timing.of(plant.timestep, settings.control.rate, settings.mpc.rate, settings.mpc.delay)
    agent = SwerveController(
        robot, plant.truth().pose, timing.period, brakes, leg_guard=settings.leg_guard,
        use_gyro=settings.use_gyro, lag=settings.drive_lag, faulty=brakes.accept,
    )  # fmt: skip
    stand_still(plant, agent, timing, settings.rest)
    mpc.reset(home)
    log, stance_of = Log(), StanceOf(robot)

    def record(now: float, command: Any, plans: Any) -> None:
        if round(now / timing.period) % 4:
            return
        truth, pose, m = plant.truth(), agent.odometry.pose, agent.measured
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
        log.add("wheel_slip", now, truth.slip)
        log.add("support_margin", now, [float(region_margin(stance.feet, stance.zmp)), stance.polygon_margin])

    ending = run_lockstep(plant, agent, mpc, timing, duration, record, progress)
    return finished(
        NAME, seed, settings, ending, mpc, log,
        metrics=lambda: _metrics(log, begin, free, len(agent.faults), agent.holds),
        plots=lambda: _plots(log, robot, begin), idealisations=IDEALISATIONS, faults=agent.faults,
    )  # fmt: skip


def _rms(values: np.ndarray) -> float:
    """Root of the mean square of the rows' lengths."""
    return float(np.sqrt(np.mean(np.sum(np.atleast_2d(values.T).T ** 2, axis=1))))


def _metrics(log: Log, begin: float, free: bool, faults: int, held: int) -> dict[str, Metric]:
    use = log.times("hand") >= begin
    if not use.any():
        use[:] = True
    error = lambda a, b: (log.array(a) - log.array(b))[use]
    base = log.array("base")[use]
    drift = error("base_reference", "base_odometry")
    margins = log.array("support_margin")[use]
    metrics = {
        "hand_error_rms": Metric(_rms(error("hand_odometry", "hand_reference")), "m", goal=0.005),
        "hand_error_max": Metric(float(np.linalg.norm(error("hand_odometry", "hand_reference"), axis=1).max()), "m"),
        "hand_error_rms_world": Metric(_rms(error("hand", "hand_reference")), "m"),
        "base_travel": Metric(float(np.sum(np.hypot(*np.diff(base[:, :2], axis=0).T))), "m"),
        "base_position_error_rms": Metric(_rms(drift[:, :2]), "m"),
        "base_yaw_error_rms": Metric(_rms(drift[:, 2:]), "rad"),
        "base_position_error_end": Metric(float(np.hypot(*drift[-1, :2])), "m", goal=THERE, goal_note=REACH_NOTE),
        "base_yaw_error_end": Metric(float(abs(drift[-1, 2])), "rad", goal=TURNED, goal_note=REACH_NOTE),
        "support_margin_end": Metric(float(margins[-1, 0]), "m"),
        "support_margin_min": Metric(float(margins[:, 0].min()), "m"),
        "wheel_slip_max": Metric(float(log.array("wheel_slip")[use].max()), "m/s"),
        "brake_faults": Metric(float(faults), "1", goal=0.0),
        "legs_held": Metric(float(held), "1"),
    }
    if not free:
        opened = log.array("brake")[use].max(axis=1) > 0.5
        legs = error("leg", "leg_reference")[opened]
        metrics["leg_angle_error_rms"] = Metric(float(np.sqrt(np.mean(legs**2))) if legs.size else 0.0, "rad")
    return metrics


def _plots(log: Log, robot: RobotModel, begin: float) -> list[Plot | Drawing]:
    t, base, odometry, wanted = (log.times("base"), *map(log.array, ("base", "base_odometry", "base_reference")))
    hand, legs, goals = log.array("hand_odometry"), np.degrees(log.array("leg")), np.degrees(log.array("leg_reference"))
    margins = 1e3 * log.array("support_margin")
    names = [n.removeprefix("leg_") for n in robot.state.groups["leg"]]
    error = lambda a: 1e3 * np.linalg.norm(log.array(a) - log.array("hand_reference"), axis=1)
    use = t >= begin
    return [
        Plot("Base and hand from above", "x [m]", "y [m]", [
            Series("base", base[:, 0], base[:, 1]), Series("base, reference", wanted[:, 0], wanted[:, 1], dashed=True),
            Series("hand, estimated frame", hand[use, 0], hand[use, 1]),
        ], equal_axes=True),
        Plot("Hand error", "time [s]", "error [mm]", [
            Series("estimated frame", t[use], error("hand_odometry")[use]), Series("world", t[use], error("hand")[use]),
        ]),
        Plot("Base error, estimated frame", "time [s]", "error [mm, mrad]", [
            Series(n, t, 1e3 * (odometry - wanted)[:, k]) for k, n in enumerate(("x", "y", "yaw"))
        ]),
        Plot("Leg angles", "time [s]", "angle [deg]", [
            *(Series(n, t, legs[:, k]) for k, n in enumerate(names)),
            *(Series(f"{n}, wanted", t, goals[:, k], dashed=True) for k, n in enumerate(names)),
        ]),
        Plot("Zero-moment point", "time [s]", "margin [mm]", [
            Series("to the next triangle", t, margins[:, 0]), Series("to the polygon", t, margins[:, 1]),
        ]),
        _picture(robot, "At the start", log.array("state")[int(np.argmax(use))]),
        _picture(robot, "At the end", log.array("state")[-1]),
    ]  # fmt: skip


def _picture(robot: RobotModel, title: str, x: np.ndarray) -> Drawing:
    """The stance at a state, in axes of the base."""
    x = x.copy()
    x[robot.state["base"]] = 0.0
    stance = StanceOf(robot)(x)
    return Drawing(title, draw(Assessment(robot, "angles", x, stance, overlap_regions(stance.feet))))
