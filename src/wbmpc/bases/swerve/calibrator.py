"""Calibration of a swerve base's wheels, and of its arm, from the channels of a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.calibrator import Calibrator
from wbmpc.bases.swerve.calibration import WheelFit, fit_wheels
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.bases.swerve.wheel_record import WheelRecord
from wbmpc.errors import InputError
from wbmpc.estimation.arm_calibration import calibrate_arm
from wbmpc.estimation.calibration_file import ARM_KEYS, read_rows
from wbmpc.model.robot import RobotModel
from wbmpc.model.wheels import ModuleGeometry

#: Bases whose places [m] and directions [rad] differ by less are the same: descriptions are measured, and measured again.
SAME_BASE = 0.02


def steer_joints(robot: RobotModel) -> list[str]:
    """The names by which a calibration file knows the modules."""
    return list(robot.state.groups["steer"])


@dataclass(frozen=True)
class SwerveCalibration:
    """See :class:`wbmpc.bases.calibrator.FoundCalibration`: of the modules with these ``names`` of a ``robot``, whose wheels were doubted
    as the ``prior`` says; ``arm``: by joint ``offset`` and ``offset_std`` [rad], None where the log has none of it."""

    robot: str
    names: list[str]
    prior: WheelCalibration
    fit: WheelFit
    arm: dict[str, dict[str, float]] | None

    def save(self, path: Path, follow: bool = True) -> None:
        """Write the file that runs read; ``follow``: also where a link leads."""
        notes = [f"left out: {name}" for name in self._left_out()] + [f"not shown: {text}" for text in self._hidden()]
        self.fit.calibration.save(path, self.names, notes=notes, arm=self.arm, robot=self.robot, follow=follow)

    def table(self) -> dict[str, Any]:
        """The numbers, as JSON has them."""
        found, std = self.fit.calibration, self.fit.calibration.std
        rows = {
            name: {
                "steer_zero": float(found.steer_offset[i]), "wheel_radius": float(found.wheel_radius[i]),
                "steer_zero_std": float(std[0][i]), "wheel_radius_std": float(std[1][i]),
            }
            for i, name in enumerate(self.names)
        }  # fmt: skip
        poses = {"used": self.fit.used, "given": self.fit.given}
        unknown = {"left_out": self._left_out(), "not_shown": self._hidden()}
        return {"modules": rows, "poses": poses, **unknown, "arm": self.arm or {}}

    def lines(self) -> list[str]:
        """The numbers, for readers; what the log does not show, and what was not used of it."""
        found, std, count = self.fit.calibration, self.fit.calibration.std, self.fit.count
        lines = [
            f"{name}: zero {1e3 * row['offset']:.2f} mrad (std {1e3 * row['offset_std']:.2f})"
            for name, row in (self.arm or {}).items()
        ]
        lines += [
            f"{name}: steer zero {1e3 * found.steer_offset[i]:.2f} mrad (std {1e3 * std[0][i]:.2f}), "
            f"radius {1e3 * found.wheel_radius[i]:.3f} mm (std {1e3 * found.wheel_radius[i] * std[1][i]:.3f})"
            for i, name in enumerate(self.names)
        ]
        mean, mean_std = self.fit.mean_zero()
        lines.append(f"mean of the steer zeros {1e3 * mean:.2f} mrad (std {1e3 * mean_std:.2f})")
        if left_out := self._left_out():
            lines.append(f"left out, for the base does not go where they do: {', '.join(left_out)}")
        lines += [f"not shown by this drive: {text}" for text in self._hidden()]
        previous, prior = (np.array(wheels.std)[:, count] for wheels in (self.fit.previous, self.prior))
        if (previous != prior).any():
            zero, radius = previous.max(axis=1)
            lines.append(
                f"the wheels are farther off than was believed; taken to be before: zeros {1e3 * zero:.3g} mrad, radii "
                f"{100 * radius:.2g} % (--zero-std, --radius-std)"
            )
        lost = "; the others do not fit the drive" if self.fit.given > self.fit.used else ""
        return [*lines, f"{self.fit.used} of {self.fit.given} global poses used{lost}"]

    def _left_out(self) -> list[str]:
        return [name for name, counts in zip(self.names, self.fit.count, strict=True) if not counts]

    def _hidden(self) -> list[str]:
        """What the log does not show of the wheels."""
        return [self._words(kind, *ways) for kind, ways in self.fit.hidden().items() if len(ways[1])]

    def _words(self, kind: str, weights: Array, std: Array) -> str:
        """Combinations (k, n) of the wheels' numbers and their standard deviations (k)."""
        names = self.names
        sums = [
            " ".join(f"{w:+.2f} {name}" for w, name in zip(row, names, strict=True) if abs(w) > 0.05) for row in weights
        ]
        what = f"{sums[0]} of the" if len(sums) == 1 else f"{len(sums)} of {len(names)} combinations of the"
        return (
            f"{what} {kind} (std {1e3 * std.max():.2f} {'mrad' if kind == 'steer zeros' else 'per mille'}, as before)"
        )


