"""A planner of routes for the base: A* over a lattice of places and headings, with the whole robot's shapes at home as footprint.

Places are a square grid, headings the sixteen directions between points of it that are at most two cells apart, so that straight moves
go from place to place exactly (Pivtoraiko, Knepper, Kelly 2009, "Differentially constrained mobile robot motion planning in state
lattices", J. Field Robotics 26(3)). Moves are forwards, backwards and turns in place. What stands there is measured by the compiled
nearest points that clearance rows have; edges are checked closely only when they are part of a route.
"""

from __future__ import annotations

import itertools
from heapq import heappop, heappush

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc import checks
from wbmpc.arrays import Array
from wbmpc.clearance.nearest import Finder, Poses
from wbmpc.errors import InputError, NoRoute
from wbmpc.model.robot import RobotModel
from wbmpc.obstacles.geometry import robot_geometry
from wbmpc.obstacles.world import Obstacles, Snapshot

Node = tuple[int, int, int]
_QUARTER = np.array([(1, 0), (2, 1), (1, 1), (1, 2)])
_TURNED = _QUARTER[:, ::-1] * [-1, 1]
#: Moves (dx, dy) [cells] of the sixteen headings, in their order, and the headings [rad].
MOVES = np.concatenate([_QUARTER, _TURNED, -_QUARTER, -_TURNED])
HEADINGS = np.unwrap(np.arctan2(MOVES[:, 1], MOVES[:, 0]))
#: What a way backwards costs against one forwards; what a turn costs [m/rad].
BACKWARDS, TURN = 2.0, 0.35
#: Between two poses that are checked: way [m], turn [rad].
CLOSE, CLOSE_TURN = 0.03, 0.06
#: How far [m] around start and goal a route may lead; states measured at once; searches at most.
AROUND, AT_ONCE, SEARCHES = 3.0, 2000, 200
#: Places and headings at most.
MAX_STATES = 4_000_000


class Footprint:
    """Whether the robot, at home or in another ``shape`` (nx), is clear of obstacles by more than ``margin`` [m] with its base at given
    poses."""

    def __init__(
        self, robot: RobotModel, snapshot: Snapshot, margin: float, t: float, shape: Array | None = None
    ) -> None:
        self._shape, self._snapshot, self._t = robot.home if shape is None else shape, snapshot, t
        geometry = robot_geometry(robot)
        self._finder = Finder(geometry, margin, deep=False)
        start = robot.state["base"].start
        self._part = slice(start, start + 3)
        centers = geometry.at(*geometry.kinematics(self._shape[None]))[0][0]
        beside = np.linalg.norm(centers[:, :2] - self._shape[start : start + 2], axis=1)
        #: within which [m] of the base's place the robot turns
        self.radius = float((beside + geometry.radius).max())

    def clear(self, poses: Array) -> NDArray[np.bool_]:
        """(n) of base poses (n, 3)."""
        return np.concatenate(
            [self._clear(poses[k : k + AT_ONCE]) for k in range(0, len(poses), AT_ONCE)] or [np.ones(0, bool)]
        )

    def _clear(self, poses: Array) -> NDArray[np.bool_]:
        states = np.tile(self._shape, (len(poses), 1))
        states[:, self._part] = poses
        near = self._finder.find(self._snapshot, Poses(np.full(len(poses), self._t), *self._finder.kinematics(states)))
        return np.asarray(~np.isfinite(near.distance).any(axis=(1, 2)))


def between(a: Array, b: Array) -> Array:
    """Poses (n, 3) from ``a`` (3) to ``b`` (3), both with them, that lie close to each other."""
    way = float(np.linalg.norm(b[:2] - a[:2]))
    count = int(np.ceil(max(way / CLOSE, abs(b[2] - a[2]) / CLOSE_TURN, 1.0)))
    return np.linspace(a, b, count + 1)


