"""Which three feet a rigid robot stands on, and when that changes along a motion.

On feet of different height the robot stands on a face of the upper convex hull of the points (x, y, height): the ground
carries it from below. On each face it is tilted, which moves its zero-moment point; where that point leaves the face
through an edge, the robot rocks over it to the neighboring face.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.stability.geometry import Triangle, checked_feet, cross, edge_distances, support_triangles

#: Largest step [m] by which a foot may stand above a face that still counts as carrying.
_LEVEL = 1e-9


def resting_triangles(feet: ArrayLike, heights: ArrayLike) -> list[Triangle]:
    """The triangles on which a robot with feet (n, 2) [m] can stand on ground of ``heights`` (n) [m] under them.

    Those without a point of the ground above their plane; together they cover the support polygon. On level ground all.
    """
    points = checked_feet(feet)
    h = np.asarray(heights, float)
    if h.shape != (len(points),) or not np.isfinite(h).all():
        raise InputError(f"heights: {len(points)} finite numbers are needed, got {h}")
    return [t for t in support_triangles(points) if _above(points, h, t) <= _LEVEL]


def _above(points: Array, heights: Array, triangle: Triangle) -> float:
    """By how much [m] the highest point of the ground stands above the plane of three of them."""
    corners = points[list(triangle)]
    slope = np.linalg.solve(corners[1:] - corners[0], heights[list(triangle)][1:] - heights[triangle[0]])
    plane = heights[triangle[0]] + (points - corners[0]) @ slope
    return float(np.max(heights - plane))


def upright(feet: ArrayLike, heights: ArrayLike, triangle: Triangle) -> Array:
    """The vertical (3) in the robot's frame when it stands on three feet (z: normal to the plane of its feet).

    Exact: heights differ by the vertical times the way from foot to foot.
    """
    points, h = np.asarray(feet, float)[list(triangle)], np.asarray(heights, float)[list(triangle)]
    flat = np.linalg.solve(points[1:] - points[0], h[1:] - h[0])
    if flat @ flat >= 1.0:
        raise InputError(f"heights: a step of {np.ptp(h):g} m is too high for feet that near to each other")
    return np.array([*flat, np.sqrt(1.0 - flat @ flat)])


def support_shares(feet: ArrayLike, triangle: Triangle, point: ArrayLike) -> Array:
    """Shares (..., 3) of the load on the three feet for zero-moment points (..., 2): barycentric coordinates."""
    corners = np.asarray(feet, float)[list(triangle)]
    d = edge_distances(corners, point)
    along = np.roll(corners, -1, axis=0) - corners
    twice = float(cross(along[0], -along[2]))
    # the distance to the edge opposite of a foot over its height
    return np.asarray(np.roll(d * np.linalg.norm(along, axis=1), 2, axis=-1) / twice)


@dataclass(frozen=True)
class Switch:
    """At ``time`` [s] the feet ``previous`` stop carrying; ``after`` do, or none: the robot tips over an edge."""

    time: float
    previous: tuple[int, ...]
    after: tuple[int, ...]


def _rising(times: ArrayLike) -> Array:
    """``times`` (k,) [s], finite and each later than the one before, or :class:`InputError`."""
    t = np.asarray(times, float)
    if t.ndim != 1 or not t.size or not np.isfinite(t).all() or (np.diff(t) <= 0.0).any():
        raise InputError("times: finite numbers are needed, each larger than the one before")
    return t


#: (vertical (3) in the robot's frame, triangle) -> feet (n, 2) [m], zero-moment points (k, 2) [m], forces (k,) [N].
Stance = Callable[[Array, Triangle], tuple[Array, Array, Array]]


def support_switches(
    times: ArrayLike,
    feet: ArrayLike,
    heights: ArrayLike,
    stance: Stance,
    unloaded: float = 0.0,
    start: ArrayLike | None = None,
) -> list[Switch]:
    """When a robot rocks from three feet to others while it moves slowly over ground of ``heights`` (n) [m].

    ``stance(vertical, triangle)`` gives, for the robot standing on that triangle, its feet (n, 2) [m], its zero-moment
    points (k, 2) [m] at the times, and the forces (k,) [N] that press on the ground. The robot rocks when a foot would have
    to pull; the switch is dated to when that foot carries less than ``unloaded`` [N]. Rocking itself is taken as short.
    Tilted either way a robot may stand on either of two triangles: it starts on the one with the point ``start`` (2) [m],
    its zero-moment point before it tilted, or else on the one that it stands on more firmly. Where it would rock back at once, for
    on both of two neighbors it tips to the other, it balances on their common edge: there the prediction ends. Raises
    :class:`InputError` for times that do not rise and for a ``stance`` of other lengths, or that is not finite (nothing presses on
    the ground, as of a robot that is lifted: it stands on nothing).
    """
    t, points = _rising(times), checked_feet(feet)
    faces = resting_triangles(points, heights)
    forces: dict[Triangle, Array] = {}
    for face in faces:
        stood, zmp, press = _checked_stance(stance(upright(points, heights, face), face), len(points), t.size)
        forces[face] = support_shares(stood, face, zmp) * press[:, None]
    firmness = lambda f: float(forces[f][0].min() if start is None else support_shares(points, f, start).min())
    now: Triangle | None = max(faces, key=firmness)
    found: list[Switch] = []
    k = 0
    at_once: set[Triangle] = set()  # faces on which it has stood at sample k
    while now is not None:
        carried = forces[now]
        tipped = np.flatnonzero((carried[k:] < 0.0).any(axis=1))
        if not tipped.size:
            break
        i = k + int(tipped[0])
        foot = int(np.argmin(carried[i]))
        others = [f for f in faces if now[foot] not in f and len(set(f) & set(now)) == 2]
        at_once = {*(at_once if i == k else ()), now}
        best = max(others, key=lambda f: float(forces[f][i].min()), default=None)
        if best in at_once:
            break
        when = _falls_below(t[k : i + 1], carried[k : i + 1, foot], unloaded)
        found.append(Switch(when, tuple(sorted(now)), tuple(sorted(best or ()))))
        now, k = best, i
    return found


def _checked_stance(stance: tuple[Array, Array, Array], feet: int, times: int) -> tuple[Array, Array, Array]:
    """Feet (n, 2), points (k, 2) and forces (k,) of finite numbers, or :class:`InputError`."""
    needed = {"feet": (feet, 2), "zero-moment points": (times, 2), "forces": (times,)}
    arrays = [np.asarray(values, float) for values in stance]
    for (name, shape), values in zip(needed.items(), arrays, strict=True):
        if values.shape != shape or not np.isfinite(values).all():
            raise InputError(f"stance: {name}: finite numbers of shape {shape} are needed, got {values.shape}")
    return arrays[0], arrays[1], arrays[2]


def _falls_below(t: Array, values: Array, level: float) -> float:
    """When values last fall below a level; the first time if they start below it. Linear between samples."""
    above = np.flatnonzero(values >= level)
    if not above.size:
        return float(t[0])
    i = int(above[-1])
    share = (values[i] - level) / (values[i] - values[i + 1])
    return float(t[i] + share * (t[i + 1] - t[i]))
