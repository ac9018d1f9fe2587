"""`swerve-drive`: through a door in H, X and A while driving and turning, over bumps and cables (Pankert et al. 2022, section
IV-B, Fig. 7 and 8); a leg that is knocked; driving with closed brakes; the rolling inverse kinematics as rival."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from pydantic import Field

from wbmpc.control import BrakeControl, RollingAgent, SwerveAgent
from wbmpc.errors import InputError
from wbmpc.estimation import BrakeMonitor
from wbmpc.experiments.mission import Leg, Mission, Reconfiguration, at_home, riding
from wbmpc.experiments.settings import ExperimentSettings, finished
from wbmpc.experiments.storyboard import Ground, Snapshot, storyboard
from wbmpc.experiments.swerve_calibrate import swerve_robot
from wbmpc.experiments.swerve_problem import HandCost, InputCost, StateCost, SwerveCost, swerve_mpc
from wbmpc.experiments.swerve_track import _stand
from wbmpc.log import Log
from wbmpc.loop import Ending, Progress, Timing, part, run_lockstep, watched
from wbmpc.model import RobotModel
from wbmpc.mpc import MPC, SteeringGuess
from wbmpc.ocp import Reference
from wbmpc.plant import SwervePlant
from wbmpc.plant.swerve import STEER_SPEED, WHEEL_SPEED
from wbmpc.plant.world import GROUND
from wbmpc.result import Drawing, Metric, Plot, RunResult, Series
from wbmpc.stability import CONFIGURATIONS, corners, leg_angles

NAME = "swerve-drive"
SUMMARY = (
    "through a door in H, X and A while driving and turning, over bumps and cables (Pankert et al. 2022, Fig. 7, 8)"
)

IDEALISATIONS = [
    "the contact points lie under the steer axes; tyres are soft contacts, not a tyre model",
    "bumps are smooth and of the floor's mean friction; the door is a gap that is measured, drawn but not hit",
    "the computation takes a constant 10 ms; the rival's takes none",
    "the time that a brake takes to open and to close is assumed, and known to the planner",
]
SPEED_NOTE = (
    "nothing but the wheel moves a leg: one that a bump pushes, or whose wheel comes down again, is not held back"
)
#: The door [m]: where it is, its width. Half widths [m] of the body and of a leg with its wheel (for the clearance).
DOOR, DOOR_WIDTH, BODY, LEG_HALF = 3.0, 0.90, (0.451, 0.400), 0.045
#: Half lengths [m] of the posts that are drawn beside the gap.
POST, POST_COLOUR = (0.03, 0.05, 1.0), (0.55, 0.40, 0.28, 1.0)
#: Bumps (x, y) [m] of 15 mm and cables (x) of 10 mm radius [m].
BUMPS = ((6.0, 0.6), (9.5, 0.5), (10.5, -0.5), (11.5, 0.2), (12.5, -0.6))
BUMP_HEIGHT, BUMP_RADIUS, CABLES, CABLE_RADIUS = 0.015, 0.30, (9.0, 12.0), 0.010
#: How far [m] two pictures of the storyboard are apart.
STORY = 1.3
#: Speed [rad/s] of a hinge (Pankert et al. 2022); a wheel that carries less [N] is off the ground; how long [s] after that its
#: leg is still on the way back to its reference.
HINGE_SPEED, UNLOADED, COMING_BACK = 0.5, 5.0, 1.0
#: A knock [rad] of the left front leg by a torque [N m] up to a speed [rad/s]; the error [rad] at which it has recovered.
KNOCK, KNOCK_TORQUE, KNOCK_SPEED, RECOVERED = np.radians(5.0), 150.0, 0.3, np.radians(1.0)


class SwerveDriveSettings(ExperimentSettings):
    """``use_gyro``, ``rest``, ``drive_lag``: as in swerve-track; ``odd_wheels`` (MPC and rival): see
    :class:`wbmpc.control.SwerveAgent`. ``rival_…``: gains [1/s] for base, legs and steering; by how much
    [s] it reads its goals ahead, and how soon [s] a motion begins for which its wheels turn while it rests (see
    :class:`wbmpc.control.RollingAgent`)."""

    # by runs on seed 0, looked at on seed 5
    cost: SwerveCost = SwerveCost(
        hand=HandCost(weight=0.0, orientation=0.0),
        state=StateCost(position=30_000.0, yaw=9000.0, leg=300.0, arm=1.0),
        input=InputCost(base=5.0, steer=0.002),
    )
    robot: str = "swerve-ur10"
    use_gyro: bool = True
    odd_wheels: bool = False
    rest: float = Field(20.0, ge=0, le=120)
    drive_lag: float = Field(0.020, ge=0, le=0.5)
    # of a search that benchmarks/rivals.py does, of which only a part was run
    rival_base_gain: float = Field(8.0, ge=0, le=50)
    rival_leg_gain: float = Field(8.0, ge=0, le=50)
    rival_steer_gain: float = Field(40.0, gt=0, le=100)
    rival_lead: float = Field(0.0, ge=0, le=0.5)
    rival_look_ahead: float = Field(0.0, ge=0, le=5)


def tour(robot: RobotModel, delay: float) -> tuple[Mission, float]:
    """The whole way and its duration [s]: the door in H, X, then A and X again while turning by 180°, and H."""
    h, x, a = (leg_angles(robot, name) for name in "HXA")
    quarter, end = 0.5 * np.pi, 18.0
    # The base never stops while its brakes are open (at rest the wheels would have to turn before anything can move), and
    # is so fast that no wheel comes to a stop while it turns: then none has to turn about in place.
    way = (
        Leg(1.0, 61.5, (end, 0.0, 0.0)),
        Leg(20.0, 10.0, (end, 0.0, -quarter)),
        Leg(30.0, 18.0, (end, 0.0, quarter)),
        Leg(48.0, 10.0, (end, 0.0, 0.0)),
    )
    turns = (
        Reconfiguration(15.0 + delay, x),
        Reconfiguration(31.0, a),
        Reconfiguration(40.0, x),
        Reconfiguration(54.0, h),
    )
    return Mission(way, h, turns, ((15.0, 1.0), (58.5, 0.0))), 65.0


def straight(robot: RobotModel, name: str, is_open: bool) -> tuple[Mission, float]:
    """1.5 m ahead with a quarter turn of 0.3 rad in one configuration, brakes open or closed."""
    brakes = ((0.5, 1.0),) if is_open else ()
    return Mission((Leg(1.0, 8.0, (1.5, 0.2, 0.3)),), leg_angles(robot, name), (), brakes), 10.0


@dataclass
class _Knock:
    """Pushes the left front leg inwards from ``start`` [s] until it has gone by 5°."""

    start: float
    plant: SwervePlant
    offset: float
    module: int
    dof: int = field(init=False)
    at: float = field(init=False, default=np.nan)
    done: float = field(init=False, default=np.nan)

    def __post_init__(self) -> None:
        joint = self.plant.model.joint(self.plant.base.modules[self.module].hinge or "")
        self.dof, self._place = int(joint.dofadr[0]), int(joint.qposadr[0])

    def __call__(self, m: mujoco.MjModel, d: mujoco.MjData) -> None:
        t = self.plant.time - self.offset
        angle = float(d.qpos[self._place])
        if t < self.start or not np.isnan(self.done):
            d.qfrc_applied[self.dof] = 0.0
            return
        if np.isnan(self.at):
            self.at = angle
        d.qfrc_applied[self.dof] = -KNOCK_TORQUE if abs(d.qvel[self.dof]) < KNOCK_SPEED else 0.0
        if abs(angle - self.at) >= KNOCK or t > self.start + 1.0:
            self.done = t


def terrain(spec: mujoco.MjSpec) -> None:
    """Bumps and cables on the floor, and the door's posts, which are seen but touch nothing."""
    for side in (-1.0, 1.0):
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=POST, pos=[DOOR, side * (0.5 * DOOR_WIDTH + POST[1]), POST[2]],
            rgba=POST_COLOUR, contype=0, conaffinity=0,
        )  # fmt: skip
    common = {"friction": [0.75, 0.005, 1e-4], "solref": [0.01, 1.0], **GROUND}
    for x, y in BUMPS:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
            size=[BUMP_RADIUS, BUMP_RADIUS, BUMP_HEIGHT],
            pos=[x, y, 0.0],
            **common,
        )
    for x in CABLES:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[x, -2.0, 0.0, x, 2.0, 0.0], size=[CABLE_RADIUS, 0, 0], **common
        )


