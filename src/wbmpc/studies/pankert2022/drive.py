"""`swerve-drive`: through a door in H, X and A while driving and turning, over bumps and cables (Pankert et al. 2022, section
IV-B, Fig. 7 and 8); a leg that is knocked; driving with closed brakes; the rolling inverse kinematics as baseline."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, cast

import numpy as np

from wbmpc.bases.swerve.brake_control import BrakeControl
from wbmpc.bases.swerve.brake_supervision import SupervisionSettings
from wbmpc.bases.swerve.configurations import CONFIGURATIONS
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.plant import reject_two_wheels
from wbmpc.errors import InputError
from wbmpc.experiment import Experiment, Loop, Outcome, Part, Run, Scenario
from wbmpc.result import Metric
from wbmpc.simulation.lockstep import Progress
from wbmpc.studies.pankert2022.definitions import DEFINITIONS
from wbmpc.studies.pankert2022.drive_course import terrain
from wbmpc.studies.pankert2022.drive_figures import baseline_metrics, metrics, plots
from wbmpc.studies.pankert2022.drive_missions import Knock, SwerveDriveSettings, straight, tour
from wbmpc.studies.pankert2022.driving import LidarPoses
from wbmpc.studies.pankert2022.mission import Mission, ramps
from wbmpc.studies.pankert2022.mission_run import MissionRun
from wbmpc.studies.pankert2022.rolling import RollingController, RollingGains
from wbmpc.studies.pankert2022.standing import stand_still
from wbmpc.studies.pankert2022.wheel_log import swerve_robot
from wbmpc.types import Timing

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


def _baseline(
    bench: MissionRun, s: SwerveDriveSettings, mission: Mission, duration: float, edit: Any = None,
    progress: Progress | None = None,
) -> Outcome:  # fmt: skip
    """The rolling inverse kinematics on the same way: same plant, odometry and brakes."""
    robot, name = bench.robot, "baseline"
    _, plant = bench.start(mission, edit)
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
        brakes, estimation=bench.estimation, supervision=SupervisionSettings(guard=False),
    )  # fmt: skip
    part = robot.state["arm"]
    controller.posture = lambda t: tuple(way[0] for way in ramps(robot.home[part], mission.arm, t))  # type: ignore[return-value, assignment]
    stand_still(plant, controller, timing, s.settle_time)

    def record(now: float, command: Any, plans: Any) -> None:
        if round(now / timing.period) % 4 == 0:
            bench.record(name, now, plant.truth(), controller, mission, command)

    return Loop(plant, controller, None, timing, duration, record).run(progress)


def _baseline_alone(bench: MissionRun, settings: SwerveDriveSettings, mission: Mission, duration: float) -> Scenario:
    """The tour with the baseline."""
    drive = partial(_baseline, bench, settings, mission, duration, terrain)
    of = lambda run: baseline_metrics(bench.log, not run.ending.reason)
    return Scenario.single(bench.log, drive, of, lambda run: [], IDEALIZATIONS)


def build(settings: SwerveDriveSettings, seed: int) -> Scenario:
    """The tour with the MPC and with the baseline, the knock, and driving with closed brakes."""
    robot = swerve_robot(settings.robot)
    if "leg" not in robot.state:
        raise InputError(f"robot: '{settings.robot}' has fixed legs, it cannot reconfigure; valid: a base with hinges")
    reject_two_wheels(robot.description)
    mission, duration = tour(robot, settings.plant.brake_delay)
    bench = MissionRun.of(settings, robot, seed)
    if settings.baseline_only:
        return _baseline_alone(bench, settings, mission, duration)
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
            isinstance(settings.localization, LidarPoses),
        )

    closed = {f"closed_{name}": straight(robot, name, False) for name in CONFIGURATIONS}
    return Scenario(
        bench.log,
        [
            Part("tour", lambda progress: bench.planned("tour", mission, duration, terrain, progress=progress)[0]),
            Part("baseline", partial(_baseline, bench, settings, mission, duration, terrain), baseline=True),
            Part("knock", partial(aside, "knock", *straight(robot, "X", True), 4.0)),
            *(Part(name, partial(aside, name, *way, None)) for name, way in closed.items()),
        ],
        measured, lambda run: [*plots(bench.log, robot), *bench.joint_plots()], IDEALIZATIONS,
    )  # fmt: skip


EXPERIMENT = Experiment.of(NAME, SUMMARY, SwerveDriveSettings, build, DEFINITIONS[NAME])
