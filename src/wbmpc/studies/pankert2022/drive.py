"""`swerve-drive`: through a door in H, X and A while driving and turning, over bumps and cables (Pankert et al. 2022, section
IV-B, Fig. 7 and 8); a leg that is knocked; driving with closed brakes; the rolling inverse kinematics as rival."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from pydantic import Field

from wbmpc.bases.swerve.brake_control import BrakeControl
from wbmpc.bases.swerve.calibration_log import swerve_robot
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import HandCost, InputCost, StateCost, SwerveCost, swerve_mpc
from wbmpc.bases.swerve.plant import SwervePlant, refuse_two_wheels
from wbmpc.bases.swerve.steering_planner import SteeringGuess
from wbmpc.errors import InputError
from wbmpc.experiments import Experiment
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.result import RunResult
from wbmpc.settings import ExperimentSettings, finished
from wbmpc.simulation.lockstep import Ending, Progress, Timing, part, run_lockstep
from wbmpc.stability import CONFIGURATIONS, corners, leg_angles
from wbmpc.studies.pankert2022.drive_course import terrain
from wbmpc.studies.pankert2022.drive_figures import metrics, plots
from wbmpc.studies.pankert2022.mission import Leg, Mission, Reconfiguration, at_home, riding
from wbmpc.studies.pankert2022.rolling import RollingController
from wbmpc.studies.pankert2022.track import stand_still

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
#: A knock [rad] of the left front leg by a torque [N m] up to a speed [rad/s].
KNOCK, KNOCK_TORQUE, KNOCK_SPEED = np.radians(5.0), 150.0, 0.3


class SwerveDriveSettings(ExperimentSettings):
    """``use_gyro``, ``rest``, ``drive_lag``: as in swerve-track; ``leg_guard`` (MPC), ``odd_wheels`` (MPC and rival): see
    :class:`wbmpc.bases.swerve.controller.SwerveController`. ``rival_…``: gains [1/s] for base, legs and steering; by how much
    [s] it reads its goals ahead, and how soon [s] a motion begins for which its wheels turn while it rests (see
    :class:`wbmpc.studies.pankert2022.rolling.RollingController`)."""

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
    leg_guard: bool = True
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
        self, name: str, t: float, plant: SwervePlant, agent: SwerveController, mission: Mission, command: Any
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
    ) -> tuple[Ending, MPC, SwerveController, _Knock | None]:  # fmt: skip
        """With the MPC. A knock comes at ``knock`` [s], without the guard of open legs, which would stop the leg on its way."""
        s, robot = self.settings, self.robot
        home, plant = self.start(mission, edit)
        mpc = swerve_mpc(robot, s.mpc, s.cost, SteeringGuess(robot, mission.preview))
        mission.set(mpc, robot, home, duration + s.mpc.horizon)
        t = np.arange(0.0, duration, 0.1)
        mpc.reference["hand"] = Reference.poses(t, *riding(robot, home, mission.base(t)[0]))
        brakes = BrakeControl(robot, delay=s.plant.brake_delay, changed=mpc.set_schedule)
        mission.apply(brakes)
        timing = Timing.of(plant.timestep, s.control.rate, s.mpc.rate, s.mpc.delay)
        agent = SwerveController(
            robot, plant.truth().pose, timing.period, brakes, lag=s.drive_lag, leg_guard=s.leg_guard and knock is None,
            use_gyro=s.use_gyro, odd_wheels=s.odd_wheels, faulty=brakes.accept,
        )  # fmt: skip
        stand_still(plant, agent, timing, s.rest)
        mpc.reset(home)
        hit = None if knock is None else _Knock(knock, plant, plant.time, corners(robot)["LF"])
        plant.external = hit

        def record(now: float, command: Any, plans: Any) -> None:
            if round(now / timing.period) % 4 == 0:
                self.record(name, now, plant, agent, mission, command)

        ending = run_lockstep(plant, agent, mpc, timing, duration, record, progress)
        return ending, mpc, agent, hit

    def rival(
        self, mission: Mission, duration: float, edit: Any = None, progress: Progress | None = None
    ) -> tuple[Ending, list[str]]:
        """The rolling inverse kinematics on the same way: same plant, odometry and brakes. How it ended, and the faults that
        it found."""
        s, robot, name = self.settings, self.robot, "rival"
        _, plant = self.start(mission, edit)
        timing = Timing.of(plant.timestep, s.control.rate, s.mpc.rate, s.mpc.delay)
        brakes = BrakeControl(robot)
        mission.apply(brakes)

        def goals(t: float) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
            (pose, rate), (leg, leg_rate) = mission.base(t), mission.leg(t)
            return (pose[0], rate[0]), (leg[0], leg_rate[0])

        agent = RollingController(
            robot, plant.truth().pose, timing.period, goals, s.rival_base_gain, s.rival_leg_gain, s.rival_steer_gain,
            lead=s.rival_lead, look_ahead=s.rival_look_ahead, brakes=brakes.commanded, use_gyro=s.use_gyro,
            odd_wheels=s.odd_wheels,
        )  # fmt: skip
        stand_still(plant, agent, timing, s.rest)

        def record(now: float, command: Any, plans: Any) -> None:
            if round(now / timing.period) % 4 == 0:
                self.record(name, now, plant, agent, mission, command)

        ending = run_lockstep(plant, agent, None, timing, duration, record, progress)
        return ending, [f"{name}: {fault}" for fault in agent.faults]


def _faults(name: str, agent: SwerveController) -> list[str]:
    """What the monitor of brakes told in a part of the run."""
    return [f"{name}: {fault}" for fault in agent.faults]


def rival_on_tour(settings: SwerveDriveSettings, seed: int) -> np.ndarray:
    """Pose errors (k, 3) in the estimated frame of the rival alone on the tour, for the search of gains; infinite if it fell or
    ended early for another reason."""
    robot, log = swerve_robot(settings.robot), Log()
    mission, duration = tour(robot, settings.plant.brake_delay)
    ending, _ = _Run(settings, robot, seed, log).rival(mission, duration, terrain)
    error = log.array("rival.base_odometry") - log.array("rival.base_reference")
    return np.full_like(error, np.inf) if ending.reason else error


def run(settings: SwerveDriveSettings, seed: int, progress: Progress | None = None) -> RunResult:
    """The tour with the MPC and with the rival, the knock, and driving with closed brakes."""
    robot = swerve_robot(settings.robot)
    if "leg" not in robot.state:
        raise InputError(f"robot: '{settings.robot}' has fixed legs, it cannot reconfigure; valid: a base with hinges")
    refuse_two_wheels(robot.description)
    bench = _Run(settings, robot, seed, Log())
    mission, duration = tour(robot, settings.plant.brake_delay)
    names = ("tour", "rival", "knock", *(f"closed_{name}" for name in CONFIGURATIONS))
    own = lambda name: part(progress, names.index(name), len(names), name)
    ending, mpc, agent, _ = bench.planned("tour", mission, duration, terrain, progress=own("tour"))
    faults, held = _faults("tour", agent), agent.holds
    rival, rivals, knock = None, list[str](), None
    if not ending.reason:
        rival, rivals = bench.rival(mission, duration, terrain, own("rival"))
        if rival.reason and not rival.interrupted:  # the rival's failure, not the run's
            rivals.append(f"rival: {rival.reason}; nothing is compared with it")
        ending = rival if rival.interrupted else ending
    if not ending.reason:
        way, length = straight(robot, "X", True)
        ending, _, agent, knock = bench.planned("knock", way, length, knock=4.0, progress=own("knock"))
        faults += _faults("knock", agent)
    for name in CONFIGURATIONS:
        if not ending.reason:
            key = f"closed_{name}"
            ending, _, agent, _ = bench.planned(key, *straight(robot, name, False), progress=own(key))
            faults += _faults(key, agent)
    return finished(
        NAME, seed, settings, ending, mpc, bench.log,
        metrics=lambda: metrics(bench.log, robot, faults, held, None if knock is None else knock.done, rival),
        plots=lambda: plots(bench.log, robot),
        idealisations=IDEALISATIONS, faults=[*faults, *rivals],
    )  # fmt: skip


EXPERIMENT = Experiment(NAME, SUMMARY, SwerveDriveSettings, run)
