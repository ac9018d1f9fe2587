"""What robots know of themselves before a run: of their wheels by a reference drive of the same simulated robot with global poses, of their
arm's zeros by a tracked end effector."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases import base_type, offers
from wbmpc.bases.base import Calibration
from wbmpc.errors import RunAborted
from wbmpc.estimation.arm_calibration import ZERO_STD, calibrate_arm
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.route import base_part
from wbmpc.simulation.arm import ArmPlant
from wbmpc.simulation.kept_calibration import kept
from wbmpc.simulation.lockstep import preparation, run_lockstep
from wbmpc.simulation.perturbation import Perturbation
from wbmpc.simulation.settings import LidarSettings
from wbmpc.simulation.tracked_arm import TRACKER, track_arm
from wbmpc.tasks.base_following import RAMP, Order, base_path, lead_base, ordered_twist

#: Strokes: straight [m] and turns [rad], speeds [m/s, rad/s] and their share of the base's limits at most; standing between them [s].
STRAIGHT, TURN, SPEED, RATE, SHARE, STANDING = 4.0, np.pi, 0.4, 0.5, 0.5, 2.0
#: Bends of a base without a speed to the side: turn [rad] of each, and how many to and fro, which all press it to the same side.
BEND, BENDS = 1.2, 3
#: Messages between two that are recorded; postures at which the end effector is tracked.
EVERY, POSTURES = 8, 24


def strokes(robot: RobotModel) -> list[Order]:
    """Orders of the base, as those of `cmd-vel`: every speed that it has, to and fro, and standing between them; bends at last, whose slips
    to the side add up."""
    names, part = robot.input.groups["base"], robot.input["base"]
    still: Order = (STANDING + RAMP, 0.0, 0.0, 0.0)
    found = [still]
    fastest = SHARE * np.minimum(robot.limits.input_upper[part], -robot.limits.input_lower[part])
    for name, limit in zip(names, fastest, strict=True):
        turns = name == names[-1]
        speed, way = (min(RATE, limit), TURN) if turns else (min(SPEED, limit), STRAIGHT)
        column = 2 if turns else 1 if name == "vy" else 0
        for sign in (1.0, -1.0):
            ahead, left, turn = sign * speed * np.eye(3)[column]
            found += [(way / speed, ahead, left, turn), still]
    if "vy" not in names:
        speed, rate = min(SPEED, fastest[0]), min(RATE, fastest[-1])
        for sign in (1.0, -1.0) * BENDS:  # wheels would slip that reversed at once
            found += [(BEND / rate, sign * speed, 0.0, sign * rate), (RAMP, 0.0, 0.0, 0.0)]
        found += [still]
    return found


def drive(robot: RobotModel, perturbation: Perturbation, seed: int) -> tuple[Log, str]:
    """The drive of a simulated robot, with what its encoders say and where a localization sees it; and why it ended early (empty: it did
    not)."""
    plugin, log = base_type(robot.description.base.type), Log()
    made, channels = plugin.system(robot, seed, perturbation), plugin.calibration_channels
    start = robot.home[base_part(robot, "reference drive")]
    times, poses = base_path(strokes(robot), start, 0.0, ordered_twist(robot))
    lead_base(robot, made.mpc, times, poses)
    lidar, turning, controller = LidarSettings().source(seed), list[float](), cast(Any, made.controller)

    def record(t: float, command: Any, plans: Any) -> None:
        seen = lidar.observe(t, lambda: made.plant.truth().pose)
        if seen is not None:
            log.add("place", seen.time, [*seen.pose, *np.sqrt(np.diag(seen.covariance))])
        message = controller.measured
        turning.append(float(message.gyro[2]))
        if round(t / made.timing.period) % EVERY == 0:
            for name in channels:
                if np.size(getattr(message, name)):
                    log.add(name, t, getattr(message, name))
            log.add("gyro", t, np.mean(turning))
            turning.clear()

    ending = run_lockstep(*made.parts, float(times[-1]), record, preparation())
    return log, ending.reason


def calibration(robot: RobotModel, perturbation: Perturbation, seed: int) -> Calibration | None:
    """What a reference drive of the simulated robot with a ``perturbation`` and a ``seed`` shows of its wheels; None for a base that has
    nothing to show. Raises :class:`wbmpc.errors.RunAborted` for a drive that does not come to its end."""
    kind = robot.description.base.type
    if not offers(kind, "calibrate"):
        return None

    def make() -> Calibration:
        log, reason = drive(robot, perturbation, seed)
        if reason:
            raise RunAborted(f"the reference drive for the calibration: {reason}")
        channels = {c: log.array(c) for c in log.channels} | {f"{c}.time": log.times(c) for c in log.channels}
        return base_type(kind).calibrate(robot, channels, "reference drive")

    return kept(robot, perturbation, seed, make)


def arm_zeros(robot: RobotModel, plant: ArmPlant, seed: int) -> Array:
    """Zeros (m) [rad or m] of the arm's encoders, as far as tracked end effectors of the simulated robot show them."""
    read, seen = track_arm(robot, plant, POSTURES, seed)
    offset, covariance = np.zeros(read.shape[1]), ZERO_STD**2 * np.eye(read.shape[1])
    for frame, places in seen.items():
        found = calibrate_arm(robot, read - offset, places, TRACKER, covariance, frame)
        offset, covariance = offset + found.offset, found.covariance
    return offset
