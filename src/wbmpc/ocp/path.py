"""Paths in space by arc length: smooth positions and orientations, and what a solve needs of them near a point."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.checks import real_numbers, unit_quaternions
from wbmpc.errors import InputError

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

#: Numbers of a path near a point: arc length, position, tangent, curvature vector, quaternion, turning, where it begins and ends.
WIDTH = 19
#: The end [m] of a path without one.
ENDLESS = 1e6
#: Pieces of a path's own splines at least, points of a circle, points in which the nearest one is looked for.
PIECES, CIRCLE, SEARCHED = 400, 240, 2001
#: Points of a path may not be nearer [m] to each other than this.
MIN_LENGTH = 1e-9
#: Gauss-Legendre nodes of an arc length.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


class Path:
    """A cubic spline (C²) through ``points`` (n, 3) [m] in the world, n ≥ 2, parametrized by its arc length s from 0 to ``length`` [m].

    ``quaternions`` (n, 4), or one (4,) for all, orient the end effector (left out: not turned); in between they are interpolated as
    smoothly. ``periodic``: closed, from the last point back to the first; s keeps growing with every round. On an open path, arc lengths
    beyond its ends are clamped. Raises :class:`InputError` for other shapes, points that repeat and
    numbers that are not finite.
    """

    def __init__(self, points: ArrayLike, quaternions: ArrayLike | None = None, *, periodic: bool = False) -> None:
        points = np.atleast_2d(real_numbers("path, points", points))
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < (3 if periodic else 2):
            raise InputError(
                f"path, points: shape (n, 3) with n ≥ {3 if periodic else 2} is needed, got {points.shape}"
            )
        if not np.isfinite(points).all():
            raise InputError("path, points: must be finite")
        turns = real_numbers("path, quaternions", [1.0, 0.0, 0.0, 0.0] if quaternions is None else quaternions)
        if turns.shape not in ((4,), (len(points), 4)):
            raise InputError(f"path, quaternions: shape (4,) or ({len(points)}, 4) is needed, got {turns.shape}")
        turns = unit_quaternions("path", np.broadcast_to(turns, (len(points), 4)).copy())
        self.periodic = bool(periodic)
        if periodic:
            points, turns = np.vstack([points, points[:1]]), np.vstack([turns, turns[:1]])
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if steps.min() < MIN_LENGTH:
            k = int(np.argmin(steps))
            raise InputError(f"path, points: {k} and {(k + 1) % (len(points) - periodic)} are at one place")
        self._fit(points, turns, np.concatenate([[0.0], np.cumsum(steps)]))

    def _fit(self, points: Array, turns: Array, chord: Array) -> None:
        """Splines over the chord, their arc length, splines over that."""
        from scipy.interpolate import CubicHermiteSpline, CubicSpline  # a third of the start of runs without paths

        given = CubicSpline(chord, points, bc_type="periodic" if self.periodic else "not-a-knot")
        cuts = max(1, -(-PIECES // (len(chord) - 1)))
        inside = np.arange(cuts) * (np.diff(chord) / cuts)[:, None] + chord[:-1, None]
        u = np.concatenate([inside.ravel(), chord[-1:]])
        half = 0.5 * np.diff(u)
        inner = (u[:-1] + half)[:, None] + half[:, None] * _NODES
        arc = np.concatenate([[0.0], np.cumsum(half * (np.linalg.norm(given(inner, 1), axis=2) @ _WEIGHTS))])
        speed = np.linalg.norm(given(u, 1), axis=1)
        if speed.min() < 1e-6:
            raise InputError("path, points: the path turns about on the spot; give points that lead round")
        #: arc length [m] of the whole path, or of a round
        self.length = float(arc[-1])
        s = np.linspace(0.0, self.length, len(u))
        # u(s) by its values and slopes where the arc length is known
        at = CubicHermiteSpline(arc, u, 1.0 / speed)(s)
        at[[0, -1]] = chord[[0, -1]]
        tangents = given(chord[[0, -1]], 1) / speed[[0, -1], None]
        ends = "periodic" if self.periodic else ((1, tangents[0]), (1, tangents[1]))
        places = given(at)
        if self.periodic:
            places[-1] = places[0]
        self._position = CubicSpline(s, places, bc_type=ends)
        self._turn = _turn_spline(chord, turns, self.periodic, at, s)

    @classmethod
    def line(cls, start: ArrayLike, end: ArrayLike, quaternion: ArrayLike | None = None) -> Path:
        """A straight line from ``start`` (3) to ``end`` (3) [m], with a constant ``quaternion`` (4) (default: the identity)."""
        return cls([real_numbers("path, start", start), real_numbers("path, end", end)], quaternion)

    @classmethod
    def circle(
        cls, start: ArrayLike, center: ArrayLike, normal: ArrayLike = (0.0, 0.0, 1.0),
        quaternion: ArrayLike | None = None,
    ) -> Path:  # fmt: skip
        """A closed circle about ``center`` (3) [m] from ``start`` (3) on, counterclockwise seen from the tip of ``normal`` (3), with a
        constant ``quaternion`` (4) (default: the identity)."""
        middle, axis = real_numbers("path, center", center), real_numbers("path, normal", normal)
        arm, size = real_numbers("path, start", start) - middle, float(np.linalg.norm(axis))
        if size < MIN_LENGTH or abs(axis @ arm) > 1e-6 * size * np.linalg.norm(arm) or np.linalg.norm(arm) < MIN_LENGTH:
            raise InputError("path: a circle needs a start beside its center, at a right angle to its normal")
        angle = np.linspace(0.0, 2.0 * np.pi, CIRCLE, endpoint=False)[:, None]
        points = middle + np.cos(angle) * arm + np.sin(angle) * np.cross(axis / size, arm)
        return cls(points, quaternion, periodic=True)

    @classmethod
    def polyline(
        cls, points: ArrayLike, quaternions: ArrayLike | None = None, blend: float = 0.01, *, periodic: bool = False
    ) -> Path:
        """Straight lines through points (n, 3) [m]; each corner is rounded from ``blend`` [m] before it to ``blend`` after it."""
        points = np.atleast_2d(real_numbers("path, points", points))
        turns = np.broadcast_to(
            [1.0, 0.0, 0.0, 0.0] if quaternions is None else np.asarray(quaternions, float), (len(points), 4)
        )
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if not (np.isfinite(blend) and blend > 0.0) or len(steps) < 1 or steps.min() < MIN_LENGTH:
            raise InputError("path: a polyline needs points apart from each other and a blend that is positive")
        kept, turned = [points[0]], [turns[0]]
        for k in range(1, len(points) - 1):
            before, behind = (min(blend, 0.4 * steps[i]) / steps[i] for i in (k - 1, k))
            for share in np.linspace(-1.0, 1.0, 9):  # a parabola that touches both pieces
                a, b = 0.25 * (1.0 - share) ** 2 * before, 0.25 * (1.0 + share) ** 2 * behind
                kept.append(points[k] + a * (points[k - 1] - points[k]) + b * (points[k + 1] - points[k]))
                turned.append(lie.slerp(lie.slerp(turns[k], turns[k - 1], a), turns[k + 1], b))
        straight = _along(np.array([*kept, points[-1]]), np.array([*turned, turns[-1]]), blend)
        return cls(*straight, periodic=periodic)

    @property
    def end(self) -> float:
        """Largest progress [m]: the length, or practically infinite for a periodic path."""
        return ENDLESS if self.periodic else self.length

    # ------------------------------------------------------------------ at arc lengths
    def at(self, s: ArrayLike) -> Array:
        """Poses (n, 7) at arc lengths s (n) [m]: position (3) [m] and quaternion (4)."""
        s = self._inside(s)
        turn = self._turn(s)
        return np.hstack([self._position(s), turn / np.linalg.norm(turn, axis=1, keepdims=True)])

    def tangent(self, s: ArrayLike) -> Array:
        """Directions (n, 3) of the path, of length 1, at arc lengths s (n) [m]."""
        found = self._position(self._inside(s), 1)
        return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))

    def curvature(self, s: ArrayLike) -> Array:
        """Change of the tangent (n, 3) [1/m] along the path at arc lengths s (n) [m]."""
        return np.asarray(self._position(self._inside(s), 2))

    def turning(self, s: ArrayLike) -> Array:
        """Rotation per arc length (n, 3) [rad/m], world axes, at arc lengths s (n) [m]."""
        s = self._inside(s)
        turn, rate = self._turn(s), self._turn(s, 1)
        size = np.linalg.norm(turn, axis=1, keepdims=True)
        unit = turn / size
        rate = (rate - unit * np.sum(unit * rate, axis=1, keepdims=True)) / size
        back = unit * np.array([1.0, -1.0, -1.0, -1.0])
        return np.asarray(2.0 * np.asarray(lie.quaternion_multiply(rate.T, back.T))[1:].T)

    def expansion(self, s: ArrayLike) -> Array:
        """What residuals need near arc lengths s (n) [m]: (n, 19) of s, position, tangent, curvature, quaternion, turning,
        and where the path begins and ends."""
        here = np.atleast_1d(np.asarray(s, float))
        here = here if self.periodic else np.clip(here, 0.0, self.length)
        pose, ends = self.at(here), np.tile([-ENDLESS if self.periodic else 0.0, self.end], (here.size, 1))
        shape = (self.tangent(here), self.curvature(here))
        return np.hstack([here[:, None], pose[:, :3], *shape, pose[:, 3:], self.turning(here), ends])

    def nearest(self, point: ArrayLike) -> float:
        """Arc length [m] of the path's point nearest to ``point`` (3) [m]."""
        point = real_numbers("path, point", point)
        s = np.linspace(0.0, self.length, SEARCHED)
        best = float(s[np.argmin(np.linalg.norm(self._position(s) - point, axis=1))])
        for _ in range(20):  # Newton's method for the foot point, kept within the neighbors
            gap, tangent = self._position(self._inside([best]))[0] - point, self.tangent([best])[0]
            slope = max(1.0 + float(self.curvature([best])[0] @ gap), 0.5)
            step = float(np.clip(-(tangent @ gap) / slope, -s[1], s[1]))
            best = best + step if self.periodic else float(np.clip(best + step, 0.0, self.length))
            if abs(step) < 1e-12:
                break
        return best % self.length if self.periodic else best

    def _inside(self, s: ArrayLike) -> Array:
        s = np.atleast_1d(np.asarray(s, float))
        return np.mod(s, self.length) if self.periodic else np.clip(s, 0.0, self.length)