@dataclass(frozen=True)
class _Run:
    """What every run of this experiment shares."""

    settings: SwerveDriveSettings
    robot: RobotModel
    seed: int
    log: Log

    def start(
        self, mission: Mission, edit: Callable[[mujoco.MjSpec], None] | None = None
    ) -> tuple[np.ndarray, SwervePlant]:
        home = at_home(self.robot, mission.legs)
        plant = SwervePlant(
            self.robot.description, self.robot.state.split(home), self.settings.plant, self.seed, edit=edit
        )
        return home, plant

    def record(
        self, name: str, t: float, plant: SwervePlant, agent: SwerveAgent, mission: Mission, command: Any
    ) -> None:
        truth, add = plant.truth(), self.log.add
        add(f"{name}.base", t, truth.pose)
        add(f"{name}.base_odometry", t, agent.pose)
        add(f"{name}.base_reference", t, mission.base(t)[0][0])
        add(f"{name}.leg", t, truth.state[self.robot.state["leg"]])
        add(f"{name}.leg_reference", t, mission.leg(t)[0][0])
        add(f"{name}.brake", t, command.brake)
        add(f"{name}.wheel_slip", t, truth.slip)
        add(f"{name}.wheel_force", t, truth.wheel_force)
        add(f"{name}.wanted", t, agent.wanted)
        speeds = [truth.joint_speeds[n] for g in ("leg", "steer", "wheel") for n in self.robot.input.groups[g]]
        add(f"{name}.joint_speed", t, speeds)
        add(f"{name}.steer", t, truth.state[self.robot.state["steer"]])

    def planned(
        self, name: str, mission: Mission, duration: float, edit: Any = None, knock: float | None = None,
        progress: Progress | None = None,
    ) -> tuple[Ending, MPC, list[str], _Knock | None]:  # fmt: skip
        """With the MPC. The knock, if any, comes at ``knock`` [s]."""
        s, robot = self.settings, self.robot
        home, plant = self.start(mission, edit)
        mpc = swerve_mpc(robot, s.mpc, s.cost, SteeringGuess(robot, mission.preview))
        mission.set(mpc, robot, home, duration + s.mpc.horizon)
        t = np.arange(0.0, duration, 0.1)
        mpc.reference["hand"] = Reference.poses(t, *riding(robot, home, mission.base(t)[0]))
        brakes = BrakeControl(robot, delay=s.plant.brake_delay, changed=mpc.set_schedule)
        mission.apply(brakes)
        timing = Timing.of(plant.timestep, s.control.rate, s.mpc.rate, s.mpc.delay)
        agent = SwerveAgent(
            robot, plant.truth().pose, timing.period, brakes.commanded, lag=s.drive_lag,
            use_gyro=s.use_gyro, odd_wheels=s.odd_wheels,
            monitor=BrakeMonitor(robot.state.groups["leg"], limit=robot.limits.input_upper[robot.input["leg"]]),
            faulty=brakes.accept,
        )  # fmt: skip
        _stand(plant, agent, timing, s.rest)
        mpc.reset(home)
        hit = None if knock is None else _Knock(knock, plant, plant.time, corners(robot)["LF"])
        plant.external = hit

        def record(now: float, command: Any, plans: Any) -> None:
            if round(now / timing.period) % 4 == 0:
                self.record(name, now, plant, agent, mission, command)

        ending = run_lockstep(plant, agent, mpc, timing, duration, record, progress)
        assert agent.monitor is not None
        return ending, mpc, [str(f) for f in agent.monitor.faults], hit

    def rival(self, mission: Mission, duration: float, edit: Any = None, progress: Progress | None = None) -> None:
        """The rolling inverse kinematics on the same way: same plant, odometry and brakes."""
        s, robot, name = self.settings, self.robot, "rival"
        _, plant = self.start(mission, edit)
        timing = Timing.of(plant.timestep, s.control.rate, s.mpc.rate, s.mpc.delay)
        brakes = BrakeControl(robot)
        mission.apply(brakes)

        def goals(t: float) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
            (pose, rate), (leg, leg_rate) = mission.base(t), mission.leg(t)
            return (pose[0], rate[0]), (leg[0], leg_rate[0])

        agent = RollingAgent(
            robot, plant.truth().pose, timing.period, goals, s.rival_base_gain, s.rival_leg_gain, s.rival_steer_gain,
            lead=s.rival_lead, look_ahead=s.rival_look_ahead, brakes=brakes.commanded, use_gyro=s.use_gyro,
            odd_wheels=s.odd_wheels,
        )  # fmt: skip
        _stand(plant, agent, timing, s.rest)
        with watched(plant, timing.period, duration, progress, agent) as tick:
            for k in range(round(duration / timing.period)):
                t = k * timing.period
                agent.measure(plant.measure())
                command = agent.drive(t)
                if k % 4 == 0:
                    self.record(name, t, plant, agent, mission, command)
                tick(t, command)
                plant.step(command, timing.steps)
                if plant.fell:
                    break


