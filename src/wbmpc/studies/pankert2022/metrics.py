"""What the swerve robots' experiments measure alike."""

from __future__ import annotations

import numpy as np


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


def travelled(path: np.ndarray) -> float:
    """Length [m] of a path (n, 2 or more) over the floor."""
    return float(np.sum(np.hypot(*np.diff(path[:, :2], axis=0).T)))
