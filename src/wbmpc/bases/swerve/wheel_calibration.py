"""What is known of a base's steered wheels: zeros of the steering encoders and radii, and its file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from wbmpc.arrays import Array
from wbmpc.checks import is_covariance, not_negative, numbers, real_number
from wbmpc.errors import InputError
from wbmpc.estimation.calibration_file import ZERO, ZERO_RANGE, Range, read_calibration, read_rows
from wbmpc.model.wheels import ModuleGeometry
from wbmpc.output_file import write_text

#: Standard deviations of an uncalibrated base: steering zero (with the leg's, which turns the wheel as well)
#: [rad], radius of one wheel and of all of them, relative.
ZERO_STD, RADIUS_STD, COMMON_RADIUS_STD = 2e-3, 1e-3, 2e-3


#: How far radii are made (relative) beside what the robot's file says, at most.
RADIUS_RANGE = 0.3


def module_keys(wheel_radius: float) -> dict[str, Range]:
    """Of a steered wheel whose radius is ``wheel_radius`` [m] in the robot's file."""
    least, largest = (1.0 - RADIUS_RANGE) * wheel_radius, (1.0 + RADIUS_RANGE) * wheel_radius
    return {
        "steer_offset": ZERO,
        "leg_offset": ZERO,
        "wheel_radius": Range(least, largest, "m", wheel_radius, f"the robot's file has {wheel_radius:.4g} m"),
        "steer_offset_std": Range(0.0, ZERO_RANGE, "rad"),
        "wheel_radius_std": Range(0.0, RADIUS_RANGE, "of the radius"),
    }


