"""Zeros of an arm's encoders from an end effector that is tracked in the base's axes, at some twenty poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.checks import is_covariance, positive
from wbmpc.errors import InputError
from wbmpc.estimation.calibration_file import ARM_KEYS, read_calibration, read_rows
from wbmpc.model.robot import RobotModel

#: Standard deviation [rad or m] of an uncalibrated zero; Gauss-Newton steps.
ZERO_STD, PASSES = 2e-3, 5
#: Positions that miss by more than this many standard deviations, root mean square, contradict the arm.
CONTRADICTS = 5.0


@dataclass(frozen=True)
class ArmCalibration:
    """``offset`` (m) [rad or m]: true angle = measured − offset; ``covariance`` (m, m) of its error: a joint that moves no position keeps
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
    robot: RobotModel, arm: ArrayLike, tool: ArrayLike, std: float, covariance: ArrayLike | None = None,
    frame: str | None = None,
) -> ArmCalibration:  # fmt: skip
    """From the arm's encoders ``arm`` (k, m) [rad or m] and positions ``tool`` (k, 3) [m] of the end effector in axes of the base's body,
    origin where the robot's model has it, each with a standard deviation ``std`` [m]; ``covariance`` (m, m) of the zeros before (left
    out: :data:`ZERO_STD` each); ``frame``: of the end effector (left out: the robot's first).

    Raises :class:`InputError` for other shapes, numbers that are not finite, and positions that no such zeros explain.
    """
    positive("arm calibration", std=std)
    angles, places = np.asarray(arm, float), np.asarray(tool, float)
    m = len(robot.input.groups["arm"])
    if angles.ndim != 2 or angles.shape[1] != m or places.shape != (len(angles), 3) or len(angles) == 0:
        raise InputError(
            f"arm calibration: needs rows of {m} angles and of 3 positions, got {angles.shape}, {places.shape}"
        )
    if not (np.isfinite(angles).all() and np.isfinite(places).all()):
        raise InputError("arm calibration: angles and positions must be finite numbers")
    before = ZERO_STD**2 * np.eye(m) if covariance is None else np.asarray(covariance, float)
    if before.shape != (m, m) or not is_covariance(before) or np.linalg.matrix_rank(before) < m:
        raise InputError(f"arm calibration: 'covariance' needs {m} rows of {m} numbers, of zeros that all are in doubt")
    seen, offset, information = _tool(robot, frame or robot.tool), np.zeros(m), np.linalg.inv(before)
    for _ in range(PASSES):
        here, slopes = zip(*(seen(q - offset) for q in angles), strict=True)
        missed, slope = (places - np.array(here)).ravel(), -np.vstack(slopes)
        normal = slope.T @ slope / std**2 + information
        offset = offset + np.linalg.solve(normal, slope.T @ missed / std**2 - information @ offset)
    missed = (places - np.array([seen(q - offset)[0] for q in angles])).ravel()
    misfit = float(np.sqrt(np.mean(missed**2) * 3.0))
    if misfit > CONTRADICTS * np.sqrt(3.0) * std:
        raise InputError(
            f"arm calibration: positions miss by {1e3 * misfit:.3g} mm, with a standard deviation of {1e3 * std:.3g} mm; check units, "
            "the order of the joints, and that positions are in axes of the base's body"
        )
    return ArmCalibration(offset, np.asarray(np.linalg.inv(normal), float), misfit)


def _tool(robot: RobotModel, frame: str) -> Callable[[Array], tuple[Array, Array]]:
    """Position (3) [m] of a frame in axes of the base's body by the arm's angles (m), and its derivative (3, m)."""
    q, x = ca.SX.sym("q", len(robot.input.groups["arm"])), ca.SX(ca.DM(robot.home))
    x[robot.state["arm"]] = q
    root = robot.base.root_pose(x)
    place = root.rotation.T @ (robot.frame_pose(x, frame).position - root.position)
    function = ca.Function("tool", [q], [place, ca.jacobian(place, q)])

    def at(angles: Array) -> tuple[Array, Array]:
        position, slope = (np.asarray(part) for part in function(angles))
        return position.ravel(), slope

    return at
