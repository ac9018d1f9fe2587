"""What `swerve-drive` measures and draws of its runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wbmpc.bases.swerve.configurations import CONFIGURATIONS, corners
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.plant import drive_speeds
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.result import Drawing, Metric, Plot, Series
from wbmpc.simulation.lockstep import Ending
from wbmpc.studies.pankert2022.drive_course import BODY, BUMP_RADIUS, BUMPS, CABLES, DOOR, DOOR_WIDTH, POST, clearance
from wbmpc.studies.pankert2022.metrics import in_both_frames, no_comparison, rms
from wbmpc.studies.storyboard import Ground, Snapshot, storyboard

SPEED_NOTE = (
    "plans keep a margin below the hinges' limit, and legs on the ground overshoot it where the robot rocks from two wheels to the "
    "other two or a wheel is still turning; hinges have no motors, and a brake takes a tenth of a second"
)
#: Goals [m] of the base's error in the world.
ODOMETRY_ALONE, WITH_LIDAR = 0.025, 0.005
#: How far [m] two pictures of the storyboard are apart.
STORY = 1.3
#: A leg's own limit of speed over the one that plans have from the robot's file (Pankert et al. 2022: 0.5 over 0.4 rad/s); a wheel that
#: carries less [N] is off the ground; how long [s] after that its leg is still on the way back to its reference.
LEG_MARGIN, UNLOADED, COMING_BACK = 1.25, 5.0, 1.0
#: The error [rad] at which a leg has recovered.
RECOVERED = np.radians(1.0)


def _errors(log: Log, name: str) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """Errors of position (k, 2) [m] in the world and in the estimated frame, and those of yaw (k,) [rad]."""
    off = [log.array(f"{name}.{pose}") - log.array(f"{name}.base_reference") for pose in ("base", "base_odometry")]
    return tuple(d[:, :2] for d in off), tuple(d[:, 2] for d in off)


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


def tour_metrics(log: Log, robot: RobotModel, faults: list[str], held: int, near: float) -> dict[str, Metric]:
    """Of any base that drives the tour; ``near`` [m]: the goal of its error in the world."""
    position, yaw = _errors(log, "tour")
    return {
        **in_both_frames("base_position_error_rms", rms, position, "m", goal=near),
        **in_both_frames("base_yaw_error_rms", rms, yaw, "rad", goal=float(np.radians(0.8))),
        "wheel_slip_max": Metric(float(log.array("tour.wheel_slip").max()), "m/s"),
        "wheel_off_ground_share": Metric(float(in_the_air(log, "tour").any(axis=1).mean()), "1"),
        "planned_speed_ratio_max": Metric(_planned_ratio(log, robot), "1", goal=1.001),
        "brake_faults": Metric(float(len(faults)), "1", goal=0.0),
        "legs_held": Metric(float(held), "1"),
    }


def metrics(
    log: Log, robot: RobotModel, faults: list[str], held: int, knocked: float | None, baseline: Ending | None,
    lidar: bool = False,
) -> dict[str, Metric]:  # fmt: skip
    """All of them; ``held``: how often the guard held a leg on the tour; ``knocked``: when [s] the knock was over, None if there
    was none; ``baseline``: how it ended, None if it did not run. The errors of one that did not get to the end are infinite, their
    ratio is no number: the part before says nothing. ``lidar``: with global poses, which the goals depend on."""
    near = WITH_LIDAR if lidar else ODOMETRY_ALONE
    position, angle = _errors(log, "tour")[0], _leg_error(log, "tour")
    found = {
        **tour_metrics(log, robot, faults, held, near),
        "leg_angle_error_rms": Metric(angle, "rad", goal=float(np.radians(1.5))),
        "door_clearance": Metric(clearance(robot, log.array("tour.base"), log.array("tour.leg")), "m", least=0.0),
        "leg_angle_error_rms_on_ground": Metric(_leg_error_on_ground(log, "tour"), "rad", goal=float(np.radians(1.5))),
        "joint_speed_ratio_max": Metric(speed_ratio(log, robot), "1", goal=1.0, goal_note=SPEED_NOTE),
    }
    if baseline is not None and not baseline.interrupted:
        found |= _of_baseline(log, position, not baseline.reason, 0.5 if lidar else 1.0)
    if knocked is not None and "knock.leg" in log.channels:
        error = (log.array("knock.leg") - log.array("knock.leg_reference"))[:, corners(robot)["LF"]]
        found["leg_knock"] = Metric(float(np.abs(error).max()), "rad")
        found["leg_recovery_time"] = Metric(recovery(log.times("knock.leg"), error, knocked), "s", goal=2.0)
    closed = [_errors(log, f"closed_{n}")[0] for n in CONFIGURATIONS if f"closed_{n}.base" in log.channels]
    if closed:
        worst = [max((run[frame] for run in closed), key=rms) for frame in (0, 1)]
        found |= in_both_frames("closed_position_error_rms", rms, (worst[0], worst[1]), "m", goal=near)
    return found


def baseline_metrics(log: Log, whole: bool) -> dict[str, Metric]:
    """The baseline's errors, infinite unless it got to the end (``whole``)."""
    position, yaw = _errors(log, "baseline")
    figure = rms if whole else lambda _: float("inf")
    return {
        **in_both_frames("baseline_position_error_rms", figure, position, "m"),
        **in_both_frames("baseline_yaw_error_rms", figure, yaw, "rad"),
        "baseline_leg_angle_error_rms": Metric(_leg_error(log, "baseline") if whole else float("inf"), "rad"),
    }


