"""Support polygon and point of pressure of contacts with a floor."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array


def hull(points: Array) -> Array:
    """Corners (k, 2) of the convex hull of points (n, 2), counter-clockwise (Andrew's monotone chain)."""
    ordered = np.unique(points, axis=0)
    if len(ordered) < 3:
        return ordered
    halves = []
    for side in (ordered, ordered[::-1]):
        chain: list[Array] = []
        for p in side:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], p) <= 0.0:
                chain.pop()
            chain.append(p)
        halves += chain[:-1]
    return np.array(halves)


def _turn(a: Array, b: Array, c: Array) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def pressure_point(points: Array, forces: Array) -> Array:
    """Where vertical forces (n) [N] at points (n, 3) act together (3); nan without any."""
    total = float(forces.sum())
    return (forces @ points) / total if total > 0.0 else np.full(3, np.nan)


def active_triangle(points: Array, forces: Array) -> Array:
    """Corners (3, 2), counter-clockwise, of the three points (n, 2) that carry most of the vertical forces (n) [N].

    A rigid base on more than three feet rests on one of their triangles (Pankert et al. 2022, section III): the feet that
    it rests on press harder than the others. Nothing (0, 2) for fewer than three points, or three on a line.
    """
    corners = hull(points[np.argsort(forces)[-3:]])
    return corners if len(corners) == 3 else np.zeros((0, 2))


def margin(corners: Array, point: Array) -> float:
    """Distance [m] from a point (2) to the nearest edge of a polygon (k, 2); negative outside; 0 without an area."""
    if len(corners) < 3 or not np.isfinite(point).all():
        return 0.0
    edges = np.roll(corners, -1, axis=0) - corners
    inward = np.stack([-edges[:, 1], edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1)[:, None]
    return float(np.min(np.sum(inward * (point - corners), axis=1)))