def rival_on_tour(settings: SwerveDriveSettings, seed: int) -> np.ndarray:
    """Pose errors (k, 3) in the estimated frame of the rival alone on the tour, for the search of gains; infinite if it fell."""
    robot, log = swerve_robot(settings.robot), Log()
    mission, duration = tour(robot, settings.plant.brake_delay)
    _Run(settings, robot, seed, log).rival(mission, duration, terrain)
    error = log.array("rival.base_odometry") - log.array("rival.base_reference")
    return error if log.times("rival.base")[-1] > duration - 0.1 else np.full_like(error, np.inf)


def run(settings: SwerveDriveSettings, seed: int, progress: Progress | None = None) -> RunResult:
    """The tour with the MPC and with the rival, the knock, and driving with closed brakes."""
    robot = swerve_robot(settings.robot)
    if "leg" not in robot.state:
        raise InputError(f"robot: '{settings.robot}' has fixed legs, it cannot reconfigure; valid: a base with hinges")
    bench = _Run(settings, robot, seed, Log())
    mission, duration = tour(robot, settings.plant.brake_delay)
    names = ("tour", "rival", "knock", *(f"closed_{name}" for name in CONFIGURATIONS))
    own = lambda name: part(progress, names.index(name), len(names), name)
    ending, mpc, faults, _ = bench.planned("tour", mission, duration, terrain, progress=own("tour"))
    if not ending.reason:
        bench.rival(mission, duration, terrain, own("rival"))
    knock = None
    if not ending.reason:
        way, length = straight(robot, "X", True)
        ending, _, more, knock = bench.planned("knock", way, length, knock=4.0, progress=own("knock"))
        faults += more
    for name in CONFIGURATIONS:
        if not ending.reason:
            key = f"closed_{name}"
            ending, _, more, _ = bench.planned(key, *straight(robot, name, False), progress=own(key))
            faults += more
    return finished(
        NAME, seed, settings, ending, mpc, bench.log,
        metrics=lambda: _metrics(bench.log, robot, faults, knock), plots=lambda: _plots(bench.log, robot),
        idealisations=IDEALISATIONS,
    )  # fmt: skip


