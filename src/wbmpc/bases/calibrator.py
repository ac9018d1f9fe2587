"""What finds the calibration of steered wheels (:meth:`wbmpc.bases.base.BaseType.calibrator`), as commands ask for it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from wbmpc.estimation.wheel_calibration import WheelCalibration
    from wbmpc.model.wheels import ModuleGeometry

Array = NDArray[np.float64]


class WheelFit(Protocol):
    """What a log shows of steered wheels: ``calibration``, of what was believed ``previous`` (with a larger covariance than the prior's
    where the log contradicts that); global poses ``used`` and ``given``."""

    @property
    def calibration(self) -> WheelCalibration: ...
    @property
    def previous(self) -> WheelCalibration: ...
    @property
    def used(self) -> int: ...
    @property
    def given(self) -> int: ...
    def hidden(self) -> dict[str, tuple[Array, Array]]:
        """Combinations of "steer zeros" and of "radii" that the log does not show: weights (k, n), standard deviations (k)."""


class Calibrator(Protocol):
    """Finds steer zeros and wheel radii of one robot from the log of a run with global poses. ``robot``: its name; ``names``: of the
    wheels in calibration files; ``geometry``: of the wheels as described."""

    robot: str
    names: list[str]
    geometry: ModuleGeometry

    def fit(self, channels: Mapping[str, Array], prior: WheelCalibration, source: str) -> WheelFit:
        """What the ``channels`` of a log show, beginning from a ``prior``; ``source`` is its name in errors. Raises
        :class:`InputError` for a log that does not have what is needed."""

    def fit_arm(self, channels: Mapping[str, Array], source: str) -> dict[str, dict[str, float]] | None:
        """By joint ``offset`` and ``offset_std`` [rad] of the arm's encoders, from the channel 'tracked' of a log: rows of the arm's
        angles (m), the position (3) [m] of its end effector in axes of the base, and its standard deviation. None without it."""