class SwerveCalibrator:
    """See :class:`wbmpc.bases.calibrator.Calibrator`."""

    def __init__(self, robot: RobotModel) -> None:
        self.names, self.geometry, self._robot = steer_joints(robot), swerve_base(robot).geometry, robot

    def has_base_of(self, other: Calibrator) -> bool:
        """Whether the modules of two robots hang at the same places in the same way; their radii are what a calibration finds."""
        return isinstance(other, SwerveCalibrator) and _same_modules(self.geometry, other.geometry)

    def find(
        self, channels: Mapping[str, Array], source: str, *, zero_std: float, radius_std: float
    ) -> SwerveCalibration:
        """See :class:`wbmpc.bases.calibrator.Calibrator`."""
        prior = WheelCalibration.unknown(self.geometry, zero_std, 0.5 * radius_std, radius_std)
        fit, arm = self.fit(channels, prior, source), self.fit_arm(channels, source)
        return SwerveCalibration(self._robot.description.name, self.names, prior, fit, arm)

    def fit(self, channels: Mapping[str, Array], prior: WheelCalibration, source: str) -> WheelFit:
        """From ``channels`` as :meth:`wbmpc.bases.swerve.wheel_record.WheelRecord.of` reads them, beginning from a ``prior``."""
        found = fit_wheels(self.geometry, WheelRecord.of(channels, source), prior=prior)
        found.calibration.check(source, self.geometry, self.names)
        return found

    def fit_arm(self, channels: Mapping[str, Array], source: str) -> dict[str, dict[str, float]] | None:
        """By joint ``offset`` and ``offset_std`` [rad] of the arm's encoders, from the channel 'tracked' of a log: rows of the arm's
        angles (m), the position (3) [m] of its end effector in axes of the base, and its standard deviation. None without it."""
        if "tracked" not in channels:
            return None
        joints, rows = list(self._robot.input.groups["arm"]), np.atleast_2d(np.asarray(channels["tracked"], float))
        m = len(joints)
        if rows.shape[1] != m + 4 or not (rows[:, -1] > 0.0).all():
            raise InputError(
                f"{source}: channel 'tracked': rows of {m} angles of the arm, 3 positions of its end effector in axes of the base and "
                f"their standard deviation, above 0, are needed, got {rows.shape}"
            )
        found = calibrate_arm(self._robot, rows[:, :m], rows[:, m : m + 3], float(rows[0, -1])).rows(joints)
        return read_rows(source, "arm", found, "joint of the arm", joints, ARM_KEYS)


def _same_modules(one: ModuleGeometry, other: ModuleGeometry) -> bool:
    """Whether modules hang at the same places in the same way."""
    if one.modules != other.modules or one.legs_move != other.legs_move:
        return False
    places = lambda g: np.concatenate([g.hinge, g.steer_axes(np.zeros(g.modules))], axis=1)
    turned = np.abs(np.angle(np.exp(1j * (one.wheel_heading - other.wheel_heading))))
    return bool(np.allclose(places(one), places(other), atol=SAME_BASE) and turned.max() < SAME_BASE)
