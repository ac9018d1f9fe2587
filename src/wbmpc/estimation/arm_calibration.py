"""Zeros of an arm's encoders from an end effector that is tracked in the base's axes, at some twenty poses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.checks import positive
from wbmpc.errors import InputError
from wbmpc.estimation.calibration_file import ARM_KEYS, read_calibration, read_rows
from wbmpc.model.robot import RobotModel

Array = NDArray[np.float64]
#: Standard deviation [rad] of an uncalibrated zero; step [rad] of derivatives; Gauss-Newton steps.
ZERO_STD, STEP, PASSES = 2e-3, 1e-6, 5
#: Positions that miss by more than this many standard deviations, root mean square, contradict the arm.
CONTRADICTS = 5.0


@dataclass(frozen=True)
class ArmCalibration:
    """``offset`` (m) [rad]: true angle = measured − offset; ``covariance`` (m, m) of its error: a joint that moves no position keeps
    the doubt that it had. ``misfit`` [m]: root mean square of what is left of the positions."""

    offset: Array
    covariance: Array
    misfit: float

    def rows(self, joints: list[str]) -> dict[str, dict[str, float]]:
        """By joint what a calibration file has of it, under the key 'arm'."""
        std = np.sqrt(np.diag(self.covariance))
        return {n: {"offset": float(self.offset[i]), "offset_std": float(std[i])} for i, n in enumerate(joints)}


def load_arm_offset(path: Path | str, joints: list[str], robot: str = "") -> Array | None:
    """Zeros (m) [rad] of a calibration file, 0 for joints that it leaves out; None where it has no key 'arm'. Raises
    :class:`InputError` naming the key and the numbers that encoders can have, and for a file of another robot than ``robot``."""
    data = read_calibration(path, robot)
    if "arm" not in data:
        return None
    rows = read_rows(path, "arm", data["arm"], "joint of the arm", joints, ARM_KEYS)
    return np.array([rows[n]["offset"] if n in rows else 0.0 for n in joints])


def calibrate_arm(
    robot: RobotModel, arm: ArrayLike, tool: ArrayLike, std: float, zero_std: float = ZERO_STD
) -> ArmCalibration:
    """From the arm's encoders ``arm`` (k, m) [rad] and positions ``tool`` (k, 3) [m] of the end effector in axes of the base's body,
    origin where the robot's model has it, each with a standard deviation ``std`` [m]; ``zero_std`` [rad] of the zeros before.

    Raises :class:`InputError` for other shapes, numbers that are not finite, and positions that no such zeros explain.
    """
    positive("arm calibration", std=std, zero_std=zero_std)
    angles, places = np.asarray(arm, float), np.asarray(tool, float)
    m = len(robot.input.groups["arm"])
    if angles.ndim != 2 or angles.shape[1] != m or places.shape != (len(angles), 3) or len(angles) == 0:
        raise InputError(
            f"arm calibration: needs rows of {m} angles and of 3 positions, got {angles.shape}, {places.shape}"
        )
    if not (np.isfinite(angles).all() and np.isfinite(places).all()):
        raise InputError("arm calibration: angles and positions must be finite numbers")
    offset, missed, slope = np.zeros(m), np.zeros(0), np.zeros((0, m))
    information = np.eye(m) / zero_std**2
    for _ in range(PASSES):
        at = lambda o: np.array([_tool(robot, q - o) for q in angles])
        here = at(offset)
        missed = (places - here).ravel()
        slope = np.stack([(at(offset + STEP * e) - here).ravel() / STEP for e in np.eye(m)], axis=1)
        normal = slope.T @ slope / std**2 + information
        offset = offset + np.linalg.solve(normal, slope.T @ missed / std**2 - information @ offset)
    missed = (places - np.array([_tool(robot, q - offset) for q in angles])).ravel()
    misfit = float(np.sqrt(np.mean(missed**2) * 3.0))
    if misfit > CONTRADICTS * np.sqrt(3.0) * std:
        raise InputError(
            f"arm calibration: positions miss by {1e3 * misfit:.3g} mm, with a standard deviation of {1e3 * std:.3g} mm; check units, "
            "the order of the joints, and that positions are in axes of the base's body"
        )
    return ArmCalibration(offset, np.asarray(np.linalg.inv(normal), float), misfit)


def _tool(robot: RobotModel, arm: Array) -> Array:
    """Position (3) [m] of the end effector in the base's axes."""
    x = robot.home.copy()
    x[robot.state["base"]] = 0.0
    x[robot.state["arm"]] = arm
    return np.asarray(robot.pose(x)[0]) - [0.0, 0.0, robot.base.body_height]
