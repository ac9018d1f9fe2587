"""What finds the calibration file of a base (:meth:`wbmpc.bases.base.BaseType.calibrator`), as commands ask for it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from wbmpc.arrays import Array


class FoundCalibration(Protocol):
    """What a log shows of one robot."""

    def save(self, path: Path, follow: bool = True) -> None:
        """Write the file that runs read; ``follow``: also where a link leads."""

    def table(self) -> dict[str, Any]:
        """The numbers, as JSON has them."""

    def lines(self) -> list[str]:
        """The numbers, for readers; what the log does not show, and what was not used of it."""


class Calibrator(Protocol):
    """Finds zeros of encoders and radii of wheels of one robot from the log of a run with global poses."""

    def has_base_of(self, other: Calibrator) -> bool:
        """Whether the base of the ``other`` calibrator's robot is described as this one's is, but for what a calibration finds."""

    def find(
        self, channels: Mapping[str, Array], source: str, *, zero_std: float, radius_std: float
    ) -> FoundCalibration:
        """What the ``channels`` of a log show; ``source`` is its name in errors. Standard deviations before: of the encoders' zeros [rad],
        and of the radius that all wheels have (relative), with half of it for each. Raises :class:`InputError` for a log that does not have
        what is needed."""
