"""What is known of a base's steered wheels: zeros of the steering encoders and radii, and its file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from wbmpc.checks import is_covariance, not_negative, numbers
from wbmpc.errors import InputError, unknown_name
from wbmpc.model.wheels import ModuleGeometry
from wbmpc.output_file import write_text
from wbmpc.yaml_file import load_yaml

Array = NDArray[np.float64]

#: Standard deviations of a base that nobody calibrated: steering zero (with the leg's, which turns the wheel as well)
#: [rad], radius of one wheel and of all of them, relative.
ZERO_STD, RADIUS_STD, COMMON_RADIUS_STD = 2e-3, 1e-3, 2e-3


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
        cls,
        geometry: ModuleGeometry,
        zero: float = ZERO_STD,
        radius: float = RADIUS_STD,
        common_radius: float = COMMON_RADIUS_STD,
    ) -> WheelCalibration:
        """The description's numbers, with standard deviations [rad, relative, relative] of what they may be off."""
        not_negative("wheel calibration", zero=zero, radius=radius, common_radius=common_radius)
        n = geometry.modules
        covariance = np.diag(np.repeat([zero**2, radius**2], n))
        covariance[n:, n:] += common_radius**2
        return cls(np.zeros(n), np.zeros(n), np.full(n, geometry.wheel_radius), covariance)

    @classmethod
    def exact(cls, geometry: ModuleGeometry) -> WheelCalibration:
        """The description's numbers, without any doubt."""
        return cls.unknown(geometry, 0.0, 0.0, 0.0)

    @property
    def modules(self) -> int:
        """Number of modules n."""
        return len(self.steer_offset)

    def rise(self, geometry: ModuleGeometry) -> float:
        """By how much [m] the base stands higher than described: radii that roll farther carry it higher. (Of a soft tyre's sink
        a rolling radius holds half.)"""
        return float(np.mean(self.wheel_radius)) - geometry.wheel_radius

    @property
    def std(self) -> tuple[Array, Array]:
        """Standard deviations (n) of the steer zeros [rad] and of the radii (relative)."""
        s = np.sqrt(np.diag(self.covariance))
        return s[: self.modules], s[self.modules :]

    def save(
        self,
        path: Path,
        modules: list[str],
        notes: Sequence[str] = (),
        arm: Mapping[str, Mapping[str, float]] | None = None,
    ) -> None:
        """Write a YAML file with one entry for each of the named modules (their steer joints), ``notes`` as comments, and what is known
        of the ``arm`` by its joints."""
        std = self.std
        rows = {
            name: {
                "steer_offset": float(self.steer_offset[i]),
                "leg_offset": float(self.leg_offset[i]),
                "wheel_radius": float(self.wheel_radius[i]),
                "steer_offset_std": float(std[0][i]),
                "wheel_radius_std": float(std[1][i]),
            }
            for i, name in enumerate(modules)
        }
        scale = np.concatenate(std)
        scale[scale == 0.0] = 1.0
        correlation = self.covariance / np.outer(scale, scale)
        correlation[np.diag_indices_from(correlation)] = 1.0
        head = "# Steered wheels: zeros [rad] (true angle = measured - zero), radii [m], relative std of the radii.\n"
        head += "".join(f"# {note}\n" for note in notes)
        tail = "# Correlation of what is left of the zeros, then of the radii, modules as above: what is known better together.\n"
        tail += yaml.safe_dump({"correlation": correlation.tolist()}, default_flow_style=None, width=2**31)
        write_text(
            path, head + yaml.safe_dump({"modules": rows, **({"arm": arm} if arm else {})}, sort_keys=False) + tail
        )

    @classmethod
    def load(cls, path: Path | str, geometry: ModuleGeometry, modules: list[str]) -> WheelCalibration:
        """Read such a file; keys that are left out are the description's, and without ``correlation`` errors are independent.
        Raises :class:`InputError` naming the key."""
        rows, correlation = _read(Path(path), modules)
        value = lambda key, default: np.array([_number(path, n, key, rows[n].get(key, default)) for n in modules])
        std = np.concatenate([value("steer_offset_std", 0.0), value("wheel_radius_std", 0.0)])
        radius = value("wheel_radius", geometry.wheel_radius)
        if (radius <= 0.0).any() or (std < 0.0).any():
            raise InputError(f"{path}: radii must be positive, standard deviations must not be negative")
        covariance = np.outer(std, std) * _correlation(path, correlation, list(rows), modules)
        return cls(value("steer_offset", 0.0), value("leg_offset", 0.0), radius, covariance)


_KEYS = ("steer_offset", "leg_offset", "wheel_radius", "steer_offset_std", "wheel_radius_std")


def _correlation(path: Path | str, matrix: object, order: list[str], modules: list[str]) -> Array:
    """What a file gives (2n, 2n) with its modules in their ``order``, for ``modules``; independent errors for None."""
    n = len(modules)
    if matrix is None:
        return np.eye(2 * n)
    try:
        values = np.asarray(matrix, float)
    except (TypeError, ValueError):
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


def _read(path: Path, modules: list[str]) -> tuple[dict[str, dict[str, object]], object]:
    """By module, in the file's order, what it says; and its correlation (None if there is none)."""
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; 'wbmpc calibrate' writes one")
    data = load_yaml(path)
    rows = data.get("modules") if isinstance(data, Mapping) else None
    if not isinstance(rows, Mapping):
        raise InputError(f"{path}: one key 'modules' is needed, with an entry for each of: {', '.join(modules)}")
    for key in data:
        if key not in ("modules", "correlation", "arm"):
            raise InputError(f"{path}: {unknown_name('key', str(key), ('modules', 'correlation', 'arm'))}")
    for name in rows:
        if name not in modules:
            raise InputError(f"{path}: {unknown_name('module', str(name), modules)}")
        if not isinstance(rows[name], Mapping):
            raise InputError(f"{path}: key 'modules.{name}': a mapping is needed; valid keys: {', '.join(_KEYS)}")
        for key in rows[name]:
            if key not in _KEYS:
                raise InputError(f"{path}: {unknown_name('key', f'modules.{name}.{key}', _KEYS)}")
    missing = [n for n in modules if n not in rows]
    if missing:
        raise InputError(f"{path}: key 'modules': there is no entry for {', '.join(missing)}")
    return {n: dict(row) for n, row in rows.items()}, data.get("correlation")


def _number(path: Path | str, module: str, key: str, value: object) -> float:
    if isinstance(value, (int, float)) and not isinstance(value, bool) and np.isfinite(value):
        return float(value)
    raise InputError(f"{path}: key 'modules.{module}.{key}': a finite number is needed, got {value!r}")
