"""Parameters of clearance rows at every node of a plan: normals, nearest points and offsets.

A row is h = nᵀ(p(x) + R(x) r) − c of a frame at p, R; n (3) is the normal at the nearest points of the predicted states, r (3) the
robot's nearest point in the frame's axes, c the obstacle's level along n with all margins. Value and gradient are then those of the
distance at the prediction, exactly. Rows without an obstacle are zeros, for which h = 1: far inside.

The ends of what a robot's frames have along an obstacle.

Two parallel faces have no single pair of nearest points: which one a search finds jumps from end to end, and a row at one end lets a
solve turn the other end in. Frames near an obstacle are turned a little about their nearest point, to both sides: what is nearest then
are the ends of what the two have in common.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wbmpc.arrays import Array
from wbmpc.clearance.nearest import Finder, Nearest, Poses
from wbmpc.clearance.own_pairs import OwnPairs
from wbmpc.clearance.sweep import between, keep_sides
from wbmpc.obstacles.geometry import robot_geometry
from wbmpc.obstacles.shapes import DistanceGrid
from wbmpc.obstacles.world import Snapshot
from wbmpc.ocp.clearance_residuals import WIDTH
from wbmpc.ocp.clearance_residuals import Clearance as ObstacleTerm
from wbmpc.ocp.clearance_residuals import SelfClearance as SelfTerm

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


Ints = NDArray[np.int64]
#: Obstacles farther than this [m] beyond the margin have no rows.
REACH = 0.5
#: Parts of the robot farther from each other than this [m] have none.
SELF_REACH = 0.25
#: Plans with less than this [m] beyond their margins are measured exactly, others by the rows of their solve.
EXACT = 0.1
#: Standard deviations by which a margin grows.
SIGMAS = 2.0


@dataclass(frozen=True)
class Clearance:
    """The least distance of a plan to what it keeps clear of: ``distance`` [m] (negative inside), between the robot's ``frame`` and
    ``other`` (an obstacle or another frame), at ``node`` and ``time`` [s]; ``margin`` [m] that was asked for there. Infinite where nothing
    is near."""

    distance: float = np.inf
    margin: float = 0.0
    frame: str = ""
    other: str = ""
    node: int = -1
    time: float = np.nan

    @property
    def excess(self) -> float:
        """Distance beyond the margin [m]; negative: what it lacks."""
        return self.distance - self.margin

    def __str__(self) -> str:
        if not self.frame:
            return "nothing near"
        return f"{1e3 * self.distance:.0f} mm between '{self.frame}' and '{self.other}' at {self.time:.2f} s (node {self.node})"


class ObstacleRows:
    """Rows of some frames of a robot with the nearest obstacles of each."""

    def __init__(self, term: ObstacleTerm) -> None:
        self.geometry = geometry = robot_geometry(term.robot)
        self.slots, self.margin = int(term.slots), float(term.margin or 0.0)
        self.counts = np.array(term.counts)
        self.finder = Finder(geometry, REACH + self.margin)
        self.index = [geometry.frames.index(f) for f in term.frames or ()]
        self._asked = np.zeros(len(geometry.frames), bool)
        self._asked[self.index] = True
        self._long = np.zeros(len(geometry.frames), bool)
        self._long[self.index] = self.counts > self.slots
        self._near: Nearest | None = None

    @property
    def size(self) -> int:
        """Rows at a node."""
        return int(self.counts.sum())

    def refresh(self, snapshot: Snapshot, times: Array, states: Array) -> Array:
        """Parameters (n, size · :data:`WIDTH`) at ``times`` (n) [s] for predicted ``states`` (n, nx)."""
        poses = Poses(times, *self.finder.kinematics(states))
        near, margin = self.measure(snapshot, poses)
        second = near
        if snapshot.obstacles:
            second = other_ends(self.finder, snapshot, poses, near, margin, self._long)
            before = near.normal.copy()
            inner = between(self.finder, snapshot, poses, near, states, float(margin.max()))
            ends = np.minimum(near.distance[:-1], near.distance[1:])
            # a motion through an obstacle is the side's matter
            lack = np.where(np.isfinite(inner) & (inner >= 0.0), np.minimum(ends, self.finder.reach) - inner, 0.0)
            keep_sides(self.finder, snapshot, poses, near, inner, margin)
            second.distance[(near.normal != before).any(axis=3)] = np.inf
            none = np.zeros((1, *lack.shape[1:]))
            margin += np.maximum(np.concatenate([lack, none]), np.concatenate([none, lack]))
        self._near = near
        return self._fill(near, second, margin)

    def base_margin(self, snapshot: Snapshot, poses: Poses) -> Array:
        """Margins (n, F, O) [m]: what is asked for and the obstacles' spread."""
        spread = np.array([SIGMAS * o.spread(poses.times) for o in snapshot.obstacles]).reshape(-1, len(poses.times))
        return np.broadcast_to(
            self.margin + spread.T[:, None, :], (len(poses.times), len(self.geometry.frames), len(spread))
        ).copy()

    def measure(self, snapshot: Snapshot, poses: Poses) -> tuple[Nearest, Array]:
        """Nearest points at poses, and the margins (n, F, O) [m] there."""
        shape = (len(poses.times), len(self.geometry.frames), len(snapshot.obstacles))
        limit = np.broadcast_to(np.where(self._asked, self.finder.reach, -np.inf)[None, :, None], shape)
        return self.finder.find(snapshot, poses, limit), self.base_margin(snapshot, poses)

    def _fill(self, near: Nearest, second: Nearest, margin: Array) -> Array:
        out = np.zeros((len(near.distance), self.size, WIDTH))
        count = min(self.slots, near.distance.shape[2])
        excess = (near.distance - margin)[:, self.index]
        chosen = np.sort(np.argsort(excess, axis=2, kind="stable")[..., :count], axis=2)
        start, long = np.cumsum(self.counts) - self.counts, self._long[self.index]
        slots = np.arange(count)
        out[:, start[:, None] + slots] = _entries(near, margin, np.array(self.index), chosen)
        if long.any():  # other ends of the same obstacles
            at = start[long][:, None] + self.slots + slots
            out[:, at] = _entries(second, margin, np.array(self.index)[long], chosen[:, long])
        return out.reshape(len(out), -1)

    def clearance(self, snapshot: Snapshot, times: Array, states: Array) -> Clearance:
        """The least excess over its margins of the plan that a solve made of what :meth:`refresh` set."""
        poses, near = Poses(times, *self.finder.kinematics(states)), self._near
        if near is None or near.distance.shape[0] != len(times) or not np.isfinite(near.distance).any():
            return Clearance()
        at = poses.position[:, :, None] + near.point @ np.swapaxes(poses.rotation, 2, 3)
        gap = np.where(np.isfinite(near.distance), np.sum(near.normal * at, axis=3) - near.level, np.inf)
        margin = self.base_margin(snapshot, poses)
        minimum = float((gap - margin).min())
        if minimum < EXACT:
            limit = np.where(
                self._asked[:, None], np.minimum(margin + minimum + 0.5 * EXACT, self.finder.reach), -np.inf
            )
            gap = np.fmin(
                self.finder.find(snapshot, poses, limit).distance, np.where(gap - margin > minimum, np.inf, gap)
            )
        return self._minimum(snapshot, times, gap, margin)

    def deepest(self, snapshot: Snapshot, times: Array, states: Array, limit: float, deeper: float) -> Clearance | None:
        """Where states (n, nx) come nearer to an obstacle than ``limit`` [m], and by ``deeper`` [m] nearer than at the first one; None:
        nowhere."""
        poses = Poses(times, *self.finder.kinematics(states))
        shape = (len(times), len(self.geometry.frames), len(snapshot.obstacles))
        asked = np.broadcast_to(np.where(self._asked, limit, -np.inf)[None, :, None], shape)
        found = self.finder.find(snapshot, poses, asked).distance
        found = np.where(found < found[:1] - deeper, found, np.inf)
        return (
            self._minimum(snapshot, times, found, self.base_margin(snapshot, poses))
            if np.isfinite(found).any()
            else None
        )

    def _minimum(self, snapshot: Snapshot, times: Array, distance: Array, margin: Array) -> Clearance:
        k, f, o = np.unravel_index(int(np.argmin(distance - margin)), distance.shape)
        return Clearance(
            float(distance[k, f, o]), float(margin[k, f, o]), self.geometry.frames[f], snapshot.obstacles[o].name, int(k),
            float(times[k]),
        )  # fmt: skip


