"""What happens between the nodes of a plan, and on which side of an obstacle its nodes are.

Nodes late in a horizon are far apart. Where a frame moves so far in one interval that it could come nearer to an obstacle than it is at
both ends, states in between are checked: what they lack is added to the margin at both ends. A node that is inside of an obstacle, or
behind it after a motion through it, keeps the normal of the node before, so that its row pulls the plan back to the side it came from.
What moves passes by: who keeps to the side in front of it has to run ahead of it for the rest of the plan. Nodes that it runs over are
pulled aside instead, out of its track, all to the side that takes less.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wbmpc.clearance.nearest import Finder, Nearest, Poses, turned
from wbmpc.obstacles.geometry import RobotGeometry
from wbmpc.obstacles.shapes import DistanceGrid, HalfSpace
from wbmpc.obstacles.world import Obstacle, Snapshot

Array = NDArray[np.float64]
#: Motion between two states that are checked [m], and how many between two nodes at most.
STEP, MOST = 0.08, 8
#: Frames that move less than this [m] in an interval are not checked between nodes: it is more than the margin lacks by.
SLOW = 0.02
#: What is slower than this [m/s] has no track.
CREEPS = 0.05


def motion(geometry: RobotGeometry, snapshot: Snapshot, poses: Poses) -> Array:
    """How far (N, F, O) [m] at most a point of each frame moves relative to each obstacle in each interval."""
    shift = np.linalg.norm(np.diff(poses.position, axis=0), axis=2)
    turn = turned(poses.rotation[:-1], poses.rotation[1:]) * geometry.extent
    own = np.array(
        [np.linalg.norm(np.diff(snapshot.pose(o, poses.times)[0], axis=0), axis=1) for o in snapshot.obstacles]
    )
    return np.asarray((shift + turn)[:, :, None] + own.T[:, None, :])


def between(finder: Finder, snapshot: Snapshot, poses: Poses, near: Nearest, states: Array, floor: float) -> Array:
    """Least distance (N, F, O) [m] at states between the nodes; infinite where it is not less than at the nodes. ``states`` (N + 1, nx)."""
    moved = motion(finder.geometry, snapshot, poses)
    ends = np.minimum(near.distance, finder.reach)
    possible = 0.5 * (ends[:-1] + ends[1:] - moved)
    flagged = (possible < floor) & (moved > SLOW) & (possible < np.minimum(ends[:-1], ends[1:]) - 0.5 * SLOW)
    least = np.full(moved.shape, np.inf)
    intervals = np.flatnonzero(flagged.any(axis=(1, 2)))
    if not intervals.size:
        return least
    most = np.where(flagged, moved, 0.0).max(axis=(1, 2))[intervals]
    counts = np.clip(np.ceil(most / STEP).astype(int) - 1, 1, MOST)
    which = np.repeat(intervals, counts)
    share = np.concatenate([np.arange(1, c + 1) / (c + 1.0) for c in counts])
    inner = (1.0 - share[:, None]) * states[which] + share[:, None] * states[which + 1]
    times = (1.0 - share) * poses.times[which] + share * poses.times[which + 1]
    limit = np.where(flagged, np.minimum(ends[:-1], ends[1:]), -np.inf)[which]
    found = finder.find(snapshot, Poses(times, *finder.kinematics(inner)), limit)
    np.minimum.at(least, which, found.distance)
    return least


def keep_sides(finder: Finder, snapshot: Snapshot, poses: Poses, near: Nearest, inner: Array) -> None:
    """Give nodes inside of or behind an obstacle the normal of the node before, in place."""
    through = np.zeros(near.distance.shape, bool)
    through[1:] = inner < 0.0
    suspect = ((near.distance < 0.0) | through).any(axis=0)
    for f, o in zip(*np.nonzero(suspect), strict=True):
        obstacle = snapshot.obstacles[o]
        if isinstance(obstacle.shape, HalfSpace):
            continue
        track = aside(snapshot, obstacle)
        if track is None:
            _keep_side(finder, snapshot, poses, near, through[:, f, o], int(f), int(o))
        else:
            _leave_track(finder, snapshot, poses, near, through[:, f, o], int(f), int(o), track)


def aside(snapshot: Snapshot, obstacle: Obstacle) -> Array | None:
    """A direction (3) across the track of an obstacle, along the floor; None of what stands or moves straight up or down."""
    places = snapshot.pose(obstacle, np.array([obstacle.seen, obstacle.seen + 1.0]))[0]
    v = places[1] - places[0]
    length = float(np.hypot(v[0], v[1]))
    return np.array([-v[1], v[0], 0.0]) / length if length > CREEPS else None


def _leave_track(
    finder: Finder, snapshot: Snapshot, poses: Poses, near: Nearest, through: NDArray[np.bool_], f: int, o: int,
    track: Array,
) -> None:  # fmt: skip
    """Give nodes in a row that an obstacle runs over the normal across its ``track`` (3) along which they are least deep in it."""
    obstacle = snapshot.obstacles[o]
    places, turn = snapshot.pose(obstacle, poses.times)
    distance, normal = near.distance[:, f, o], near.normal[:, f, o]
    met = (distance < 0.0) | through
    starts = np.flatnonzero(met & ~np.concatenate([[False], met[:-1]]))
    for start in starts.tolist():
        end = start + int(np.argmin(np.append(met[start:], False)))
        before = normal[max(start - 1, 0)]
        # a node that is touched and left to the side it was on is no matter of the track
        if not through[start:end].any() and (normal[start:end] @ before > 0.0).all():
            continue
        nodes = range(start, end)
        one, other = ([_gap(finder, obstacle, places[k], turn, poses, k, f, n) for k in nodes] for n in (track, -track))
        n, found = (track, one) if min(g[0] for g in one) >= min(g[0] for g in other) else (-track, other)
        for k, (gap, point, level) in zip(nodes, found, strict=True):
            near.normal[k, f, o], near.point[k, f, o], near.level[k, f, o] = n, point, level
            near.distance[k, f, o] = gap


def _gap(
    finder: Finder, obstacle: Obstacle, place: Array, turn: Array, poses: Poses, k: int, f: int, n: Array
) -> tuple[float, Array, float]:
    """Between a frame at a node and an obstacle along ``n`` (3): the gap [m], the frame's point (3) and the obstacle's level."""
    point, level = finder.along(obstacle, place, turn, poses, k, f, n)
    return float(n @ (poses.position[k, f] + poses.rotation[k, f] @ point)) - level, point, level


def _keep_side(
    finder: Finder, snapshot: Snapshot, poses: Poses, near: Nearest, through: NDArray[np.bool_], f: int, o: int
) -> None:
    obstacle, held, n = snapshot.obstacles[o], False, np.zeros(3)
    places, turn = snapshot.pose(obstacle, poses.times)
    point, level = np.zeros(3), 0.0
    for k in range(len(poses.times)):
        d, own = float(near.distance[k, f, o]), near.normal[k, f, o]
        if n.any() and (through[k] or d < 0.0) and own @ n <= 0.0:
            held = True
        if held and own @ n > 0.0 and d > 0.0:
            held = False
        if held:
            if not isinstance(obstacle.shape, DistanceGrid):
                point, level = finder.along(obstacle, places[k], turn, poses, k, f, n)
            near.normal[k, f, o], near.point[k, f, o], near.level[k, f, o] = n, point, level
            at = poses.position[k, f] + poses.rotation[k, f] @ point
            near.distance[k, f, o] = min(float(n @ at) - level, d)
        elif np.isfinite(d):
            n, point, level = own.copy(), near.point[k, f, o].copy(), float(near.level[k, f, o])
