"""`legs`: the tour of `swerve-drive` without its door, for a base with any legs: 3 to 8 of them, on hinges or sliding.

No configuration is named: the stances are the one with the largest margin of support, and that within a given width
(:func:`wbmpc.stability.best_stance`).
"""

from __future__ import annotations

from typing import cast

import numpy as np
from pydantic import Field

from wbmpc.arrays import Array
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.plant import reject_two_wheels
from wbmpc.errors import InputError
from wbmpc.experiment import Experiment, Run, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.result import Drawing, Metric, Plot, Series
from wbmpc.settings import Robot
from wbmpc.stability import best_stance
from wbmpc.studies.pankert2022.definitions import DEFINITIONS
from wbmpc.studies.pankert2022.drive_course import uneven_floor
from wbmpc.studies.pankert2022.drive_figures import ODOMETRY_ALONE, WITH_LIDAR, story, tour_metrics
from wbmpc.studies.pankert2022.drive_missions import TOUR, MissionSettings, tour_way
from wbmpc.studies.pankert2022.driving import LidarPoses
from wbmpc.studies.pankert2022.metrics import rms
from wbmpc.studies.pankert2022.mission import Mission, Reconfiguration
from wbmpc.studies.pankert2022.mission_run import MissionRun
from wbmpc.studies.pankert2022.wheel_log import swerve_robot
from wbmpc.units import by_unit, scale, with_unit

NAME = "legs"
#: When [s] the brakes open for another stance, and whether that is the wide one.
CHANGES = ((15.0, True), (32.0, False), (40.0, True), (54.0, False))
#: Legs move at this share of their speed limit; their brakes close so long [s] after they should be there.
SHARE, AFTER = 0.6, 0.5
#: Goal [m] of the feet while legs move: 1.5 degrees of the hinged legs of `swerve-drive`.
FEET = 0.011

IDEALIZATIONS = [
    "the contact points lie under the steer axes; tires are soft contacts, not a tire model",
    "bumps are smooth and of the floor's mean friction",
    "the computation takes a constant 10 ms",
    "the time that a brake takes to open and to close is assumed, and known to the planner",
]


class LegsSettings(MissionSettings):
    """``half_width`` [m]: in the narrow stance steer axes are within it of the body's axis. The other settings are those of
    `swerve-drive`."""

    robot: Robot = "pentapod-ur10"
    half_width: float = Field(0.38, gt=0, le=10)


def legs_tour(robot: RobotModel, half_width: float, delay: float) -> Mission:
    """The tour's way, in turn in the narrow stance and in the wide one; ``delay`` [s]: of the brakes."""
    wide, narrow = best_stance(robot), best_stance(robot, half_width)
    rate = SHARE * float(robot.limits.input_upper[robot.input["leg"]].min())
    length = float(np.abs(wide - narrow).max()) / rate + delay + AFTER
    changes = tuple(Reconfiguration(t + delay, wide if is_wide else narrow, rate) for t, is_wide in CHANGES)
    starts = np.array([t for t, _ in CHANGES])
    if (late := float(np.max(starts[:-1] + length - starts[1:], initial=-np.inf))) > 0.0:
        raise InputError(
            f"{NAME}: legs of '{robot.description.name}' take {length:.1f} s from the narrow to the wide stance at {rate:.3g} per s, "
            f"{late:.1f} s more than the tour gives them; valid: faster legs, or a larger half_width"
        )
    brakes = tuple(event for t in starts.tolist() for event in ((t, 1.0), (t + length, 0.0)))
    return Mission(tour_way(), narrow, changes, brakes)


def feet(robot: RobotModel, legs: Array) -> Array:
    """Steer axes (k, n, 2) [m] in the body's frame for positions of the legs (k, n)."""
    return np.array([swerve_base(robot).geometry.steer_axes(leg) for leg in legs])


def figures(log: Log, robot: RobotModel) -> dict[str, Metric]:
    """How well the legs follow: of all legs while any brake is open, and where the run ends."""
    error = feet(robot, log.array("tour.leg")) - feet(robot, log.array("tour.leg_reference"))
    moving = log.array("tour.brake").max(axis=1) > 0.5
    width = 2.0 * np.abs(feet(robot, log.array("tour.leg"))[..., 1]).max(axis=1)
    off = error[moving].reshape(-1, 2)
    return {
        "foot_error_rms": Metric(rms(off) if off.size else 0.0, "m", goal=FEET),
        "foot_error_end": Metric(float(np.linalg.norm(error[-1], axis=1).max()), "m"),
        "stance_width_min": Metric(float(width.min()), "m", larger_is_better=True),
        "stance_width_max": Metric(float(width.max()), "m"),
    }


def plots(log: Log, robot: RobotModel) -> list[Plot | Drawing]:
    """The tour from above, the base's errors, legs and their references."""
    t, target = log.times("tour.base"), log.array("tour.base_reference")
    off = [1e3 * np.linalg.norm((log.array(f"tour.{n}") - target)[:, :2], axis=1) for n in ("base", "base_odometry")]
    legs, goals, names = log.array("tour.leg"), log.array("tour.leg_reference"), robot.state.groups["leg"]
    return [
        story(log, robot, "The tour from above"),
        Plot("Base error", "time [s]", "error [mm]", [
            Series(n, t, e) for n, e in zip(("world", "estimated frame"), off, strict=True)
        ]),
        *(Plot("Legs", "time [s]", with_unit("position", read.unit), [
            *(Series(names[k], t, read.factor * legs[:, k]) for k in places),
            *(Series(f"{names[k]}, reference", t, read.factor * goals[:, k], dashed=True) for k in places),
        ]) for unit, places in by_unit(robot.state.unit_groups["leg"]).items() for read in [scale(unit)]),
    ]  # fmt: skip


def build(settings: LegsSettings, seed: int) -> Scenario:
    """One run."""
    robot = swerve_robot(settings.robot)
    if "leg" not in robot.state:
        raise InputError(f"robot: '{settings.robot}' has fixed legs, it has one stance; valid: a base whose legs move")
    reject_two_wheels(robot.description)
    mission = legs_tour(robot, settings.half_width, settings.plant.brake_delay)
    bench = MissionRun.of(settings, robot, seed)
    near = WITH_LIDAR if isinstance(settings.localization, LidarPoses) else ODOMETRY_ALONE

    def measured(run: Run) -> dict[str, Metric]:
        outcome = run.outcomes[""]
        held = cast(SwerveController, outcome.controller).holds
        return {**tour_metrics(bench.log, robot, list(outcome.faults), held, near), **figures(bench.log, robot)}

    return Scenario.single(
        bench.log, lambda progress: bench.planned("tour", mission, TOUR, uneven_floor, progress=progress)[0], measured,
        lambda run: [*plots(bench.log, robot), *bench.joint_plots()], IDEALIZATIONS,
    )  # fmt: skip


EXPERIMENT = Experiment.of(
    NAME,
    "a base with any legs drives a tour in its narrow and its wide stance, over bumps and cables",
    LegsSettings,
    build,
    DEFINITIONS[NAME],
)
