"""What 'wbmpc calibrate' writes and runs read: the keys of the file, and the numbers that the parts of a robot can have there."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc.checks import quoted, real_number
from wbmpc.errors import InputError, unknown_name
from wbmpc.yaml_file import load_yaml

#: Keys of the file.
KEYS = ("robot", "modules", "arm", "correlation")
#: How far encoders are mounted [rad] beside what the robot's file says, at most: farther off, it is the robot's file that is wrong, or
#: another robot's calibration.
ZERO_RANGE = 0.6


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
