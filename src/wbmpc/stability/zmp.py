"""The zero-moment point of gravity, inertia and external wrenches.

The frame is that of the ground: origin on it, z along its normal; on a slope gravity is not along −z there. With the sum
of all loads as a force F and a moment M about the origin, the ground's answer has no tipping moment about
p = (−M_y, M_x) / F_z (Pankert et al. 2022, section II-A; Vukobratović and Borovac 2004).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wbmpc import constants
from wbmpc.arrays import Array
from wbmpc.checks import finite
from wbmpc.errors import InputError

#: Gravity [m/s²] on level ground.
GRAVITY = (0.0, 0.0, -constants.GRAVITY)
_NOTHING = (0.0, 0.0, 0.0)


def _vector(name: str, value: ArrayLike) -> Array:
    try:
        vector = np.asarray(value, float)
    except (TypeError, ValueError):
        raise InputError(f"{name}: 3 finite numbers are needed, got {value!r}") from None
    if vector.shape[-1:] != (3,) or not np.isfinite(vector).all():
        raise InputError(f"{name}: 3 finite numbers are needed, got {np.array2string(vector, threshold=8)}")
    return vector


def _mass(value: float) -> float:
    finite("load", mass=value)
    if value < 0.0:
        raise InputError(f"load: 'mass' must not be negative, got {value} kg")
    return value


@dataclass(frozen=True)
class Load:
    """What pulls at the robot: ``force`` (..., 3) [N] and ``moment`` (..., 3) [N m] about the origin; loads add up."""

    force: Array
    moment: Array

    def __add__(self, other: Load) -> Load:
        return Load(self.force + other.force, self.moment + other.moment)

    @classmethod
    def wrench(cls, force: ArrayLike, moment: ArrayLike = _NOTHING, point: ArrayLike = _NOTHING) -> Load:
        """A force and a moment at a point (3 each)."""
        f, m, p = _vector("force", force), _vector("moment", moment), _vector("point", point)
        return cls(f, m + np.cross(p, f))

    @classmethod
    def gravity(cls, mass: float, com: ArrayLike, gravity: ArrayLike = GRAVITY) -> Load:
        """The weight of ``mass`` [kg] with its center at ``com`` (..., 3) [m]."""
        c, g = _vector("com", com), _vector("gravity", gravity)
        force = _mass(mass) * np.broadcast_to(g, c.shape)
        return cls(force, np.cross(c, force))

    @classmethod
    def inertia(cls, mass: float, com: ArrayLike, acceleration: ArrayLike, spin_rate: ArrayLike = _NOTHING) -> Load:
        """What a motion asks for: ``acceleration`` (..., 3) [m/s²] of the center of mass, ``spin_rate`` (..., 3) [N m]: time
        derivative of the angular momentum about it."""
        c = _vector("com", com)
        force = -_mass(mass) * _vector("acceleration", acceleration)
        return cls(force, np.cross(c, force) - _vector("spin rate", spin_rate))


def slope_gravity(slope: float, uphill: float = 0.0, size: float = constants.GRAVITY) -> Array:
    """Gravity (3) [m/s²] in the frame of ground that rises by ``slope`` [rad] towards the direction ``uphill`` [rad].

    Raises :class:`InputError` for slopes of a quarter turn or more, on which nothing stands.
    """
    if not (abs(slope) < 0.5 * np.pi and np.isfinite(uphill) and 0.0 < size < np.inf):
        raise InputError(
            f"slope: less than 1.57 rad and a finite direction are needed, got {slope:g}, {uphill:g} rad ({size:g} m/s²)"
        )
    s = np.sin(slope)
    return -size * np.array([s * np.cos(uphill), s * np.sin(uphill), np.cos(slope)])


def zero_moment_point(load: Load) -> Array:
    """The point (..., 2) [m] on the ground; not a number where the load does not press on it."""
    down = np.where(load.force[..., 2] < 0.0, load.force[..., 2], np.nan)
    return np.stack([-load.moment[..., 1], load.moment[..., 0]], axis=-1) / down[..., None]
