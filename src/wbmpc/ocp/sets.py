"""Sets that a constraint's residual may be asked to lie in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.checks import real_numbers
from wbmpc.errors import InputError


@dataclass(frozen=True)
class Zero:
    """The residual is zero: a state-input equality."""


@dataclass(frozen=True)
class NonNegative:
    """Every row of the residual is at least zero."""


@dataclass(frozen=True)
class Box:
    """Every row lies between ``lower`` (n) and ``upper`` (n), or one number for all rows [units of the residual]; infinite where there is no
    bound."""

    lower: ArrayLike
    upper: ArrayLike

    def __post_init__(self) -> None:
        lower, upper = real_numbers("box, lower", self.lower), real_numbers("box, upper", self.upper)
        if np.any(lower == np.inf) or np.any(upper == -np.inf):
            raise InputError(
                f"box: a lower bound of inf or an upper one of -inf allows nothing, got {lower.tolist()} and {upper.tolist()}"
            )
        if lower.shape == upper.shape or not (lower.ndim and upper.ndim):
            crossed = np.broadcast_to(lower > upper, np.broadcast_shapes(lower.shape, upper.shape))
            if crossed.any():
                row = f" in row {int(np.argmax(crossed))}" if crossed.ndim else ""
                raise InputError(
                    f"box: the lower bound is above the upper one{row}, got {lower.tolist()} and {upper.tolist()}"
                )

    def bounds(self, rows: int) -> tuple[np.ndarray, np.ndarray]:
        """``lower`` and ``upper`` as arrays of ``rows`` numbers."""
        sides = {"lower": real_numbers("box, lower", self.lower), "upper": real_numbers("box, upper", self.upper)}
        for name, side in sides.items():
            if (side.ndim and side.shape != (rows,)) or np.isnan(side).any():
                raise InputError(f"box: {name} needs one number or {rows}, none of them NaN, got {side}")
        return np.broadcast_to(sides["lower"], rows), np.broadcast_to(sides["upper"], rows)


Set = Zero | NonNegative | Box
