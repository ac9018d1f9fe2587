"""`swerve-drive`: through a door in H, X and A while driving and turning, over bumps and cables (Pankert et al. 2022, section
IV-B, Fig. 7 and 8); a leg that is knocked; driving with closed brakes; the rolling inverse kinematics as baseline."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import mujoco
import numpy as np

from wbmpc.bases.swerve.brake_control import BrakeControl
from wbmpc.bases.swerve.brake_supervision import SupervisionSettings
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import swerve_mpc
from wbmpc.bases.swerve.estimator import EstimatorSettings
from wbmpc.bases.swerve.plant import SwervePlant, reject_two_wheels
from wbmpc.bases.swerve.steering_planner import SteeringGuess
from wbmpc.bases.swerve.tracking import TrackingSettings
from wbmpc.errors import InputError
from wbmpc.experiment import Experiment, Loop, Outcome, Part, Run, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.ocp import Reference
from wbmpc.result import Metric
from wbmpc.simulation.lockstep import Progress, Timing
from wbmpc.stability import CONFIGURATIONS, corners
from wbmpc.studies.pankert2022.definitions import DEFINITIONS
from wbmpc.studies.pankert2022.drive_course import terrain
from wbmpc.studies.pankert2022.drive_figures import baseline_metrics, metrics, plots
from wbmpc.studies.pankert2022.drive_missions import Knock, SwerveDriveSettings, straight, tour
from wbmpc.studies.pankert2022.mission import Mission, at_home, carried_poses, ramps
from wbmpc.studies.pankert2022.rolling import RollingController, RollingGains
from wbmpc.studies.pankert2022.standing import stand_still
from wbmpc.studies.pankert2022.wheel_log import swerve_robot

NAME = "swerve-drive"
SUMMARY = (
    "through a door in H, X and A while driving and turning, over bumps and cables (Pankert et al. 2022, Fig. 7, 8)"
)

IDEALIZATIONS = [
    "the contact points lie under the steer axes; tires are soft contacts, not a tire model",
    "bumps are smooth and of the floor's mean friction; the door's posts are rigid",
    "the computation takes a constant 10 ms, the baseline's too",
    "the time that a brake takes to open and to close is assumed, and known to the planner",
]


@dataclass(frozen=True)
class _Run:
    """What every run of this experiment shares."""

    settings: SwerveDriveSettings
    robot: RobotModel
    seed: int
    log: Log
    estimation: EstimatorSettings  # what every controller knows of the wheels

    @classmethod
    def of(cls, settings: SwerveDriveSettings, robot: RobotModel, seed: int) -> _Run:
        return cls(settings, robot, seed, Log(), settings.estimation(robot, seed))

    def start(
        self, mission: Mission, edit: Callable[[mujoco.MjSpec], None] | None = None
    ) -> tuple[np.ndarray, SwervePlant]:
        home = at_home(self.robot, mission.legs)
        plant = SwervePlant(
            self.robot.description, self.robot.state.split(home), self.settings.plant, self.seed, edit=edit,
            localization=self.settings.global_poses(self.seed),
        )  # fmt: skip
        return home, plant

    def record(
        self, name: str, t: float, plant: SwervePlant, controller: SwerveController, mission: Mission, command: Any
    ) -> None:
        truth, add = plant.truth(), self.log.add
        add(f"{name}.base", t, truth.pose)
        add(f"{name}.base_odometry", t, controller.pose)
        add(f"{name}.base_reference", t, mission.base(t)[0][0])
        add(f"{name}.leg", t, truth.state[self.robot.state["leg"]])
        add(f"{name}.leg_reference", t, mission.leg(t)[0][0])
        add(f"{name}.brake", t, command.brake)
        add(f"{name}.wheel_slip", t, truth.slip)
        add(f"{name}.wheel_force", t, truth.wheel_force)
        add(f"{name}.wanted", t, controller.target)
        speeds = [truth.joint_speeds[n] for g in ("leg", "steer", "wheel") for n in self.robot.input.groups[g]]
        add(f"{name}.joint_speed", t, speeds)
        add(f"{name}.steer", t, truth.state[self.robot.state["steer"]])

    def planned(
        self, name: str, mission: Mission, duration: float, edit: Any = None, knock: float | None = None,
        progress: Progress | None = None,
    ) -> tuple[Outcome, Knock | None]:  # fmt: skip
        """With the MPC. A knock comes at ``knock`` [s], without the guard of open legs, which would stop the leg on its way."""
        s, robot = self.settings, self.robot
        home, plant = self.start(mission, edit)
        mpc = swerve_mpc(robot, s.mpc, s.cost, SteeringGuess(robot, mission.preview))
        mission.set(mpc, robot, home, duration + s.mpc.horizon)
        t = np.arange(0.0, duration, 0.1)
        mpc.reference["end_effector"] = Reference.poses(t, *carried_poses(robot, home, mission.base(t)[0]))
        brakes = BrakeControl(robot, delay=s.plant.brake_delay, changed=mpc.set_schedule)
        mission.apply(brakes)
        timing = Timing.of(plant.timestep, s.control.rate, s.mpc.rate, s.mpc.computation_delay)
        controller = SwerveController(
            robot, plant.truth().pose, timing.period, brakes, tracking=TrackingSettings(lag=s.actuator_time_constant),
            estimation=self.estimation,
            supervision=SupervisionSettings(guard=s.leg_guard and knock is None, report=brakes.accept),
        )  # fmt: skip
        stand_still(plant, controller, timing, s.settle_time)
        mpc.reset(home)
        hit = None if knock is None else Knock(knock, plant, plant.time, corners(robot)["LF"])
        plant.external = hit

        def record(now: float, command: Any, plans: Any) -> None:
            if round(now / timing.period) % 4 == 0:
                self.record(name, now, plant, controller, mission, command)

        return Loop(plant, controller, mpc, timing, duration, record).run(progress), hit

    def baseline(
        self, mission: Mission, duration: float, edit: Any = None, progress: Progress | None = None
    ) -> Outcome:
        """The rolling inverse kinematics on the same way: same plant, odometry and brakes."""
        s, robot, name = self.settings, self.robot, "baseline"
        _, plant = self.start(mission, edit)
        timing = Timing.of(plant.timestep, s.control.rate, s.mpc.rate, s.mpc.computation_delay)
        brakes = BrakeControl(robot)
        mission.apply(brakes)

        def goals(t: float) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
            (pose, rate), (leg, leg_rate) = mission.base(t), mission.leg(t)
            return (pose[0], rate[0]), (leg[0], leg_rate[0])

        controller = RollingController(
            robot, plant.truth().pose, timing.period, goals,
            RollingGains(s.baseline_base_gain, s.baseline_leg_gain, s.baseline_steer_gain, s.baseline_lead, s.baseline_look_ahead,
                s.mpc.computation_delay),
            brakes.commanded, estimation=self.estimation,
        )  # fmt: skip
        part = robot.state["arm"]
        controller.posture = lambda t: tuple(way[0] for way in ramps(robot.home[part], mission.arm, t))  # type: ignore[return-value, assignment]
        stand_still(plant, controller, timing, s.settle_time)

        def record(now: float, command: Any, plans: Any) -> None:
            if round(now / timing.period) % 4 == 0:
                self.record(name, now, plant, controller, mission, command)

        return Loop(plant, controller, None, timing, duration, record).run(progress)


def _baseline_alone(bench: _Run, mission: Mission, duration: float) -> Scenario:
    """The tour with the baseline."""
    drive = partial(bench.baseline, mission, duration, terrain)
    of = lambda run: baseline_metrics(bench.log, not run.ending.reason)
    return Scenario.single(bench.log, drive, of, lambda run: [], IDEALIZATIONS)


def build(settings: SwerveDriveSettings, seed: int) -> Scenario:
    """The tour with the MPC and with the baseline, the knock, and driving with closed brakes."""
    robot = swerve_robot(settings.robot)
    if "leg" not in robot.state:
        raise InputError(f"robot: '{settings.robot}' has fixed legs, it cannot reconfigure; valid: a base with hinges")
    reject_two_wheels(robot.description)
    mission, duration = tour(robot, settings.plant.brake_delay)
    bench = _Run.of(settings, robot, seed)
    if settings.baseline_only:
        return _baseline_alone(bench, mission, duration)
    knocks: list[Knock | None] = []

    def aside(name: str, mission: Mission, duration: float, knock: float | None, progress: Progress | None) -> Outcome:
        outcome, hit = bench.planned(name, mission, duration, knock=knock, progress=progress)
        knocks.append(hit)
        return replace(outcome, mpc=None)  # the solves of the tour count

    def measured(run: Run) -> dict[str, Metric]:
        faults = [fault for name, o in run.outcomes.items() if name != "baseline" for fault in o.faults]
        held, baseline = cast(SwerveController, run.outcomes["tour"].controller).holds, run.outcomes.get("baseline")
        knocked = knocks[0].done if knocks and knocks[0] is not None else None
        return metrics(
            bench.log,
            robot,
            faults,
            held,
            knocked,
            None if baseline is None else baseline.ending,
            settings.localization == "lidar",
        )

    closed = {f"closed_{name}": straight(robot, name, False) for name in CONFIGURATIONS}
    return Scenario(
        bench.log,
        [
            Part("tour", lambda progress: bench.planned("tour", mission, duration, terrain, progress=progress)[0]),
            Part("baseline", lambda progress: bench.baseline(mission, duration, terrain, progress), baseline=True),
            Part("knock", partial(aside, "knock", *straight(robot, "X", True), 4.0)),
            *(Part(name, partial(aside, name, *way, None)) for name, way in closed.items()),
        ],
        measured, lambda run: plots(bench.log, robot), IDEALIZATIONS,
    )  # fmt: skip


EXPERIMENT = Experiment.of(NAME, SUMMARY, SwerveDriveSettings, build, DEFINITIONS[NAME])
