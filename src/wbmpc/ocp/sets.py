"""Sets that a constraint's residual may be asked to lie in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Zero:
    """The residual is zero: a state-input equality."""


@dataclass(frozen=True)
class NonNegative:
    """Every row of the residual is at least zero."""


@dataclass(frozen=True)
class Box:
    """Every row lies between ``lower`` and ``upper`` (arrays or scalars; infinite where there is no bound)."""

    lower: ArrayLike
    upper: ArrayLike

    def bounds(self, rows: int) -> tuple[np.ndarray, np.ndarray]:
        """``lower`` and ``upper`` as arrays of ``rows`` numbers."""
        return np.broadcast_to(np.asarray(self.lower, float), rows), np.broadcast_to(np.asarray(self.upper, float), rows)


Set = Zero | NonNegative | Box
