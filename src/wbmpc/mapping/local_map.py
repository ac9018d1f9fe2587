"""A map of what range sensors see around a robot: occupied cells in a window that moves along, as a grid of distances."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc import checks
from wbmpc.arrays import Array
from wbmpc.clearance.support_step import beyond
from wbmpc.errors import InputError, SensorFailure
from wbmpc.kernel.ir import LANES, Floats, Integers
from wbmpc.mapping.compilation import compiled
from wbmpc.mapping.distances import ERROR, DistanceTransform
from wbmpc.mapping.rays_step import FREE, OCCUPIED, OWN, SOLID, Cells, add_scan, settle
from wbmpc.model.robot import RobotModel
from wbmpc.obstacles.geometry import robot_geometry
from wbmpc.obstacles.shapes import LARGEST, MAX_CELLS, DistanceGrid
from wbmpc.obstacles.solids import KINDS
from wbmpc.obstacles.world import Obstacles


@compiled
def mark_own(
    n: int, points: Floats, shapes: int, kind: Integers, size: Floats, around: Floats, place: Floats, axes: Floats,
    padding: float, found: Integers,
) -> None:  # fmt: skip
    """``found`` (n) of points (n, 3) that are within ``padding`` [m] of a solid becomes :data:`OWN`. Solids: ``kind`` and ``size`` as in
    :mod:`wbmpc.clearance.support_step`, radius ``around`` their centers ``place`` (s, 3), ``axes`` (s, 3, 3)."""
    for p in range(n):
        for s in range(shapes):
            x, y, z = (
                points[3 * p] - place[3 * s],
                points[3 * p + 1] - place[3 * s + 1],
                points[3 * p + 2] - place[3 * s + 2],
            )
            reach, r = around[s] + padding, 9 * s
            if x * x + y * y + z * z > reach * reach:
                continue
            inside = beyond(
                s, kind, size,
                axes[r] * x + axes[r + 3] * y + axes[r + 6] * z,
                axes[r + 1] * x + axes[r + 4] * y + axes[r + 7] * z,
                axes[r + 2] * x + axes[r + 5] * y + axes[r + 8] * z,
            )  # fmt: skip
            if inside <= padding:
                found[p] = OWN
                break


class BodyFilter:
    """Finds points of a robot's own shapes. ``padding`` [m]: what is so near to one belongs to it."""

    def __init__(self, robot: RobotModel, padding: float) -> None:
        self._geometry, self._padding = robot_geometry(robot), padding
        solids = [s.solid for s in self._geometry.shapes]
        self._kind = np.array([KINDS.index(s.kind) for s in solids], np.int64)
        self._size = np.array([s.size for s in solids], float).ravel()
        self._around = np.array([s.radius for s in solids])

    def mark(self, points: Array, kind: NDArray[np.int64], state: Array) -> None:
        """Mark points (n, 3) [m] of the robot in a state (nx) in ``kind`` (n)."""
        geometry = self._geometry
        centers, axes = geometry.at(*geometry.kinematics(state[None]))
        flat = [np.ascontiguousarray(a).reshape(-1) for a in (points, centers[0], axes[0])]
        mark_own(
            len(points), flat[0], len(self._kind), self._kind, self._size, self._around, flat[1], flat[2],
            self._padding, kind,
        )  # fmt: skip


#: The window moves when the sensor is farther [m] than this from its middle; distances up to this [m] are exact, others are so much.
MOVES, FARTHEST = 0.5, 1.0
#: Points farther than so many ranges are no measurements.
HOSTILE = 10.0
#: Points of a scan, at most.
MAX_POINTS = 1_000_000


