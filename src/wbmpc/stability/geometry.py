"""Support polygon, support triangles and where they overlap, in the plane of the ground.

Source: Pankert et al., RA-L 2022 (arXiv 2206.15298), section II-A: a rigid robot on more than three feet stands on three of
them at a time. Inside the support polygon it does not fall over; while the zero-moment point stays in the same
triangles it does not rock from one to another either.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.errors import InputError

Triangle = tuple[int, int, int]

#: Twice the area [m²] below which three feet stand on one line; distance [m] at which a point is on a line, by rounding.
_FLAT, _ON_LINE = 1e-9, 1e-9
#: Root of the sum of squares of the feet's distances [m] from a line on which they all stand, at most.
_LINE = 1e-6


def checked_feet(feet: ArrayLike) -> Array:
    """``feet`` as (n, 2) [m], n ≥ 3 and not all on one line, or :class:`InputError`."""
    try:
        points = np.asarray(feet, float)
    except (TypeError, ValueError):
        raise InputError(f"feet: at least 3 points (x, y) of finite numbers are needed, got {feet!r}") from None
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3 or not np.isfinite(points).all():
        raise InputError(f"feet: at least 3 points (x, y) of finite numbers are needed, got shape {points.shape}")
    x, y = (points - points.mean(axis=0)).T
    across, along, both = float(x @ x), float(y @ y), float(x @ y)
    # the smaller eigenvalue: sum of squares of their distances from the line that is nearest to all
    if 0.5 * (across + along - math.hypot(across - along, 2.0 * both)) <= _LINE**2:
        raise InputError("feet: all stand on one line, there is no support polygon")
    return points


def cross(a: Array, b: Array) -> Array:
    """z component of the vector product of points (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def hull(feet: ArrayLike) -> list[int]:
    """Indices of the feet (n, 2) on their convex hull, counter-clockwise (monotone chain); feet on an edge are left out."""
    return _hull(checked_feet(feet))


def _hull(points: Array) -> list[int]:
    # one by one, Python's own numbers are several times as fast
    rows = points.tolist()
    order = sorted(range(len(rows)), key=rows.__getitem__)

    def turn(a: int, b: int, c: int) -> float:
        (ax, ay), (bx, by), (cx, cy) = rows[a], rows[b], rows[c]
        return float((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))

    def chain(indices: list[int]) -> list[int]:
        out: list[int] = []
        for i in indices:
            while len(out) > 1 and turn(out[-2], out[-1], i) <= _FLAT:
                out.pop()
            out.append(i)
        return out[:-1]

    return chain(order) + chain(order[::-1])


def support_polygon(feet: ArrayLike) -> Array:
    """Corners (m, 2) [m] of the convex hull of feet (n, 2), counter-clockwise."""
    points = checked_feet(feet)
    return points[_hull(points)]


def area(polygon: ArrayLike) -> float:
    """Area [m²] of a polygon (m, 2); positive for counter-clockwise corners."""
    p = np.asarray(polygon, float)
    return 0.5 * float(np.sum(cross(p, np.roll(p, -1, axis=0))))


def edge_distances(polygon: ArrayLike, points: ArrayLike) -> Array:
    """Distances (..., m) [m] of points (..., 2) to the lines of a polygon's m edges, positive on the inner (left) side."""
    return _edge_distances(np.asarray(polygon, float)[None], np.asarray(points, float))[..., 0, :]


def _edge_distances(polygons: Array, points: Array) -> Array:
    """Of points (..., 2) to those of n polygons (n, m, 2): (..., n, m)."""
    along = np.roll(polygons, -1, axis=1) - polygons
    offset = points[..., None, None, :] - polygons
    return np.asarray(cross(along, offset) / np.hypot(along[..., 0], along[..., 1]))


def margin(polygon: ArrayLike, points: ArrayLike) -> Array:
    """Signed distance (...) [m] of points (..., 2) to the border of a convex, counter-clockwise polygon (m, 2).

    Positive inside, negative outside; minus infinity for points that are not finite (no load on the ground).
    """
    return np.asarray(_margins(np.asarray(polygon, float)[None], np.asarray(points, float))[..., 0])


def _margins(polygons: Array, points: Array) -> Array:
    """Of points (..., 2) to n polygons (n, m, 2): (..., n)."""
    known = np.asarray(np.isfinite(points).all(axis=-1))
    q = np.where(known[..., None], points, 0.0)
    inside = _edge_distances(polygons, q).min(axis=-1)
    along = np.roll(polygons, -1, axis=1) - polygons
    offset = q[..., None, None, :] - polygons
    share = np.clip(np.sum(offset * along, axis=-1) / np.sum(along * along, axis=-1), 0.0, 1.0)
    away = offset - share[..., None] * along
    outside = np.hypot(away[..., 0], away[..., 1]).min(axis=-1)
    return np.asarray(np.where(known[..., None], np.where(inside >= 0.0, inside, -outside), -np.inf))


def support_triangles(feet: ArrayLike) -> list[Triangle]:
    """All triples of feet (n, 2) that are not on one line, each counter-clockwise, starting with its smallest index."""
    return _support_triangles(checked_feet(feet))


def _support_triangles(points: Array) -> list[Triangle]:
    rows, found = points.tolist(), list[Triangle]()
    for i, j, k in combinations(range(len(rows)), 3):
        (ax, ay), (bx, by), (cx, cy) = rows[i], rows[j], rows[k]
        turn = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(turn) > _FLAT:
            found.append((i, j, k) if turn > 0.0 else (i, k, j))
    return found


@dataclass(frozen=True)
class Region:
    """A part of the support polygon whose points lie in the same ``triangles``; convex ``pieces`` (m, 2) [m], counter-clockwise.

    Wherever the feet's small differences in height put the robot down, it stands on one of those triangles, and it
    does not rock while its zero-moment point stays in the region.
    """

    triangles: tuple[Triangle, ...]
    pieces: tuple[Array, ...]

    @property
    def area(self) -> float:
        """Area [m²]."""
        return sum(area(p) for p in self.pieces)


def overlap_regions(feet: ArrayLike) -> list[Region]:
    """The regions where two or more support triangles overlap, the largest first.

    Four feet of which none stands inside the triangle of the others: the four regions that the two diagonals cut, each
    in two triangles. Three feet: none.
    """
    points = checked_feet(feet)
    triangles, pieces = _support_triangles(points), [points[_hull(points)]]
    for i, j in combinations(range(len(points)), 2):
        if np.hypot(*(points[j] - points[i])) < _ON_LINE:  # two feet in one place
            continue
        pieces = [part for piece in pieces for part in _cut(piece, points[i], points[j])]
    members: dict[tuple[Triangle, ...], list[Array]] = {}
    for piece in pieces:
        middle = piece.mean(axis=0)
        inside = tuple(t for t in triangles if edge_distances(points[list(t)], middle).min() > 0.0)
        members.setdefault(inside, []).append(piece)
    regions = [Region(inside, tuple(parts)) for inside, parts in members.items() if len(inside) > 1]
    return sorted(regions, key=lambda r: -r.area)


def _cut(polygon: Array, a: Array, b: Array) -> list[Array]:
    """The parts of a convex polygon left and right of the line through a and b; the polygon itself if it does not cut."""
    side = cross(b - a, polygon - a) / np.linalg.norm(b - a)
    tolerance = _ON_LINE
    if side.min() > -tolerance or side.max() < tolerance:
        return [polygon]
    left: list[Array] = []
    right: list[Array] = []
    for k, (p, s) in enumerate(zip(polygon, side, strict=True)):
        q, r = polygon[(k + 1) % len(polygon)], side[(k + 1) % len(polygon)]
        if s > -tolerance:
            left.append(p)
        if s < tolerance:
            right.append(p)
        if min(s, r) < -tolerance and max(s, r) > tolerance:
            crossing = p + s / (s - r) * (q - p)
            left.append(crossing)
            right.append(crossing)
    return [np.array(left), np.array(right)]


def triangle_margins(feet: ArrayLike, points: ArrayLike) -> dict[Triangle, Array]:
    """Signed distance (...) [m] of points (..., 2) to the border of each support triangle."""
    triangles, margins = _triangle_margins(checked_feet(feet), points)
    return {t: margins[..., k] for k, t in enumerate(triangles)}


def _triangle_margins(feet: Array, points: ArrayLike) -> tuple[list[Triangle], Array]:
    """Support triangles of feet (n, 2), and the distances (..., triangles) of points (..., 2)."""
    triangles = _support_triangles(feet)
    return triangles, _margins(feet[np.array(triangles)], np.asarray(points, float))


def region_margin(feet: ArrayLike, points: ArrayLike) -> Array:
    """How far (...) [m] points (..., 2) may move in any direction before the robot can change its support triangle.

    The smallest distance to an edge of the triangles the point is in: to the border of its region if that is convex. On an
    edge, as where two diagonals cross, it is 0. Negative outside the support polygon (the distance to it), as of :func:`margin`.
    """
    corners = checked_feet(feet)
    _, inside = _triangle_margins(corners, points)
    nearest = np.where(inside > -_ON_LINE, np.maximum(inside, 0.0), np.inf).min(axis=-1)
    outer = margin(corners[_hull(corners)], points)
    return np.asarray(np.where(outer > 0.0, np.minimum(nearest, outer), outer))