def _entries(near: Nearest, margin: Array, frames: Ints, chosen: Ints) -> Array:
    """Parameters (n, f, k, :data:`WIDTH`) of ``frames`` (f) and the ``chosen`` obstacles (n, f, k) of each."""
    take = lambda a: np.take_along_axis(a[:, frames], chosen if a.ndim == 3 else chosen[..., None], axis=2)
    there, out = np.isfinite(take(near.distance)), np.zeros((*chosen.shape, WIDTH))
    out[..., :3] = np.where(there[..., None], take(near.normal), 0.0)
    out[..., 3:6] = np.where(there[..., None], take(near.point), 0.0)
    out[..., 6] = np.where(there, take(near.level) + take(margin), 0.0)
    return out


class SelfRows:
    """Rows of pairs of a robot's frames: the nearest points of their shapes."""

    def __init__(self, term: SelfTerm) -> None:
        self.geometry = geometry = robot_geometry(term.robot)
        #: of each pair [m]
        self.margins = np.array(term.margins)
        self.pairs = [(geometry.frames.index(a), geometry.frames.index(b)) for a, b in term.pairs or ()]
        #: their nearest points
        self.own = OwnPairs(geometry, self.pairs, SELF_REACH + float(self.margins.max()), self.margins)
        self._states = geometry.robot.home[None].copy()
        self.own.measure(self._states)

    @property
    def size(self) -> int:
        """Rows at a node."""
        return len(self.pairs)

    def measure(self, states: Array) -> Array:
        """Distances (n, pairs) [m] at states (n, nx), infinite out of reach, until the next call. They are kept: a plan is asked for before
        and after its solve, each time for several things."""
        if not np.array_equal(states, self._states):
            self._states = states.copy()
            self.own.measure(states)
        return self.own.distance

    def refresh(self, states: Array) -> Array:
        """Parameters (n, size · :data:`~wbmpc.ocp.clearance_residuals.SELF_WIDTH`) for predicted ``states`` (n, nx)."""
        self.measure(states)
        return self.own.parameters.copy()

    def clearance(self, times: Array, states: Array) -> Clearance:
        """The least distance of a plan, states (n, nx) at ``times`` (n) [s]."""
        return self._minimum(times, self.measure(states))

    def deepest(self, times: Array, states: Array, count: int, share: float, deeper: float) -> Clearance | None:
        """Where the first ``count`` of states (n, nx) bring a pair nearer than ``share`` of its margin, and by ``deeper`` [m] nearer than the
        first one; None: nowhere."""
        found = self.measure(states)[:count]
        found = np.where((found < share * self.margins) & (found < found[:1] - deeper), found, np.inf)
        return self._minimum(times, found) if np.isfinite(found).any() else None

    def _minimum(self, times: Array, distance: Array) -> Clearance:
        if not np.isfinite(distance).any():
            return Clearance()
        k, row = np.unravel_index(int(np.argmin(distance - self.margins)), distance.shape)
        a, b = (self.geometry.frames[f] for f in self.pairs[row])
        return Clearance(float(distance[k, row]), float(self.margins[row]), a, b, int(k), float(times[k]))