@dataclass(frozen=True)
class WheelCalibration:
    """Corrections of n steered wheels: true angle = measured − zero.

    ``steer_offset``, ``leg_offset`` (n) [rad]; ``wheel_radius`` (n) [m]; ``covariance`` (2n, 2n) of what is left of the steer
    zeros [rad] and of the radii (relative), in this order. The heading of a wheel shows only the sum of both zeros:
    a calibration from driving leaves the legs' as they are and has the sum in ``steer_offset``. Raises :class:`InputError` for
    numbers that are not finite, of another length, radii that are not positive, and a covariance that is none.
    """

    steer_offset: Array
    leg_offset: Array
    wheel_radius: Array
    covariance: Array

    def __post_init__(self) -> None:
        n = np.size(self.steer_offset)
        for name in ("steer_offset", "leg_offset", "wheel_radius"):
            object.__setattr__(self, name, numbers("wheel calibration", name, getattr(self, name), n))
        if (self.wheel_radius <= 0.0).any():
            raise InputError(f"wheel calibration: 'wheel_radius' must be positive, got {self.wheel_radius}")
        numbers("wheel calibration", "covariance", np.ravel(self.covariance), 4 * n * n)
        if np.shape(self.covariance) != (2 * n, 2 * n) or not is_covariance(self.covariance):
            raise InputError(
                f"wheel calibration: 'covariance' needs {2 * n} rows of {2 * n} numbers, and no variance of it may be negative"
            )

    @classmethod
    def unknown(
        cls, geometry: ModuleGeometry, zero: float = ZERO_STD, radius: float = RADIUS_STD,
        common_radius: float = COMMON_RADIUS_STD,
    ) -> WheelCalibration:  # fmt: skip
        """The description's numbers, with standard deviations [rad, relative, relative] of what they may be off."""
        not_negative("wheel calibration", zero=zero, radius=radius, common_radius=common_radius)
        n = geometry.modules
        covariance = np.diag(np.repeat([zero**2, radius**2], n))
        covariance[n:, n:] += common_radius**2
        return cls(np.zeros(n), np.zeros(n), np.full(n, geometry.wheel_radius), covariance)

    @property
    def modules(self) -> int:
        """Number of modules n."""
        return len(self.steer_offset)

    def rise(self, geometry: ModuleGeometry) -> float:
        """By how much [m] the base stands higher than described: radii that roll farther carry it higher. (Of a soft tire's sink
        a rolling radius holds half.)"""
        return float(np.mean(self.wheel_radius)) - geometry.wheel_radius

    @property
    def std(self) -> tuple[Array, Array]:
        """Standard deviations (n) of the steer zeros [rad] and of the radii (relative)."""
        s = np.sqrt(np.diag(self.covariance))
        return s[: self.modules], s[self.modules :]

    def save(
        self, path: Path, modules: list[str], notes: Sequence[str] = (),
        arm: Mapping[str, Mapping[str, float]] | None = None, robot: str = "", follow: bool = True,
    ) -> None:  # fmt: skip
        """Write a YAML file with one entry for each of the named modules (their steer joints), ``notes`` as comments, what is known
        of the ``arm`` by its joints, and the ``robot``'s name; ``follow``: also where a link leads."""
        std = self.std
        rows = {
            name: {
                "steer_offset": float(self.steer_offset[i]), "leg_offset": float(self.leg_offset[i]),
                "wheel_radius": float(self.wheel_radius[i]), "steer_offset_std": float(std[0][i]),
                "wheel_radius_std": float(std[1][i]),
            }
            for i, name in enumerate(modules)
        }  # fmt: skip
        scale = np.concatenate(std)
        scale[scale == 0.0] = 1.0
        correlation = self.covariance / np.outer(scale, scale)
        correlation[np.diag_indices_from(correlation)] = 1.0
        head = "# Steered wheels: zeros [rad] (true angle = measured - zero), radii [m], relative std of the radii.\n"
        head += "".join(f"# {note}\n" for note in notes)
        tail = "# Correlation of what is left of the zeros, then of the radii, modules as above: what is known better together.\n"
        tail += yaml.safe_dump({"correlation": correlation.tolist()}, default_flow_style=None, width=2**31)
        data = {**({"robot": robot} if robot else {}), "modules": rows, **({"arm": arm} if arm else {})}
        write_text(path, head + yaml.safe_dump(data, sort_keys=False) + tail, follow)

    @classmethod
    def load(cls, path: Path | str, geometry: ModuleGeometry, modules: list[str], robot: str = "") -> WheelCalibration:
        """Read such a file; keys that are left out are the description's, and without ``correlation`` errors are independent.
        Raises :class:`InputError` naming the key and the numbers that wheels as described can have, and for a file of another
        robot than ``robot`` (its name; empty: any)."""
        data = read_calibration(path, robot)
        if "modules" not in data:
            raise InputError(f"{path}: one key 'modules' is needed, with an entry for each of: {', '.join(modules)}")
        rows = read_rows(path, "modules", data["modules"], "module", modules, module_keys(geometry.wheel_radius))
        missing = [n for n in modules if n not in rows]
        if missing:
            raise InputError(f"{path}: key 'modules': there is no entry for {', '.join(missing)}")
        value = lambda key: np.array([rows[n][key] for n in modules])
        std = np.concatenate([value("steer_offset_std"), value("wheel_radius_std")])
        covariance = np.outer(std, std) * read_correlation(path, data.get("correlation"), list(rows), modules)
        return cls(value("steer_offset"), value("leg_offset"), value("wheel_radius"), covariance)

    def check(self, who: str, geometry: ModuleGeometry, modules: list[str]) -> None:
        """Raise :class:`InputError` of ``who`` for numbers that wheels as described cannot have, and no file is read with."""
        valid, (zero_std, radius_std) = module_keys(geometry.wheel_radius), self.std
        for key, values in (
            ("steer_offset", self.steer_offset), ("leg_offset", self.leg_offset), ("wheel_radius", self.wheel_radius),
            ("steer_offset_std", zero_std), ("wheel_radius_std", radius_std),
        ):  # fmt: skip
            for name, value in zip(modules, values, strict=True):
                valid[key].check(f"{who}: '{key}' of {name}", float(value))


def read_correlation(path: Path | str, matrix: Any, order: list[str], modules: list[str]) -> Array:
    """What a file gives (2n, 2n) with its modules in their ``order``, for ``modules``; independent errors for None."""
    n = len(modules)
    if matrix is None:
        return np.eye(2 * n)
    try:
        values = np.array([[real_number("correlation", value) for value in row] for row in matrix], float)
    except (TypeError, ValueError, InputError):  # texts and truth values are no numbers
        values = np.zeros(0)
    right = values.shape == (2 * n, 2 * n) and np.isfinite(values).all() and np.allclose(values, values.T, atol=1e-6)
    # a direction without doubt (std 0) has 1 on the diagonal all the same
    if not right or not np.allclose(np.diag(values), 1.0) or np.linalg.eigvalsh(values)[0] < -1e-6:
        raise InputError(
            f"{path}: key 'correlation': {2 * n} rows of {2 * n} numbers are needed, a correlation matrix of the zeros, then of "
            "the radii; or leave it out"
        )
    place = [order.index(name) for name in modules]
    index = np.array([*place, *(n + i for i in place)])
    return values[np.ix_(index, index)]
