"""What the ball robot's experiments measure and draw alike: end effector and ball as the robot knows them, figures of the estimator."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wbmpc.control.protocols import Controller
from wbmpc.log import Log
from wbmpc.result import Metric, Plot, Series


def count_wheels(state: np.ndarray, torque: np.ndarray) -> int:
    """How many of recorded torques (n, drives) are the wheels', by the states (n, nx): the others are the arm's joints."""
    return int(torque.shape[1] - (state.shape[1] // 2 - 5))


def estimated_end_effector(log: Log) -> np.ndarray:
    """End effector positions (n, 3) [m] in the estimated frame (the true ones in runs without an estimator)."""
    return log.array("hand_estimated") if "hand_estimated" in log.channels else log.array("hand")


def estimated_end_effector_rotation(log: Log) -> np.ndarray:
    """Quaternions (n, 4) of the end effector in the estimated frame (the true ones in runs without an estimator)."""
    return log.array("hand_quaternion_estimated" if "hand_quaternion_estimated" in log.channels else "hand_quaternion")


def estimated_ball(log: Log) -> np.ndarray:
    """Ball positions (n, 2) [m] in the estimated frame (the true ones in runs without an estimator)."""
    return log.array("estimate" if "estimate" in log.channels else "state")[:, :2]


def estimator_metrics(log: Log) -> dict[str, Metric]:
    """Largest errors of the estimate, the share of messages in which the ball was found not to roll, the mass that was weighed."""
    if "estimate" not in log.channels:
        return {}
    weighed = {"payload_estimated": Metric(float(log.array("payload")[-1]), "kg")} if "payload" in log.channels else {}
    error = np.abs(log.array("estimate") - log.array("state"))
    return {
        "estimated_position_error_max": Metric(float(np.hypot(error[:, 0], error[:, 1]).max()), "m"),
        "estimated_tilt_error_max": Metric(float(error[:, 3:5].max()), "rad"),
        "estimated_yaw_error_max": Metric(float(error[:, 2].max()), "rad"),
        "rolling_fault_share": Metric(float(log.array("rolling_fault").mean()), "1"),
        **weighed,
    }


def fault_metrics(*controllers: Controller | None) -> dict[str, Metric]:
    """How many encoders were found to stand still, and wheels to slip, by all controllers of a run."""
    monitors = [m for c in controllers if (m := getattr(c, "monitor", None)) is not None]
    return {"encoder_faults": Metric(float(sum(len(m.faults) for m in monitors)), "1")} if monitors else {}


def rms(vectors: np.ndarray) -> float:
    """Root mean square length of vectors (n, k); infinite for none."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1)))) if len(vectors) else float("inf")


def common_plots(log: Log, end_effector: np.ndarray, ball: np.ndarray) -> list[Plot]:
    """Ball, lean, end effector error and torques; ``end_effector`` (3) or (n, 3) and ``ball`` (2) or (n, 2): where they should be [m]."""
    t, state, torque = log.times("state"), log.array("state"), log.array("torque")
    error = lambda a, b: 1e3 * np.linalg.norm(a - b, axis=1)
    return [
        Plot("Ball position", "time [s]", "position [m]", [Series(n, t, state[:, i]) for i, n in enumerate("xy")]),
        Plot("Roll and pitch of the base", "time [s]", "angle [°]", [
            Series("pitch", t, np.rad2deg(state[:, 3])), Series("roll", t, np.rad2deg(state[:, 4])),
        ]),
        Plot("Ball path", "x [m]", "y [m]", [Series("ball", state[:, 0], state[:, 1])], equal_axes=True),
        Plot("Errors", "time [s]", "error [mm]", [
            Series("end effector, world", t, error(log.array("hand"), end_effector)),
            Series("end effector, estimated frame", t, error(estimated_end_effector(log), end_effector)),
            Series("ball, world", t, error(state[:, :2], ball)),
        ]),
        Plot("Wheel torques", "time [s]", "torque [N m]", [
            Series(f"wheel {i}", t, torque[:, i]) for i in range(count_wheels(state, torque))
        ]),
    ]  # fmt: skip


def append_as(single: Log, log: Log, name: str, channels: Sequence[str]) -> None:
    """Append the ``channels`` of one of several runs to the log of all, as CHANNEL_NAME, and the end effector as the robot knows it; nothing
    for a run that ended before its first record."""
    if not single.channels:
        return
    log.extend(single, f"_{name}", channels)
    for t, row in zip(single.times("hand"), estimated_end_effector(single), strict=True):
        log.add(f"hand_{name}", t, row)