class LocalMap:
    """Occupied cells of ``cell`` [m] in a window of ``size`` (3) [m] about the sensors; memory does not grow.

    :meth:`add` takes in a scan, :meth:`publish` makes the map an obstacle. Unseen cells count as free. Points lower than ``floor`` [m]
    above the ground belong to the floor. ``reach`` [m] of the sensors: farther points only clear the cells along their ray. Points within
    ``padding`` [m] of the ``robot`` (None: no robot) are removed. A cell becomes free again when several rays pass through it, or
    ``memory`` [s] after it was last seen. ``max_age`` [s]: if a source is silent for longer, plans end in a stop. Coordinates are those
    of plans (:meth:`wbmpc.model.robot.RobotModel.pose`). ``dropped``: number of invalid points so far. ``shape`` (3): number of cells
    along x, y, z. Use it from one thread.
    """

    def __init__(
        self, robot: RobotModel | None = None, *, size: ArrayLike = (6.0, 6.0, 2.0), cell: float = 0.05,
        floor: float = 0.08, reach: float = 4.0, padding: float = 0.05, memory: float = 30.0, max_age: float = 0.5,
    ) -> None:  # fmt: skip
        who, extent = "local map", checks.numbers("local map", "size", size, 3)
        checks.positive(who, cell=cell, reach=reach, memory=memory, max_age=max_age)
        checks.not_negative(who, floor=floor, padding=padding)
        ground = 0.0 if robot is None else robot.description.base.ground
        counts = np.round(extent / cell)
        if not ((counts >= 2).all() and counts.prod() <= MAX_CELLS and floor < extent[2]):
            raise InputError(
                f"{who}: 'size' needs 2 cells or more along each axis, {MAX_CELLS} at most, got {extent.tolist()}"
            )
        self._lowest = int(np.ceil(floor / cell)) + 1
        layers = self._lowest + int(np.ceil((extent[2] - floor) / cell))
        self.shape = (int(counts[0]), int(counts[1]), -(-layers // LANES) * LANES)  # faster in whole vectors
        self.cell, self._reach, self._memory, self._max_age = float(cell), float(reach), float(memory), float(max_age)
        self._bottom = ground + floor - self._lowest * self.cell
        self._body = None if robot is None else BodyFilter(robot, float(padding))
        self._nx = 0 if robot is None else robot.state.size
        self._evidence, self._mark = np.zeros(self.shape, np.int64), np.zeros(self.shape, np.int64)
        self._seen = np.zeros(self.shape)
        self._low: NDArray[np.int64] | None = None
        self._transform = DistanceTransform(self.shape, self.cell, FARTHEST)
        self._scan, self.dropped = 0, 0
        self._times: dict[str, float] = {}

    # ------------------------------------------------------------------ where it is
    @property
    def origin(self) -> Array:
        """Center (3) [m] of the first cell."""
        low = np.zeros(2) if self._low is None else self._low
        return np.array([*(low + 0.5) * self.cell, self._bottom + 0.5 * self.cell])

    @property
    def occupied(self) -> NDArray[np.bool_]:
        """Occupied cells (nx, ny, nz)."""
        return self._evidence >= OCCUPIED

    def _follow(self, position: Array) -> None:
        """Move the window to where the sensor is; what leaves it is forgotten."""
        middle = np.round(position[:2] / self.cell).astype(np.int64)
        target = middle - np.array(self.shape[:2]) // 2
        if self._low is None:
            self._low = target
        shift = target - self._low
        if np.abs(shift).max() * self.cell <= MOVES:
            return
        for array in (self._evidence, self._mark, self._seen):
            moved = np.zeros_like(array)
            keep = [slice(max(s, 0), n + min(s, 0)) for s, n in zip(shift.tolist(), self.shape[:2], strict=True)]
            put = [slice(max(-s, 0), n + min(-s, 0)) for s, n in zip(shift.tolist(), self.shape[:2], strict=True)]
            if (np.abs(shift) < self.shape[:2]).all():
                moved[put[0], put[1]] = array[keep[0], keep[1]]
            array[:] = moved
        self._low = target

    # ------------------------------------------------------------------ scans
    def add(
        self, points: ArrayLike, origin: ArrayLike, t: float, state: ArrayLike | None = None, source: str = "scan"
    ) -> int:
        """Take in ``points`` (n, 3) [m] that ``source`` saw from ``origin`` (3) [m] at ``t`` [s], when the robot was in ``state`` (nx).

        Points that are not finite or much too far are dropped and counted, as is a scan older than the last one of its source. Returns the
        number of points that entered the map. Raises :class:`InputError` for other shapes and for a state that is missing.
        """
        cloud, sensor = (
            checks.real_numbers("local map: 'points'", points),
            checks.numbers("local map", "origin", origin, 3),
        )
        checks.at_most("local map", LARGEST, origin=sensor)
        t = checks.absolute_time("local map", t)
        if cloud.ndim != 2 or cloud.shape[1] != 3 or len(cloud) > MAX_POINTS:
            raise InputError(f"local map: 'points' needs rows of 3 numbers, {MAX_POINTS} at most, got {cloud.shape}")
        if self._body is not None and state is None:
            raise InputError("local map: 'state' is missing: where the robot itself was, which the sensors see too")
        if t < self._times.get(source, -np.inf):
            self.dropped += len(cloud)
            return 0
        self._times[source] = t
        with np.errstate(invalid="ignore", over="ignore"):
            length = np.linalg.norm(cloud - sensor, axis=1)
        good = length < HOSTILE * self._reach
        self.dropped += int(len(good) - good.sum())
        cloud = np.ascontiguousarray(cloud[good])
        kind = np.where(length[good] <= self._reach, SOLID, FREE).astype(np.int64)
        if self._body is not None and state is not None:
            self._body.mark(cloud, kind, checks.numbers("local map", "state", state, self._nx))
        return self._take(cloud, kind, sensor, t)

    def _take(self, cloud: Array, kind: NDArray[np.int64], sensor: Array, t: float) -> int:
        self._follow(sensor)
        self._scan += 1
        corner = self.origin - 0.5 * self.cell
        cells, from_ = (cloud - corner) / self.cell, (sensor - corner) / self.cell
        evidence, mark, seen = self._evidence.reshape(-1), self._mark.reshape(-1), self._seen.reshape(-1)
        own = Cells(*self.shape, self._lowest, evidence, mark, seen)
        add: Any = add_scan
        found: int = add(
            own, len(cells), cells.reshape(-1), kind, *from_.tolist(), self._reach / self.cell, 2.0, t, self._scan
        )
        return found

    # ------------------------------------------------------------------ distances
    def grid(self, t: float) -> DistanceGrid:
        """Distances to what is occupied at ``t`` [s]."""
        nx, ny, nz = self.shape
        settle(nx * ny, nz, self._lowest, t - self._memory, self._evidence.reshape(-1), self._seen.reshape(-1))
        return DistanceGrid(self.origin, self.cell, self._transform(self._evidence, OCCUPIED), ERROR * self.cell)

    def age(self, t: float) -> float:
        """How old [s] the last scan of the oldest source is at ``t`` [s]; infinite before the first one."""
        return t - min(self._times.values(), default=-np.inf)

    def publish(self, world: Obstacles, t: float, name: str = "map") -> None:
        """Make the map as it is at ``t`` [s] an obstacle of ``world``. Raises :class:`~wbmpc.errors.SensorFailure` if there is no scan yet,
        or one with a time in the future."""
        t = checks.absolute_time("local map", t)
        if not self._times:
            raise SensorFailure("local map: there is no scan yet")
        ahead = max(self._times, key=lambda s: self._times[s])
        if self._times[ahead] > t + self._max_age:
            raise SensorFailure(f"local map: source '{ahead}' is {self._times[ahead] - t:.2f} s ahead of the clock")
        world.set(name, self.grid(t), seen=min(min(self._times.values()), t), max_age=self._max_age)