def _error(log: Log, name: str) -> tuple[float, float]:
    """Root mean squares of position [m] and yaw [rad] in the estimated frame."""
    d = log.array(f"{name}.base_odometry") - log.array(f"{name}.base_reference")
    return float(np.sqrt(np.mean(np.sum(d[:, :2] ** 2, axis=1)))), float(np.sqrt(np.mean(d[:, 2] ** 2)))


def _leg_error(log: Log, name: str) -> float:
    """Root mean square [rad] over all legs while their brakes are open."""
    use = log.array(f"{name}.brake").max(axis=1) > 0.5
    d = (log.array(f"{name}.leg") - log.array(f"{name}.leg_reference"))[use]
    return float(np.sqrt(np.mean(d**2))) if d.size else 0.0


def in_the_air(log: Log, name: str) -> np.ndarray:
    """Which wheels (k, n) are off the ground: on a floor that is not even a rigid robot stands on three."""
    return log.array(f"{name}.wheel_force") < UNLOADED


def _leg_error_on_ground(log: Log, name: str) -> float:
    """Root mean square [rad] over legs whose wheels are on the ground, and have been for a while, brakes open.

    Nothing can move a leg whose wheel hangs in the air.
    """
    t, air = log.times(f"{name}.leg"), in_the_air(log, name)
    count = max(int(np.searchsorted(t, t[0] + COMING_BACK)), 1)
    late = np.stack([np.convolve(a, np.ones(count))[: a.size] > 0 for a in air.T.astype(float)], axis=1)
    use = (log.array(f"{name}.brake").max(axis=1) > 0.5)[:, None] & ~late
    d = (log.array(f"{name}.leg") - log.array(f"{name}.leg_reference"))[use]
    return float(np.sqrt(np.mean(d**2))) if d.size else 0.0


