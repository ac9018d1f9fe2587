"""What happens between the nodes of a plan, and on which side of an obstacle its nodes are.

Nodes late in a horizon are far apart. Where a frame moves so far in one interval that it could come nearer to an obstacle than it is at
both ends, states in between are checked: what they lack is added to the margin at both ends. A node that is inside of an obstacle, or
behind it after a motion through it, keeps the normal of the node before, so that its row pulls the plan back to the side it came from.
What moves passes by: who keeps to the side in front of it has to run ahead of it for the rest of the plan. Nodes that it runs over are
pulled aside instead, out of its track, all to the side that takes less; so are the last ones of a plan that ends right ahead of it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wbmpc.arrays import Array
from wbmpc.clearance.nearest import Finder, Nearest, Poses, turned
from wbmpc.obstacles.geometry import RobotGeometry
from wbmpc.obstacles.shapes import DistanceGrid, HalfSpace
from wbmpc.obstacles.world import Obstacle, Snapshot

#: Motion between two states that are checked [m], and how many between two nodes at most.
STEP, MAX_CHECKS = 0.08, 8
#: Frames that move less than this [m] in an interval are not checked between nodes: it is more than the margin lacks by.
SLOW = 0.02
#: What is slower than this [m/s] has no track.
CREEPS = 0.05
#: Right ahead of what moves: within this cosine of its direction, and no more than this [m] beyond the margin. Of a plan that ends there,
#: nodes in this last share of the horizon leave the track: earlier ones may have no time to.
AHEAD, PUSHED, LAST = 0.7, 0.05, 0.25


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
    minimum = np.full(moved.shape, np.inf)
    intervals = np.flatnonzero(flagged.any(axis=(1, 2)))
    if not intervals.size:
        return minimum
    maximum = np.where(flagged, moved, 0.0).max(axis=(1, 2))[intervals]
    counts = np.clip(np.ceil(maximum / STEP).astype(int) - 1, 1, MAX_CHECKS)
    which = np.repeat(intervals, counts)
    share = np.concatenate([np.arange(1, c + 1) / (c + 1.0) for c in counts])
    inner = (1.0 - share[:, None]) * states[which] + share[:, None] * states[which + 1]
    times = (1.0 - share) * poses.times[which] + share * poses.times[which + 1]
    limit = np.where(flagged, np.minimum(ends[:-1], ends[1:]), -np.inf)[which]
    found = finder.find(snapshot, Poses(times, *finder.kinematics(inner)), limit)
    np.minimum.at(minimum, which, found.distance)
    return minimum


def keep_sides(finder: Finder, snapshot: Snapshot, poses: Poses, near: Nearest, inner: Array, margin: Array) -> None:
    """Give nodes inside of or behind an obstacle, or pushed ahead by one, another normal, in place; ``margin`` (n, F, O) [m]."""
    through = np.zeros(near.distance.shape, bool)
    through[1:] = inner < 0.0
    suspect: NDArray[np.bool_] = np.any((near.distance < 0.0) | through, axis=0)
    for o, obstacle in enumerate(snapshot.obstacles):
        if isinstance(obstacle.shape, HalfSpace):
            continue
        track, frames = aside(snapshot, obstacle), np.flatnonzero(suspect[:, o]).tolist()
        if track is not None and not isinstance(obstacle.shape, DistanceGrid):
            _leave_track(finder, snapshot, poses, near, margin, through[:, :, o], frames, o, track)
            continue
        for f in frames:
            _keep_side(finder, snapshot, poses, near, through[:, f, o], f, o)


def aside(snapshot: Snapshot, obstacle: Obstacle) -> Array | None:
    """A direction (3) across the track of an obstacle, along the floor; None of what stands or moves straight up or down."""
    places = snapshot.pose(obstacle, np.array([obstacle.seen, obstacle.seen + 1.0]))[0]
    v = places[1] - places[0]
    length = float(np.hypot(v[0], v[1]))
    return np.array([-v[1], v[0], 0.0]) / length if length > CREEPS else None


def _leave_track(
    finder: Finder, snapshot: Snapshot, poses: Poses, near: Nearest, margin: Array, through: NDArray[np.bool_],
    frames: list[int], o: int, track: Array,
) -> None:  # fmt: skip
    """Give nodes of ``frames`` that an obstacle runs over, and nodes that it pushes ahead, a normal across its ``track`` (3): for all of them
    the one along which the deepest is least deep. Frames that gave way to different sides would hold each other in the track."""
    pushed = _pushed(near.distance[:, :, o] - margin[:, :, o], near.normal[:, :, o], poses.times, track)
    found = {(k, f) for f in frames for k in _run_over(near.distance[:, f, o], near.normal[:, f, o], through[:, f])}
    met = sorted(found | {(k, f) for k, f in np.argwhere(pushed).tolist()})
    if not met:
        return
    obstacle = snapshot.obstacles[o]
    places, turn = snapshot.pose(obstacle, poses.times)
    sides = [[(n, *_gap(finder, obstacle, places[k], turn, poses, k, f, n)) for k, f in met] for n in (track, -track)]
    chosen = max(sides, key=lambda side: min(gap for _, gap, _, _ in side))
    for (k, f), (n, gap, point, level) in zip(met, chosen, strict=True):
        near.normal[k, f, o], near.point[k, f, o], near.level[k, f, o], near.distance[k, f, o] = n, point, level, gap


def _pushed(excess: Array, normal: Array, times: Array, track: Array) -> NDArray[np.bool_]:
    """Nodes (n, F) of frames that are right ahead of what moves across ``track`` (3), as they are up to the end of the plan, in the last part
    of the horizon. ``excess`` (n, F) [m]: beyond the margin; ``normal`` (n, F, 3)."""
    onwards = np.array([track[1], -track[0], 0.0])
    ahead = (excess < PUSHED) & (normal @ onwards > AHEAD)
    late = times >= times[-1] - LAST * (times[-1] - times[0])
    ahead[:, ~ahead[-1]] = False
    return np.asarray(ahead & late[:, None])


def _run_over(distance: Array, normal: Array, through: NDArray[np.bool_]) -> list[int]:
    """Nodes of a frame, at ``distance`` (n) [m] along ``normal`` (n, 3), that an obstacle runs over: those in a row of which one changes
    sides. A node that is touched and left to the side it was on is no matter of the track."""
    met = (distance < 0.0) | through
    nodes: list[int] = []
    for start in np.flatnonzero(met & ~np.concatenate([[False], met[:-1]])).tolist():
        end = start + int(np.argmin(np.append(met[start:], False)))
        if through[start:end].any() or (normal[start:end] @ normal[max(start - 1, 0)] <= 0.0).any():
            nodes += range(start, end)
    return nodes


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
