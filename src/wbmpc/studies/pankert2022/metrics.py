"""What the swerve robots' experiments measure alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from wbmpc.result import Metric


def rotation_about_z(yaw: float) -> np.ndarray:
    """Rotation matrix (3, 3) of a ``yaw`` [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def in_frame(pose: np.ndarray, tool_in_base: np.ndarray, height: float) -> np.ndarray:
    """The end effector in the estimated frame: estimated base pose, true forward kinematics."""
    placed = rotation_about_z(pose[2]) @ tool_in_base
    return np.array([pose[0] + placed[0], pose[1] + placed[1], height])


def rms(values: np.ndarray) -> float:
    """Root of the mean square of numbers (n,), or of the lengths of rows (n, k)."""
    return float(np.sqrt(np.mean(np.sum(np.atleast_2d(values.T).T ** 2, axis=1))))


def traveled(path: np.ndarray) -> float:
    """Length [m] of a path (n, 2 or more) over the floor."""
    return float(np.sum(np.hypot(*np.diff(path[:, :2], axis=0).T)))


def in_both_frames(
    name: str, figure: Callable[[np.ndarray], float], errors: Sequence[np.ndarray], unit: str,
    goal: float | None = None, paper: float | None = None, note: str = "", estimated: str = "",
) -> dict[str, Metric]:  # fmt: skip
    """The ``figure`` of an error in the world, ``NAME_world``, and beside it in the estimated frame, ``NAME`` with the ending
    ``estimated``; ``errors`` (k, ...) in this order. Endings stand
    in the place of ``{}`` of a name that has it. The goal is the world's: a bystander would measure it."""
    world, own = errors
    pattern = name if "{}" in name else name + "{}"
    return {
        pattern.format("_world"): Metric(figure(world), unit, goal=goal, paper=paper, goal_note=note),
        pattern.format(estimated): Metric(figure(own), unit, paper=paper),
    }


def largest(errors: np.ndarray) -> float:
    """Largest length of rows (n, k), or of numbers (n,)."""
    return float(np.linalg.norm(np.atleast_2d(errors.T).T, axis=1).max())


def mean(errors: np.ndarray) -> float:
    """Mean length of rows (n, k), or of numbers (n,)."""
    return float(np.linalg.norm(np.atleast_2d(errors.T).T, axis=1).mean())


def no_comparison(goal: float | None = None) -> Metric:
    """The ratio to a baseline that fell or ended early: no number, so that its ``goal`` does not count as reached."""
    return Metric(
        float("nan"), "1", goal=goal, goal_note="the baseline did not get to the end, there is nothing to compare with"
    )