def _of_baseline(log: Log, ours: tuple[np.ndarray, ...], whole: bool, goal: float) -> dict[str, Metric]:
    """The baseline's errors and the ratios of ``ours`` (k, 2) [m] over them; ``whole``: whether it got to the end."""
    found, (position, _) = baseline_metrics(log, whole), _errors(log, "baseline")
    if not whole:
        return found | {"baseline_ratio_world": no_comparison(goal), "baseline_ratio": no_comparison()}
    ratio = [rms(own) / rms(its) for own, its in zip(ours, position, strict=True)]
    return found | {
        "baseline_ratio_world": Metric(ratio[0], "1", goal=goal),
        "baseline_ratio": Metric(ratio[1], "1"),
    }


def _planned_ratio(log: Log, robot: RobotModel) -> float:
    """Planned speeds of legs, wheels and steering (with its servo) over the planner's limits."""
    index = np.concatenate([np.arange(robot.input.size)[robot.input[g]] for g in ("leg", "steer", "wheel")])
    return float((np.abs(log.array("tour.wanted")) / robot.limits.actuator_upper)[:, index].max())


def speed_ratio(log: Log, robot: RobotModel) -> float:
    """Largest true speed of a leg, a steering or a wheel on the tour over the limit that this robot's legs and drives have; joints whose
    limit the robot's file leaves out do not count."""
    planned, legs = robot.description.limits.velocity, robot.input.groups["leg"]
    own = {n: LEG_MARGIN * planned.get(n, np.inf) for n in legs} | drive_speeds(robot.description)
    limits = np.array([own[n] for g in ("leg", "steer", "wheel") for n in robot.input.groups[g]])
    return float((np.abs(log.array("tour.drive_speed")) / limits).max())


def story(log: Log, robot: RobotModel, title: str, posts: Sequence[tuple[float, float, float, float]] = ()) -> Drawing:
    """The tour from above, with ``posts`` beside it (x, y, half length, half width) [m]."""
    t, base = log.times("tour.base"), log.array("tour.base")
    legs, steers, brakes = (log.array(f"tour.{n}") for n in ("leg", "steer", "brake"))
    far = np.maximum.accumulate(base[:, 0])
    indices = np.searchsorted(far, np.arange(far[0], far[-1] + 1e-9, STORY))
    shots = [Snapshot(float(t[k]), base[k], legs[k], steers[k], brakes[k] > 0.5) for k in indices]
    ground = Ground(posts, [(x, y, BUMP_RADIUS) for x, y in BUMPS], CABLES)
    return Drawing(title, storyboard(swerve_base(robot).geometry, BODY, base[::20, :2], shots, ground))


def plots(log: Log, robot: RobotModel) -> list[Plot | Drawing]:
    """The tour from above and over time, the errors, the knock."""
    t, base, target = log.times("tour.base"), log.array("tour.base"), log.array("tour.base_reference")
    names = [n.removeprefix("leg_") for n in robot.state.groups["leg"]]
    legs, goals = np.degrees(log.array("tour.leg")), np.degrees(log.array("tour.leg_reference"))
    posts = [(DOOR, side * (0.5 * DOOR_WIDTH + POST[1]), *POST[:2]) for side in (-1.0, 1.0)]
    size = lambda name, frame: 1e3 * np.linalg.norm(_errors(log, name)[0][frame], axis=1)
    runs = [
        (n, label) for n, label in (("tour", "MPC"), ("baseline", "inverse kinematics")) if f"{n}.base" in log.channels
    ]
    drawn: list[Plot | Drawing] = [
        story(log, robot, "The tour from above (Fig. 8)", posts),
        Plot("Base from above", "x [m]", "y [m]", [
            Series("true", base[:, 0], base[:, 1]), Series("reference", target[:, 0], target[:, 1], dashed=True),
        ], equal_axes=True),
        Plot("Base position (Fig. 7)", "time [s]", "position [m]", [
            *(Series(n, t, base[:, k]) for k, n in enumerate("xy")),
            *(Series(f"{n}, reference", t, target[:, k], dashed=True) for k, n in enumerate("xy")),
        ]),
        Plot("Base yaw (Fig. 7)", "time [s]", "angle [°]", [
            Series("yaw", t, np.degrees(base[:, 2])), Series("yaw, reference", t, np.degrees(target[:, 2]), dashed=True),
        ]),
        Plot("Leg angles (Fig. 7)", "time [s]", "angle [°]", [
            *(Series(n, t, legs[:, k]) for k, n in enumerate(names)),
            *(Series(f"{n}, reference", t, goals[:, k], dashed=True) for k, n in enumerate(names)),
        ]),
        *(Plot(f"Base error, {name}", "time [s]", "error [mm]", [
            Series(label, log.times(f"{n}.base"), size(n, frame)) for n, label in runs
        ]) for frame, name in enumerate(("world", "estimated frame"))),
        Plot("Leg errors", "time [s]", "error [°]", [
            Series(f"{label}, largest", log.times(f"{n}.leg"),
                   np.degrees(np.abs(log.array(f"{n}.leg") - log.array(f"{n}.leg_reference")).max(axis=1)))
            for n, label in runs
        ]),
    ]  # fmt: skip
    if "knock.leg" in log.channels:
        error = np.degrees(log.array("knock.leg") - log.array("knock.leg_reference"))
        series = [Series(n, log.times("knock.leg"), error[:, k]) for k, n in enumerate(names)]
        drawn.append(Plot("A leg is knocked", "time [s]", "error [°]", series))
    return drawn
