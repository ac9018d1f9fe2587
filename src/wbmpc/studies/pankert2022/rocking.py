"""When a body that stands begins to rock over an edge of its support, from its gyro.

Past the edge a rigid body falls away as an inverted pendulum. A load whose zero-moment point crosses the edge at a constant
speed v makes it turn at ω(τ) = v / h · (cosh kτ − 1) a time τ after the crossing, with the height h of the center of mass over the
edge and k² = m g h / I about it. So its rate is zero with zero slope where it begins: a threshold sees it late, by some tenths of a
second, and the curve gives the beginning. ``v / h`` is fitted along with it; k is taken as known, for it hardly matters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.checks import positive
from wbmpc.errors import InputError

#: k [1/s] of a robot about a meter wide with its load half a meter high. Between 2.5 and 3.5 the beginning moves by 10 ms.
GROWTH = 3.0
#: A mean rate over WINDOW [s] above FAST [rad/s] is a rocking (fifty times a gyro's noise); it may have begun up to BEFORE [s] ago.
#: When it has been slower for QUIET [s], another one can begin: what comes in between is the bounce.
WINDOW, FAST, BEFORE, QUIET = 0.05, 0.05, 1.0, 0.5
#: Steps [s] in which the beginning is searched.
_STEP = 0.002


@dataclass(frozen=True)
class Rocking:
    """A rocking that began at ``time`` [s], in the sense of ``sign`` (±1) about the axis that was asked for."""

    time: float
    sign: int


def rockings(times: ArrayLike, rate: ArrayLike, growth: float = GROWTH, fast: float = FAST) -> list[Rocking]:
    """The rockings in rates (k,) [rad/s] about the edge at evenly spaced ``times`` (k,) [s], the gyro's bias taken away.

    ``growth`` [1/s]: k of the pendulum; ``fast`` [rad/s]: what counts as rocking. Raises :class:`InputError` for times that are not
    evenly spaced and rates that are not finite.
    """
    positive("rocking", growth=growth, fast=fast)
    t, w = np.asarray(times, float), np.asarray(rate, float)
    if t.ndim != 1 or t.size < 2 or w.shape != t.shape or not (np.isfinite(t).all() and np.isfinite(w).all()):
        raise InputError(
            f"rocking: finite rates are needed, one for each of two times or more, got {t.shape}, {w.shape}"
        )
    h = (t[-1] - t[0]) / (t.size - 1)
    if not h > 0.0 or np.abs(np.diff(t) - h).max() > 0.1 * h:
        raise InputError("rocking: times must rise in even steps")
    width = max(round(WINDOW / h), 1)
    mean = np.convolve(w, np.full(width, 1.0 / width))[: w.size]  # of the past alone
    found, last = [], -np.inf
    for i in np.flatnonzero(np.abs(mean) > fast):
        if t[i] - last > QUIET:
            sign = 1 if mean[i] > 0.0 else -1
            part = slice(max(i - round((BEFORE + QUIET) / h), 0), i + 1)
            found.append(Rocking(_beginning(t[part], sign * w[part], growth), sign))
        last = t[i]
    return found


def _beginning(t: Array, rate: Array, growth: float) -> float:
    """Where in ``t`` the curve that fits the rates best begins to rise: least squares over its height, then over where."""
    starts = np.arange(max(t[-1] - BEFORE, t[0]), t[-1] - WINDOW, _STEP)
    if not starts.size:  # it rocked at the first sample
        return float(t[0])
    curves = np.cosh(growth * np.clip(t - starts[:, None], 0.0, None)) - 1.0
    explained = np.clip(curves @ rate, 0.0, None) ** 2 / np.sum(curves * curves, axis=1)
    return float(starts[int(np.argmax(explained))])
