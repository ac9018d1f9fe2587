"""Nearest points of a robot's frames and of obstacles, at many states at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from wbmpc.arrays import Array
from wbmpc.clearance import grid_step
from wbmpc.clearance.table import SolidTable
from wbmpc.errors import unknown_name
from wbmpc.kernel.function import CompiledFunction
from wbmpc.model.robot import RobotModel
from wbmpc.model.tree import Frame
from wbmpc.obstacles.geometry import RobotGeometry, frame_function, split_poses
from wbmpc.obstacles.shapes import DistanceGrid, HalfSpace
from wbmpc.obstacles.solids import Solid
from wbmpc.obstacles.world import Obstacle, Snapshot


class CompiledKinematics:
    """As :class:`wbmpc.obstacles.geometry.Kinematics`: positions (n, F, 3) [m] and rotations (n, F, 3, 3), contiguous ones."""

    def __init__(self, robot: RobotModel, frames: Sequence[Frame]) -> None:
        self._size = robot.state.size
        self._function = CompiledFunction(frame_function(robot, frames))

    def __call__(self, states: Array) -> tuple[Array, Array]:
        """Of states (n, nx or more: what a problem adds comes after the robot's own)."""
        return split_poses(self._function(np.atleast_2d(states)[:, : self._size]))


#: Nearest points of a frame and a distance grid, in different directions.
SIDES = 2


@dataclass
class Nearest:
    """By node, frame and obstacle: ``distance`` (n, F, O) [m], infinite beyond the reach; ``normal`` (n, F, O, 3) from the obstacle to
    the robot; ``point`` (n, F, O, 3), the robot's nearest point in the frame's axes; ``level`` (n, F, O): normal · obstacle's point."""

    distance: Array
    normal: Array
    point: Array
    level: Array

    @classmethod
    def none(cls, n: int, frames: int, obstacles: int) -> Nearest:
        shape = (n, frames, obstacles)
        return cls(np.full(shape, np.inf), np.zeros((*shape, 3)), np.zeros((*shape, 3)), np.zeros(shape))


@dataclass(frozen=True)
class Poses:
    """Of the robot's frames at ``times`` (n) [s]: ``position`` (n, F, 3), ``rotation`` (n, F, 3, 3)."""

    times: Array
    position: Array
    rotation: Array


class Finder:
    """Nearest points between one robot and any obstacles. ``reach`` [m]: what is farther away is not checked; ``pairs``: how many pairs
    of solids the last call compared one by one, the others were too far by their bounding spheres; ``deep``: whether it measures how deep
    convex solids overlap (else their distance is 0)."""

    def __init__(self, geometry: RobotGeometry, reach: float, deep: bool = True) -> None:
        self.geometry, self.reach, self.pairs, self.deep = geometry, reach, 0, deep
        self._table = SolidTable(geometry)
        #: poses of the geometry's frames
        self.kinematics = CompiledKinematics(geometry.robot, [geometry.robot.tree.frames[f] for f in geometry.frames])

    def find(self, snapshot: Snapshot, poses: Poses, limit: Array | None = None) -> Nearest:
        """``limit`` (n, F, O) [m]: distances that are not smaller are of no interest; the reach where it is left out."""
        n, obstacles = len(poses.times), snapshot.obstacles
        out = Nearest.none(n, len(self.geometry.frames), len(obstacles))
        self.pairs = 0
        if not obstacles or not n:
            return out
        below = np.full(out.distance.shape, self.reach) if limit is None else np.array(limit, order="C")
        for o, obstacle in enumerate(obstacles):
            below[:, self._indices(obstacle), o] = -np.inf
        solids: list[tuple[int, Solid, Array, Array]] = []  # obstacle, solid, centers (n, 3), axes (3, 3)
        for o, obstacle in enumerate(obstacles):
            place, turn = snapshot.pose(obstacle, poses.times)
            if isinstance(obstacle.shape, HalfSpace):
                self._half_space(obstacle.shape, place, turn, poses, below[:, :, o], out, o)
            elif isinstance(obstacle.shape, DistanceGrid):
                if obstacle.side == 0:  # with all its sides, which follow
                    which = slice(o, o + sum(other.name == obstacle.name for other in obstacles))
                    self._grid(obstacle.shape, place, turn, poses, below[:, :, which], out, which)
            else:
                solid = obstacle.shape.solid
                solids.append((o, solid, place + turn @ solid.position, turn @ solid.rotation))
        if solids:
            self._solids(solids, poses, below, out)
        return out

    def _indices(self, obstacle: Obstacle) -> list[int]:
        for name in obstacle.ignore:
            if name not in self.geometry.frames:
                where = f"obstacle '{obstacle.name}', ignore"
                raise unknown_name("frame with shapes", name, self.geometry.frames, where=where)
        return [self.geometry.frames.index(name) for name in obstacle.ignore]

    # ------------------------------------------------------------------ convex solids
    def _solids(
        self, solids: Sequence[tuple[int, Solid, Array, Array]], poses: Poses, below: Array, out: Nearest
    ) -> None:
        which = [s[0] for s in solids]
        found = self._table.nearest(
            poses.position, poses.rotation, [s[1] for s in solids], np.stack([s[2] for s in solids], axis=1),
            np.array([s[3] for s in solids]), below[:, :, which], self.deep,
        )  # fmt: skip
        self.pairs = found.compared
        there = found.distance < below[:, :, which]
        k, f, i = np.nonzero(there)
        o = np.array(which)[i]
        n, p, q = found.normal[k, f, i], found.own[k, f, i], found.other[k, f, i]
        out.distance[k, f, o], out.normal[k, f, o], out.level[k, f, o] = (
            found.distance[k, f, i], n, np.sum(n * q, axis=1),
        )  # fmt: skip
        out.point[k, f, o] = np.einsum("mi,mij->mj", p - poses.position[k, f], poses.rotation[k, f])

    def along(
        self, obstacle: Obstacle, place: Array, turn: Array, poses: Poses, k: int, f: int, n: Array
    ) -> tuple[Array, float]:
        """The robot's point (3, in the frame's axes) and the obstacle's level along a normal ``n`` (3) that is kept: the gap between two
        planes."""
        assert not isinstance(obstacle.shape, (HalfSpace, DistanceGrid))
        solid = obstacle.shape.solid
        axes = turn @ solid.rotation
        level = float(n @ (place + turn @ solid.position) + solid.support((n @ axes)[None])[0] @ (n @ axes))
        down = -n @ poses.rotation[k, f]
        ends = []
        for s in np.flatnonzero(self.geometry.frame_of == f):
            own = self.geometry.shapes[s].solid
            ends.append(own.position + own.rotation @ own.support((down @ own.rotation)[None])[0])
        return max(ends, key=lambda p: float(p @ down)), level

    # ------------------------------------------------------------------ half-spaces and grids
    def _half_space(
        self, shape: HalfSpace, place: Array, turn: Array, poses: Poses, below: Array, out: Nearest, o: int
    ) -> None:
        n = turn @ np.asarray(shape.normal, float)
        level = place @ n + shape.offset
        for s, part in enumerate(self.geometry.shapes):
            f, own = int(self.geometry.frame_of[s]), part.solid
            down = -np.einsum("nij,i->nj", poses.rotation[:, f], n)
            point = own.position + own.support(down @ own.rotation) @ own.rotation.T
            distance = poses.position[:, f] @ n - np.sum(point * down, axis=1) - level
            better = distance < np.minimum(out.distance[:, f, o], below[:, f])
            out.distance[better, f, o], out.normal[better, f, o] = distance[better], n
            out.point[better, f, o], out.level[better, f, o] = point[better], level[better]

    def _grid(
        self, shape: DistanceGrid, place: Array, turn: Array, poses: Poses, below: Array, out: Nearest, which: slice
    ) -> None:
        (frame, local, radius), (n, frames, sides) = self.geometry.spheres, below.shape
        # the grid stays where it is at first; what it meets moves
        moved = place - place[0]
        position = poses.position - moved[:, None]
        values, ball = np.asarray(shape.values), np.full(below.shape, -1)
        error, center = float(shape.error or 0.0), np.empty((n, len(frame), 3))
        distance, normal = np.ascontiguousarray(below + error), np.zeros((*below.shape, 3))
        origin = place[0] + turn @ np.asarray(shape.origin, float)
        flat = lambda *arrays: [np.ascontiguousarray(a).reshape(-1) for a in arrays]
        balls = grid_step.Balls(*flat(frame, local, radius))
        cells = (*values.shape, float(shape.cell), float(shape.layer or shape.cell))
        nearest: Any = grid_step.nearest
        nearest(
            n, frames, len(frame), sides, balls, *flat(position, poses.rotation), grid_step.Grid(*cells, *flat(values, origin, turn)),
            grid_step.Sides(*(a.reshape(-1) for a in (distance, normal, ball, center))),
        )  # fmt: skip
        k, f, s = np.nonzero(ball >= 0)
        b, o = ball[k, f, s], which.start + s
        found, normals = distance[k, f, s] - error, normal[k, f, s]
        points = center[k, b] - radius[b, None] * normals
        out.distance[k, f, o], out.normal[k, f, o] = found, normals
        out.point[k, f, o] = np.einsum("mi,mij->mj", points - position[k, f], poses.rotation[k, f])
        out.level[k, f, o] = np.sum(normals * (points + moved[k]), axis=1) - found


def with_sides(snapshot: Snapshot) -> Snapshot:
    """The same obstacles with an entry for each of the :data:`SIDES` of a distance grid, so that rows know several of its nearest points."""
    each = [replace(o, side=s) for o in snapshot.obstacles for s in range(_sides(o))]
    return Snapshot(tuple(each), snapshot.frames)


def _sides(obstacle: Obstacle) -> int:
    return SIDES if isinstance(obstacle.shape, DistanceGrid) else 1


def turned(a: Array, b: Array) -> Array:
    """Angles (...) [rad] between rotations (..., 3, 3)."""
    trace = np.einsum("...ij,...ij->...", a, b)
    return np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))
