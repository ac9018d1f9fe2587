"""What 'wbmpc calibrate' writes and runs read: the keys of the file, and the numbers that the parts of a robot can have there."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wbmpc.checks import quoted, real_number
from wbmpc.errors import InputError, unknown_name
from wbmpc.yaml_file import load_yaml

Array = NDArray[np.float64]
#: Keys of the file.
KEYS = ("robot", "modules", "arm", "correlation")
#: How far encoders are mounted [rad] and radii made (relative) beside what the robot's file says, at most: farther off, it is the
#: robot's file that is wrong, or another robot's calibration.
ZERO_RANGE, RADIUS_RANGE = 0.6, 0.3


@dataclass(frozen=True)
class Range:
    """Numbers of a key from ``lower`` to ``upper``, in ``unit``; ``default`` where the key is left out; ``source``: what of the
    robot's file they are about, for messages."""

    lower: float
    upper: float
    unit: str
    default: float = 0.0
    source: str = ""

    def check(self, who: str, value: Any) -> float:
        """``value`` as a float; :class:`InputError` of ``who`` with the range."""
        about = f" ({self.source})" if self.source else ""
        valid = f"a finite number from {self.lower:.4g} to {self.upper:.4g} {self.unit}{about} is needed"
        try:
            number = real_number(who, value)
        except InputError:
            number = np.nan
        if not self.lower <= number <= self.upper:
            raise InputError(f"{who}: {valid}, got {quoted(value)!r}")
        return number


ZERO, ZERO_STD = Range(-ZERO_RANGE, ZERO_RANGE, "rad"), Range(0.0, ZERO_RANGE, "rad")
#: Of a joint of the arm.
ARM_KEYS = {"offset": ZERO, "offset_std": ZERO_STD}


def module_keys(wheel_radius: float) -> dict[str, Range]:
    """Of a steered wheel whose radius is ``wheel_radius`` [m] in the robot's file."""
    least, largest = (1.0 - RADIUS_RANGE) * wheel_radius, (1.0 + RADIUS_RANGE) * wheel_radius
    return {
        "steer_offset": ZERO,
        "leg_offset": ZERO,
        "wheel_radius": Range(least, largest, "m", wheel_radius, f"the robot's file has {wheel_radius:.4g} m"),
        "steer_offset_std": ZERO_STD,
        "wheel_radius_std": Range(0.0, RADIUS_RANGE, "of the radius"),
    }


def read_calibration(path: Path | str, robot: str = "") -> dict[str, Any]:
    """The file's keys. Raises :class:`InputError` for a file that is not there or is none, keys that it does not have, and a calibration of
    another robot than ``robot`` (its name; empty: any)."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; 'wbmpc calibrate' writes one")
    data = load_yaml(path)
    if not isinstance(data, Mapping):
        raise InputError(f"{path}: a mapping is needed; valid keys: {', '.join(KEYS)}")
    for key in data:
        if key not in KEYS:
            raise InputError(f"{path}: {unknown_name('key', str(key), KEYS)}")
    of = data.get("robot")
    if of is not None and not isinstance(of, str):
        raise InputError(f"{path}: key 'robot': a name is needed, got {quoted(of)!r}")
    if of is not None and robot and of != robot:
        raise InputError(f"{path}: key 'robot': this is a calibration of '{of[:80]}'; one of '{robot}' is needed")
    return dict(data)


def read_rows(
    path: Path | str, key: str, rows: object, kind: str, names: Iterable[str], keys: Mapping[str, Range]
) -> dict[str, dict[str, float]]:
    """Numbers by name and key of the section ``key``, in the file's order; what is left out of an entry is its default.

    ``names``: those that may have an entry, each a ``kind``. Raises :class:`InputError` naming the file, the key and what is valid.
    """
    names, found = list(names), dict[str, dict[str, float]]()
    if not isinstance(rows, Mapping):
        raise InputError(f"{path}: key '{key}': a mapping is needed, with entries of: {', '.join(names)}")
    for name, row in rows.items():
        if name not in names:
            raise InputError(f"{path}: {unknown_name(kind, str(name), names)}")
        if not isinstance(row, Mapping):
            raise InputError(f"{path}: key '{key}.{name}': a mapping is needed; valid keys: {', '.join(keys)}")
        for entry in row:
            if entry not in keys:
                raise InputError(f"{path}: {unknown_name('key', f'{key}.{name}.{entry}', keys)}")
        found[name] = {
            entry: valid.check(f"{path}: key '{key}.{name}.{entry}'", row[entry]) if entry in row else valid.default
            for entry, valid in keys.items()
        }
    return found


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