def recovery(t: np.ndarray, error: np.ndarray, end: float) -> float:
    """Time [s] from ``end`` until an error (k,) stays below 1°; infinite if it never does."""
    late = np.flatnonzero((t >= end) & (np.abs(error) >= RECOVERED))
    if late.size and late[-1] == t.size - 1:
        return float("inf")
    return float(max(t[late[-1] + 1] - end, 0.0)) if late.size else 0.0


def clearance(robot: RobotModel, poses: np.ndarray, legs: np.ndarray) -> float:
    """Smallest distance [m] of body and wheels to the posts of the door on the way (poses (k, 3), leg angles (k, n))."""
    least = np.inf
    corners = np.array([[x, y] for x in (-BODY[0], BODY[0]) for y in (-BODY[1], BODY[1])])
    posts = np.array([[DOOR, 0.5 * DOOR_WIDTH], [DOOR, -0.5 * DOOR_WIDTH]])
    near = np.abs(poses[:, 0] - DOOR) < 1.2
    for (x, y, yaw), leg in zip(poses[near], legs[near], strict=True):
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        feet = robot.base.geometry.steer_axes(leg)
        points = np.vstack([corners, feet + [0.0, LEG_HALF], feet - [0.0, LEG_HALF]]) @ turn.T + [x, y]
        # the outline between its corners is widest at them
        inside = np.abs(points[:, 0] - DOOR) < 0.05
        if inside.any():
            least = min(least, float(np.min(posts[0, 1] - np.abs(points[inside, 1]))))
    return float(least)


def _metrics(log: Log, robot: RobotModel, faults: list[str], knock: _Knock | None) -> dict[str, Metric]:
    position, yaw = _error(log, "tour")
    metrics = {
        "base_position_error_rms": Metric(position, "m", goal=0.008),
        "base_yaw_error_rms": Metric(yaw, "rad", goal=float(np.radians(0.8))),
        "leg_angle_error_rms": Metric(_leg_error(log, "tour"), "rad", goal=float(np.radians(1.5))),
        "wheel_slip_max": Metric(float(log.array("tour.wheel_slip").max()), "m/s"),
        "door_clearance": Metric(clearance(robot, log.array("tour.base"), log.array("tour.leg")), "m", least=0.0),
        "leg_angle_error_rms_on_ground": Metric(_leg_error_on_ground(log, "tour"), "rad", goal=float(np.radians(1.5))),
        "wheel_off_ground_share": Metric(float(in_the_air(log, "tour").any(axis=1).mean()), "1"),
        "planned_speed_ratio_max": Metric(_planned_ratio(log, robot), "1", goal=1.001),
        "joint_speed_ratio_max": Metric(_speed_ratio(log), "1", goal=1.0, goal_note=SPEED_NOTE),
        "brake_faults": Metric(float(len(faults)), "1", goal=0.0),
    }
    if "rival.base" in log.channels:
        rival = _error(log, "rival")
        metrics["baseline_position_error_rms"] = Metric(rival[0], "m")
        metrics["baseline_yaw_error_rms"] = Metric(rival[1], "rad")
        metrics["baseline_leg_angle_error_rms"] = Metric(_leg_error(log, "rival"), "rad")
        metrics["baseline_ratio"] = Metric(position / rival[0], "1", goal=0.5)
    if knock is not None and "knock.leg" in log.channels:
        error = (log.array("knock.leg") - log.array("knock.leg_reference"))[:, corners(robot)["LF"]]
        metrics["leg_knock"] = Metric(float(np.abs(error).max()), "rad")
        metrics["leg_recovery_time"] = Metric(recovery(log.times("knock.leg"), error, knock.done), "s", goal=2.0)
    closed = [_error(log, f"closed_{n}")[0] for n in CONFIGURATIONS if f"closed_{n}.base" in log.channels]
    if closed:
        metrics["closed_position_error_rms"] = Metric(max(closed), "m", goal=0.008)
    return metrics


