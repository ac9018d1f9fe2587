"""The ends of what a robot's frames have along an obstacle.

Two parallel faces have no single pair of nearest points: which one a search finds jumps from end to end, and a row at one end lets a
solve turn the other end in. Frames near an obstacle are turned a little about their nearest point, to both sides: what is nearest then
are the ends of what the two have in common.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wbmpc.arrays import Array
from wbmpc.clearance.nearest import Finder, Nearest, Poses
from wbmpc.obstacles.shapes import DistanceGrid
from wbmpc.obstacles.world import Snapshot

Bools = NDArray[np.bool_]
#: By how much [rad] frames are turned: faces that lean more against each other have a nearest point that stays.
TILT = 0.05
#: Ends are sought up to so much [m] beyond the margin; one that is nearer [m] to the nearest point is the same.
WITHIN, APART = 0.1, 0.05
#: A nearest point between two ends, none of which is farther than this [m] beyond it, has no row.
SAME = 1e-3
#: Cosine of normals that count as parallel.
PARALLEL = 0.98


class _Ends(NamedTuple):
    """Of m pairs: ``point`` (m, 3) in the frame's axes, ``level`` (m) and ``gap`` (m) [m] along the normal of the nearest points, how far
    ``apart`` (m) [m] from these; not at all where there is no end."""

    point: Array
    level: Array
    gap: Array
    apart: Array

    def write(self, near: Nearest, at: tuple[NDArray[np.int64], ...], which: Bools, normal: Array) -> None:
        """Put those ``which`` (m) count, with ``normal`` (m, 3), into the entries ``at``."""
        to = tuple(index[which] for index in at)
        near.point[to], near.level[to], near.distance[to] = self.point[which], self.level[which], self.gap[which]
        near.normal[to] = normal[which]


def other_ends(
    finder: Finder, snapshot: Snapshot, poses: Poses, near: Nearest, margin: Array, frames: Bools
) -> Nearest:
    """By node, frame and obstacle the end that is farther from the nearest points, of ``frames`` (F) near an obstacle; infinitely far where
    there is none. Of nearest points between two ends the other end takes the place. ``margin`` (n, F, O) [m]."""
    out = Nearest.none(*near.distance.shape)
    solid = np.array([not isinstance(o.shape, DistanceGrid) for o in snapshot.obstacles], bool)
    at = np.nonzero((near.distance > 0.0) & (near.distance < margin + WITHIN) & frames[:, None] & solid)
    if not at[0].size:
        return out
    normal, nearest = near.normal[at], near.distance[at]
    one, two = (_turned(finder, snapshot, poses, near, at, sign * TILT) for sign in (1.0, -1.0))
    between = (np.minimum(one.apart, two.apart) > APART) & (np.maximum(one.gap, two.gap) < nearest + SAME)
    farther = one.apart > two.apart
    one.write(out, at, farther & (one.apart > APART), normal)
    two.write(out, at, ~farther & (two.apart > APART), normal)
    one.write(near, at, between & ~farther, normal)
    two.write(near, at, between & farther, normal)
    return out


def _turned(
    finder: Finder, snapshot: Snapshot, poses: Poses, near: Nearest, at: tuple[NDArray[np.int64], ...], angle: float
) -> _Ends:
    """What is nearest when each pair's frame is turned by ``angle`` [rad] about its nearest point, across its longest side that is along the
    obstacle."""
    (k, f, o), normal = at, near.normal[at]
    rotation, position = poses.rotation[k, f], poses.position[k, f]
    first = position + np.einsum("mij,mj->mi", rotation, near.point[at])
    aligned = np.einsum("mij,mi->mj", rotation, normal)  # of the frame's axes with the normal
    along = np.argmax(finder.geometry.lengths[f] * np.sqrt(np.clip(1.0 - aligned**2, 0.0, 1.0)), axis=1)
    about = np.cross(normal, np.take_along_axis(rotation, along[:, None, None], axis=2)[:, :, 0])
    about /= np.linalg.norm(about, axis=1)[:, None]
    moved = Poses(poses.times[k], poses.position[k].copy(), poses.rotation[k].copy())
    m = np.arange(len(k))
    moved.position[m, f] = first + _rotated(position - first, about, angle)
    for axis in range(3):
        moved.rotation[m, f, :, axis] = _rotated(rotation[:, :, axis], about, angle)
    limit = np.full((len(k), *near.distance.shape[1:]), -np.inf)
    limit[m, f, o] = finder.reach
    found = finder.find(snapshot, moved, limit)
    point = found.point[m, f, o]
    own = np.einsum("mij,mj->mi", rotation, point) + position
    there = moved.position[m, f] + np.einsum("mij,mj->mi", moved.rotation[m, f], point)
    other = there - found.distance[m, f, o, None] * found.normal[m, f, o]
    same = np.isfinite(found.distance[m, f, o]) & (np.sum(found.normal[m, f, o] * normal, axis=1) > PARALLEL)
    level = np.sum(normal * np.where(same[:, None], other, 0.0), axis=1)
    apart = np.where(same, np.linalg.norm(own - first, axis=1), 0.0)
    return _Ends(point, level, np.sum(normal * own, axis=1) - level, apart)


def _rotated(v: Array, about: Array, angle: float) -> Array:
    """Vectors (m, 3) turned by ``angle`` [rad] about unit vectors (m, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    along = np.sum(about * v, axis=1)[:, None]
    return np.asarray(c * v + s * np.cross(about, v) + (1.0 - c) * along * about)