class _Lattice:
    """Places and headings in axes in which the start is the origin; free ones by :class:`Footprint`."""

    def __init__(self, start: Array, low: Array, high: Array, cell: float, footprint: Footprint) -> None:
        c, s = np.cos(start[2]), np.sin(start[2])
        self._start, self._turn, self.cell = start, np.array([[c, -s], [s, c]]), cell
        corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
        inside = (corners - start[:2]) @ self._turn / cell
        self.low, self.high = np.floor(inside.min(axis=0)).astype(int), np.ceil(inside.max(axis=0)).astype(int)
        nx, ny = self.high - self.low + 1
        if nx * ny * len(MOVES) > MAX_STATES:
            raise InputError(f"route: {nx} by {ny} cells are too many; valid: a larger 'cell', narrower 'bounds'")
        ij = np.stack(np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"), axis=-1).reshape(-1, 2) + self.low
        places = self.place(ij)
        inside_bounds = ((places >= low - 1e-9) & (places <= high + 1e-9)).all(axis=1)
        free = np.zeros((len(ij), len(MOVES)), bool)
        for h, heading in enumerate(HEADINGS):
            poses = np.column_stack([places, np.full(len(places), start[2] + heading)])
            free[inside_bounds, h] = footprint.clear(poses[inside_bounds])
        self._free = free.reshape(nx, ny, len(MOVES))
        self.blocked: set[tuple[Node, Node]] = set()

    def place(self, ij: Array) -> Array:
        """Places (n, 2) [m] of cells (n, 2)."""
        return np.asarray(self._start[:2] + self.cell * ij @ self._turn.T)

    def pose(self, node: Node) -> Array:
        return np.array([*self.place(np.array(node[:2])), self._start[2] + HEADINGS[node[2]]])

    def near(self, pose: Array) -> Node:
        """The node nearest to a pose (3)."""
        i, j = np.round((pose[:2] - self._start[:2]) @ self._turn / self.cell).astype(int)
        off = np.abs(np.angle(np.exp(1j * (self._start[2] + HEADINGS - pose[2]))))
        return int(i), int(j), int(np.argmin(off))

    def free(self, node: Node) -> bool:
        i, j = node[0] - self.low[0], node[1] - self.low[1]
        return 0 <= i < self._free.shape[0] and 0 <= j < self._free.shape[1] and bool(self._free[i, j, node[2]])

    def neighbors(self, node: Node) -> list[tuple[Node, float]]:
        i, j, h = node
        dx, dy = MOVES[h].tolist()
        length, count = self.cell * float(np.hypot(dx, dy)), len(MOVES)
        found: list[tuple[Node, float]] = [((i + dx, j + dy, h), length), ((i - dx, j - dy, h), BACKWARDS * length)]
        for step in (1, -1):
            other = (h + step) % count
            angle = abs(float(np.angle(np.exp(1j * (HEADINGS[other] - HEADINGS[h])))))
            found.append(((i, j, other), TURN * angle))
        return [(n, cost) for n, cost in found if self.free(n) and (node, n) not in self.blocked]

    def search(self, goal: Node) -> list[Node] | None:
        """The cheapest nodes from the start to ``goal``; None: there are none."""
        start = (0, 0, 0)
        best, before = {start: 0.0}, {start: start}
        queue = [(self._left(start, goal), start)]
        done: set[Node] = set()
        while queue:
            _, node = heappop(queue)
            if node == goal:
                return _back(before, node)
            if node in done:
                continue
            done.add(node)
            for other, cost in self.neighbors(node):
                total = best[node] + cost
                if total < best.get(other, np.inf) - 1e-12:
                    best[other], before[other] = total, node
                    heappush(queue, (total + self._left(other, goal), other))
        return None

    def _left(self, node: Node, goal: Node) -> float:
        return self.cell * float(np.hypot(node[0] - goal[0], node[1] - goal[1]))


def _back(before: dict[Node, Node], node: Node) -> list[Node]:
    found = [node]
    while before[found[-1]] != found[-1]:
        found.append(before[found[-1]])
    return found[::-1]


def plan_route(
    robot: RobotModel, obstacles: Obstacles, start: ArrayLike, goal: ArrayLike, *, cell: float = 0.1, margin: float | None = None,
    t: float = 0.0, bounds: ArrayLike | None = None,
) -> Array:  # fmt: skip
    """Poses (n, 3: x, y [m], yaw [rad]) of the base from ``start`` (3) to ``goal`` (3), straight ways and turns in place between them, on
    which all of the robot, at home but for its base, keeps ``margin`` [m] (left out: that of its file) from ``obstacles`` as they are at
    ``t`` [s].

    For bases that can turn in place; the way is the cheapest on a lattice with cells of ``cell`` [m], then shortened. Obstacles that
    move count where they are at ``t``. ``bounds`` ((x, y), (x, y)) [m]: where the base may be (left out: 3 m around start and goal).
    :func:`wbmpc.mpc.route.follow_route` follows it. Raises :class:`~wbmpc.errors.NoRoute` where there
    is none, and :class:`InputError` for bad arguments and a base that does not move.
    """
    if "base" not in robot.state:
        raise InputError(f"route: the base of '{robot.description.name}' does not move")
    checks.positive("route", cell=cell)
    first, last = checks.numbers("route", "start", start, 3).copy(), checks.numbers("route", "goal", goal, 3).copy()
    keep = robot.description.collision.margin if margin is None else margin
    checks.positive("route", margin=keep)
    snapshot = obstacles.snapshot(t)
    low, high = _bounds(bounds, first, last)
    footprint = Footprint(robot, snapshot, float(keep), t)
    for name, pose in (("start", first), ("goal", last)):
        if not footprint.clear(pose[None])[0]:
            raise NoRoute(f"the robot at the {name} is not {1e3 * keep:.0f} mm clear of what stands there")
    lattice = _Lattice(first, low, high, float(cell), footprint)
    target = lattice.near(last)
    for _ in range(SEARCHES):
        nodes = lattice.search(target) if lattice.free(target) else None
        if nodes is None:
            raise NoRoute("no way leads from start to goal")
        route = unwrapped(np.array([lattice.pose(n) for n in nodes] + [last]))
        bad = [k for k in range(len(route) - 1) if not footprint.clear(between(route[k], route[k + 1])).all()]
        if not bad:
            return _shortened(route, footprint)
        if bad == [len(nodes) - 1]:
            raise NoRoute("the goal cannot be entered from the nearest place of the lattice; valid: a smaller 'cell'")
        for k in bad:
            if k + 1 < len(nodes):
                lattice.blocked |= {(nodes[k], nodes[k + 1]), (nodes[k + 1], nodes[k])}
    raise NoRoute(f"{SEARCHES} routes touch something on the way; valid: a smaller 'cell'")


def _bounds(bounds: ArrayLike | None, first: Array, last: Array) -> tuple[Array, Array]:
    if bounds is None:
        return np.minimum(first, last)[:2] - AROUND, np.maximum(first, last)[:2] + AROUND
    given = checks.real_numbers("route: 'bounds'", bounds)
    if given.shape != (2, 2) or not np.isfinite(given).all() or not (given[0] < given[1]).all():
        raise InputError("route: 'bounds': ((x, y), (x, y)) [m] are needed, the lower ones first")
    return given[0], given[1]


def unwrapped(route: Array) -> Array:
    route[:, 2] = np.unwrap(route[:, 2])
    return route


def _shortened(route: Array, footprint: Footprint) -> Array:
    """The route with straight ways in place of detours: from each pose to the farthest one that can be reached by a turn, a way and a turn."""
    kept, k = [route[0]], 0
    while k < len(route) - 1:
        for j in range(len(route) - 1, k, -1):
            piece = turn_go_turn(kept[-1], route[j])
            dense = np.concatenate([between(a, b) for a, b in itertools.pairwise(piece)])
            cheaper = _length(piece) <= _length(route[k : j + 1]) + 1e-9
            if j == k + 1 or (cheaper and footprint.clear(dense).all()):
                kept.extend(piece[1:] if j > k + 1 else [route[j]])
                k = j
                break
    found = unwrapped(np.array(kept))
    moved = np.abs(np.diff(found, axis=0)).max(axis=1) > 1e-9
    return found[np.concatenate([[True], moved])]


def turn_go_turn(a: Array, b: Array) -> Array:
    step = b[:2] - a[:2]
    if np.linalg.norm(step) < 1e-9:
        return unwrapped(np.array([a, b]))
    heading = np.arctan2(step[1], step[0])
    return unwrapped(np.array([a, [*a[:2], heading], [*b[:2], heading], b]))


def _length(route: Array) -> float:
    step = np.diff(route, axis=0)
    return float(np.linalg.norm(step[:, :2], axis=1).sum() + TURN * np.abs(step[:, 2]).sum())
