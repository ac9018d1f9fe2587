"""What estimators are given, checked before anything of it is taken in: a number that is not finite stays in them for good."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.errors import InputError, NotFinite


def numbers(who: str, name: str, given: ArrayLike, size: int) -> NDArray[np.float64]:
    """``given`` as an array of ``size`` finite numbers, or :class:`InputError`, :class:`NotFinite` of ``who`` by ``name``."""
    value = np.asarray(given, float)
    if value.shape != (size,):
        raise InputError(f"{who}: '{name}' needs {size} finite numbers, got {value}")
    if not np.isfinite(value).all():
        raise NotFinite(f"{who}: '{name}' needs {size} finite numbers, got {value}")
    return value


def finite(who: str, **given: float) -> None:
    """Raise :class:`NotFinite` for the first number that is not finite, by its name."""
    for name, value in given.items():
        if not math.isfinite(value):
            raise NotFinite(f"{who}: '{name}' must be finite, got {value}")


def positive_time(who: str, interval: float) -> None:
    """Raise :class:`InputError` (:class:`NotFinite`) for an ``interval`` [s] in which no time has passed."""
    finite(who, interval=interval)
    if interval <= 0.0:
        raise InputError(f"{who}: 'interval' must be positive, got {interval} s")
