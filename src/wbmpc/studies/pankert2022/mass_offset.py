"""How far a robot's masses are from the model's, from when it tips over known edges of its support.

Masses and centers of mass that differ from the model's shift its zero-moment point. At rest, for a robot that is rigid but for an
arm turning about the vertical, that shift is

    p(α) = c + R(α) b,

c of what stands still and b of what turns with the arm's heading α: every part's moment over the robot's weight is one or the
other. Not in it: the heights of centers of mass (where the robot stands tilted they shift the point too: 2.5 mm on 0.2 rad by half
a millimeter), the mass as a whole, and what other leg angles do to c.

When the robot tips over an edge, its zero-moment point is on it. That is one row, n · (z + c + R(α) b − e) = 0 in (c, b), with the
model's point z, a point e of the edge and its normal n. The rows are solved together with what is known beforehand, a normal
distribution about zero: directions that no row shows stay as they were, and the covariance says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.checks import positive
from wbmpc.errors import InputError

#: Standard deviations [m] of c and b beforehand, of each axis: about those of the 100 kg robot with
#: masses ±5 % and centers of mass ±10 mm (3.3 and 2.6 mm, 2.2 and 1.2 mm rms over twenty draws).
BASE, ARM = 0.004, 0.002
#: Standard deviation [m] of a zero-moment point at the time of a tipping: 20 mm/s for 20 ms, and half a millimeter of the legs'
#: masses (which move with the legs), of heights and feet.
SEEN = 0.0007


@dataclass(frozen=True)
class Tipping:
    """The robot tips over the ``edge`` (2, 2) [m] between two feet while its model has its zero-moment point at ``point`` (2) [m]
    and its arm looks to ``heading`` [rad]; all in axes of the base."""

    edge: Array
    point: Array
    heading: float

    def row(self) -> tuple[Array, float]:
        """(normal · [1, R(α)] (4), what the shift must be along the normal [m])."""
        (p, q), point = np.asarray(self.edge, float), np.asarray(self.point, float)
        along = q - p
        length = float(np.hypot(*along))
        if not (np.isfinite([p, q, point]).all() and np.isfinite(self.heading) and length > 1e-6):
            raise InputError(
                "tipping: an edge between two places, a point and a heading are needed, all of them finite"
            )
        normal = np.array([-along[1], along[0]]) / length
        return np.concatenate([normal, normal @ _turned(self.heading)]), float(normal @ (p - point))


@dataclass(frozen=True)
class MassOffset:
    """Shift of the zero-moment point: ``base`` (2) [m] in axes of the base, ``arm`` (2) [m] in axes that turn with the arm.

    ``covariance`` (4, 4) [m²] of (base, arm); ``rank``: how many directions of the four were shown better than they were
    known beforehand.
    """

    base: Array
    arm: Array
    covariance: Array
    rank: int

    def at(self, heading: ArrayLike) -> Array:
        """The shift (..., 2) [m] with the arm's headings (...) [rad], in axes of the base."""
        return np.asarray(self.base + _turned(heading) @ self.arm)


def _turned(heading: ArrayLike) -> Array:
    """Rotation matrices (..., 2, 2) of angles (...) [rad]."""
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def estimate_mass_offset(
    tippings: Sequence[Tipping], base: float = BASE, arm: float = ARM, seen: float = SEEN
) -> MassOffset:
    """The most likely shift, given tippings whose points are known to ``seen`` [m] (standard deviation) and, beforehand, every
    axis of c to ``base`` [m] and of b to ``arm`` [m].

    One edge shows of c what is across it, and of b what is across the arm where it tips there; two edges that are not
    parallel show c. What of b is along an arm that always tips at right angles to the edge never shows, nor does it change when it
    tips there. Raises :class:`InputError` for spreads that are not positive, and values that are not finite.
    """
    positive("mass offset, spreads", base=base, arm=arm, seen=seen)
    prior = np.array([base, base, arm, arm])
    pairs = [t.row() for t in tippings]
    rows = np.array([r for r, _ in pairs]).reshape(-1, 4) * prior / seen  # both sides in standard deviations
    target = np.array([w for _, w in pairs]) / seen
    information = np.eye(4) + rows.T @ rows
    covariance = prior[:, None] * np.linalg.inv(information) * prior
    mean = prior * np.linalg.solve(information, rows.T @ target)
    rank = int(np.sum(np.linalg.svd(rows, compute_uv=False) > 1.0)) if pairs else 0
    return MassOffset(mean[:2], mean[2:], covariance, rank)