def _planned_ratio(log: Log, robot: RobotModel) -> float:
    """Planned speeds of legs, wheels and steering (with its servo) over the planner's limits."""
    index = np.concatenate([np.arange(robot.input.size)[robot.input[g]] for g in ("leg", "steer", "wheel")])
    return float((np.abs(log.array("tour.wanted")) / robot.limits.drive_upper)[:, index].max())


def _speed_ratio(log: Log) -> float:
    """True speeds over the limits of hinges, steering and wheels."""
    speed, n = np.abs(log.array("tour.joint_speed")), log.array("tour.leg").shape[1]
    return float((speed / np.repeat([HINGE_SPEED, STEER_SPEED, WHEEL_SPEED], n)).max())


def _story(log: Log, robot: RobotModel) -> Drawing:
    """The tour from above (Fig. 8)."""
    t, base = log.times("tour.base"), log.array("tour.base")
    legs, steers, brakes = (log.array(f"tour.{n}") for n in ("leg", "steer", "brake"))
    far = np.maximum.accumulate(base[:, 0])
    indices = np.searchsorted(far, np.arange(far[0], far[-1] + 1e-9, STORY))
    shots = [Snapshot(float(t[k]), base[k], legs[k], steers[k], brakes[k] > 0.5) for k in indices]
    posts = [(DOOR, side * (0.5 * DOOR_WIDTH + POST[1]), *POST[:2]) for side in (-1.0, 1.0)]
    ground = Ground(posts, [(x, y, BUMP_RADIUS) for x, y in BUMPS], CABLES)
    return Drawing("The tour from above (Fig. 8)", storyboard(robot.base.geometry, BODY, base[::20, :2], shots, ground))


def _plots(log: Log, robot: RobotModel) -> list[Plot | Drawing]:
    t, base, wanted = log.times("tour.base"), log.array("tour.base"), log.array("tour.base_reference")
    names = [n.removeprefix("leg_") for n in robot.state.groups["leg"]]
    legs, goals = np.degrees(log.array("tour.leg")), np.degrees(log.array("tour.leg_reference"))
    size = lambda name: (
        1e3 * np.linalg.norm((log.array(f"{name}.base_odometry") - log.array(f"{name}.base_reference"))[:, :2], axis=1)
    )
    runs = [
        (n, label) for n, label in (("tour", "MPC"), ("rival", "inverse kinematics")) if f"{n}.base" in log.channels
    ]
    plots: list[Plot | Drawing] = [
        _story(log, robot),
        Plot("Base from above", "x [m]", "y [m]", [
            Series("true", base[:, 0], base[:, 1]), Series("reference", wanted[:, 0], wanted[:, 1], dashed=True),
        ], equal_axes=True),
        Plot("Base pose (Fig. 7)", "time [s]", "x, y [m], yaw [rad]", [
            *(Series(n, t, base[:, k]) for k, n in enumerate(("x", "y", "yaw"))),
            *(Series(f"{n}, reference", t, wanted[:, k], dashed=True) for k, n in enumerate(("x", "y", "yaw"))),
        ]),
        Plot("Leg angles (Fig. 7)", "time [s]", "angle [deg]", [
            *(Series(n, t, legs[:, k]) for k, n in enumerate(names)),
            *(Series(f"{n}, wanted", t, goals[:, k], dashed=True) for k, n in enumerate(names)),
        ]),
        Plot("Base error, estimated frame", "time [s]", "error [mm]", [
            Series(label, log.times(f"{n}.base"), size(n)) for n, label in runs
        ]),
        Plot("Leg errors", "time [s]", "error [deg]", [
            Series(f"{label}, largest", log.times(f"{n}.leg"),
                   np.degrees(np.abs(log.array(f"{n}.leg") - log.array(f"{n}.leg_reference")).max(axis=1)))
            for n, label in runs
        ]),
    ]  # fmt: skip
    if "knock.leg" in log.channels:
        error = np.degrees(log.array("knock.leg") - log.array("knock.leg_reference"))
        series = [Series(n, log.times("knock.leg"), error[:, k]) for k, n in enumerate(names)]
        plots.append(Plot("A leg is knocked", "time [s]", "error [deg]", series))
    return plots