def _turn_spline(chord: Array, turns: Array, periodic: bool, at: Array, s: Array) -> CubicSpline:
    """Quaternions, of any length, over the arc length; ``at``: the chord at arc lengths s."""
    from scipy.interpolate import CubicSpline

    if periodic:  # three rounds, because after one the sign may be another
        chord = np.concatenate([chord[:-1] - chord[-1], chord[:-1], chord + chord[-1]])
        turns = np.vstack([turns[:-1], turns[:-1], turns])
    signs = np.cumprod(np.where(np.sum(turns[1:] * turns[:-1], axis=1) < 0.0, -1.0, 1.0))
    spline = CubicSpline(chord, turns * np.concatenate([[1.0], signs])[:, None])
    values, slopes = spline(at), spline(at, 1)
    # slopes by arc length at the ends make both rounds' derivatives the same
    scale = [(at[1] - at[0]) / (s[1] - s[0]), (at[-1] - at[-2]) / (s[-1] - s[-2])]
    return CubicSpline(s, values, bc_type=((1, slopes[0] * scale[0]), (1, slopes[-1] * scale[1])))


def _along(points: Array, turns: Array, step: float) -> tuple[Array, Array]:
    """The same polyline with points, and quaternions in between, at most ``step`` [m] apart."""
    kept, turned = [points[:1]], [turns[:1]]
    for a, b, q, r in zip(points, points[1:], turns, turns[1:]):
        share = np.linspace(0.0, 1.0, min(int(np.linalg.norm(b - a) / step) + 2, SEARCHED))[1:]
        kept.append(a + share[:, None] * (b - a))
        turned.append(_turns_between(q, r, share))
    return np.vstack(kept), np.vstack(turned)


def _turns_between(q: Array, r: Array, share: Array) -> Array:
    """Quaternions (n, 4) at shares (n) of the shortest way from ``q`` to ``r``, as of :func:`wbmpc.lie.slerp`, all at once."""
    way = lie.quaternion_log(lie.quaternion_multiply(lie.quaternion_conjugate(q), r))
    angle = float(np.linalg.norm(way))
    if angle < 1e-12:
        return np.tile(q, (share.size, 1))
    half = 0.5 * angle * share
    turns = np.vstack([np.cos(half), np.outer(way / angle, np.sin(half))])
    return np.asarray(lie.quaternion_multiply(np.tile(q[:, None], share.size), turns).T)
