"""What stands and moves around the robot: set, moved and removed by name at any time, from any thread."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from wbmpc import checks, lie
from wbmpc.arrays import Array
from wbmpc.errors import InputError, SensorFailure, unknown_name
from wbmpc.obstacles.scene import SceneObstacle, read_scene
from wbmpc.obstacles.shapes import (
    LARGEST,
    Box,
    Capsule,
    ConvexMesh,
    Cylinder,
    DistanceGrid,
    HalfSpace,
    Shape,
    Sphere,
)

_SHAPES = {c.__name__: c for c in (Sphere, Capsule, Cylinder, Box, HalfSpace, ConvexMesh, DistanceGrid)}
#: The frame of the robot's own plans: that of :meth:`wbmpc.model.robot.RobotModel.pose`.
WORLD = "world"
#: Obstacles at once, at most.
MAX_OBSTACLES = 10_000


@dataclass(frozen=True, eq=False)
class Obstacle:
    """One obstacle: its ``shape`` at ``position`` (3) [m] and ``orientation`` (4) in ``frame`` at time ``seen`` [s]; it moves with
    ``velocity`` (3) [m/s]. ``std`` [m] and ``velocity_std`` [m/s]: standard deviations; ``expire`` [s]: how long after ``seen`` it is there;
    ``max_age`` [s]: how long after ``seen`` one may still plan with it. ``ignore``: frames of the robot that may touch it. ``side``: of a
    distance grid, which of its nearest points is meant.
    """

    name: str
    shape: Shape
    position: Array
    orientation: Array
    velocity: Array
    std: float
    velocity_std: float
    seen: float
    expire: float
    frame: str
    max_age: float = np.inf
    ignore: tuple[str, ...] = ()
    side: int = 0

    def age(self, times: Array) -> Array:
        """How long ago (n) [s] it was seen; 0 before."""
        return np.maximum(times - self.seen, 0.0)

    def spread(self, times: Array) -> Array:
        """Standard deviation (n) [m] of its predicted position at ``times`` (n) [s]."""
        return np.asarray(np.hypot(self.std, self.velocity_std * self.age(times)))


@dataclass(frozen=True)
class Snapshot:
    """All obstacles at one moment, sorted by name, and the frames (position (3), quaternion (4)) they are given in."""

    obstacles: tuple[Obstacle, ...] = ()
    frames: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)

    def pose(self, obstacle: Obstacle, times: Array) -> tuple[Array, Array]:
        """Predicted positions (n, 3) [m] and the rotation (3, 3) of an obstacle's axes in the world at ``times`` (n) [s]."""
        place = obstacle.position + np.multiply.outer(obstacle.age(times), obstacle.velocity)
        turn = lie.quaternion_to_rotation(obstacle.orientation)
        if obstacle.frame == WORLD:
            return place, turn
        origin, q = self.frames[obstacle.frame]
        rotation = lie.quaternion_to_rotation(q)
        return origin + place @ rotation.T, rotation @ turn


class Obstacles:
    """Obstacles by name, for an MPC that has clearance rows: ``MPC(ocp, obstacles=world)``.

    Every call holds a lock for some microseconds; a solve works with a :meth:`snapshot`. Coordinates are those of
    :meth:`wbmpc.model.robot.RobotModel.pose`, or of a frame whose pose in them :meth:`set_frame` keeps ("map", a camera).
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._obstacles: dict[str, Obstacle] = {}
        self._frames: dict[str, tuple[Array, Array]] = {}

    def set(
        self, name: str, shape: Shape, *, position: ArrayLike = (0.0, 0.0, 0.0),
        orientation: ArrayLike = (1.0, 0.0, 0.0, 0.0), velocity: ArrayLike = (0.0, 0.0, 0.0), std: float = 0.0,
        velocity_std: float = 0.0, seen: float | None = None, expire: float = np.inf, max_age: float = np.inf,
        frame: str = WORLD, ignore: Sequence[str] = (),
    ) -> None:  # fmt: skip
        """Add an obstacle, or replace the one of that name.

        ``shape`` stands at ``position`` (3) [m] and ``orientation`` (4, w, x, y, z) of ``frame`` at time ``seen`` [s] (left out: when the
        next solve begins), and goes on with ``velocity`` (3) [m/s]. Margins grow by twice the standard deviation of where it is
        predicted: ``std`` [m], and ``velocity_std`` [m/s] times the time since. It is removed ``expire`` [s] after ``seen``. If it is not
        set again within ``max_age`` [s], plans end in a stop: use it for obstacles that sensors must keep seeing. ``ignore``: frames of the robot
        that need not keep clear of it, such as that with the wheels, of the floor. Raises :class:`InputError` naming the obstacle.
        """
        who = _named(name)
        if not isinstance(shape, tuple(_SHAPES.values())):
            raise InputError(f"{who}: a shape is needed, got {type(shape).__name__}; valid: {', '.join(_SHAPES)}")
        checks.not_negative(who, std=std, velocity_std=velocity_std)
        checks.at_most(who, LARGEST, std=std, velocity_std=velocity_std)
        for key, value in (("expire", expire), ("max_age", max_age)):
            if not (isinstance(value, float) and value == np.inf):
                checks.positive(who, **{key: value})
        if seen is not None:
            checks.absolute_time(f"{who}: 'seen'", seen)
        elif np.isfinite(min(expire, max_age)):
            key = "expire" if np.isfinite(expire) else "max_age"
            raise InputError(f"{who}: '{key}' counts from 'seen', which is left out")
        found = Obstacle(
            name, shape, checks.numbers(who, "position", position, 3).copy(), checks.unit_quaternion(who, "orientation", orientation),
            checks.numbers(who, "velocity", velocity, 3).copy(), float(std), float(velocity_std),
            np.nan if seen is None else float(seen), float(expire), frame, float(max_age), _frames(who, ignore),
        )  # fmt: skip
        checks.at_most(who, LARGEST, position=found.position, velocity=found.velocity)
        with self._lock:
            self._check_frame(who, frame)
            if len(self._obstacles) >= MAX_OBSTACLES and name not in self._obstacles:
                raise InputError(f"{who}: there are {MAX_OBSTACLES} obstacles already; at most so many are possible")
            self._obstacles[name] = found

    def move(
        self, name: str, position: ArrayLike, orientation: ArrayLike | None = None, *,
        velocity: ArrayLike = (0.0, 0.0, 0.0), seen: float | None = None,
    ) -> None:  # fmt: skip
        """Put an obstacle somewhere else: ``position`` (3) [m], ``orientation`` (4) (left out: as it was), ``velocity`` (3) [m/s], and when
        it was ``seen`` [s]. Its shape, standard deviations and frame stay. Raises :class:`InputError` naming it."""
        _named(name)
        with self._lock:  # as a whole: another thread may remove or replace it
            if name not in self._obstacles:
                raise unknown_name("obstacle", name, sorted(self._obstacles))
            old = self._obstacles[name]
            turn = old.orientation if orientation is None else orientation
            self.set(
                name, old.shape, position=position, orientation=turn, velocity=velocity, std=old.std,
                velocity_std=old.velocity_std, seen=seen, expire=old.expire, max_age=old.max_age, frame=old.frame,
                ignore=old.ignore,
            )  # fmt: skip

    def set_frame(self, name: str, position: ArrayLike, orientation: ArrayLike = (1.0, 0.0, 0.0, 0.0)) -> None:
        """Set the pose of the frame ``name`` in the world: ``position`` (3) [m] and ``orientation`` (4)."""
        who = f"frame '{name}'"
        if not isinstance(name, str) or name == WORLD:
            raise InputError(f"{who}: another name than '{WORLD}' is needed")
        pose = (
            checks.numbers(who, "position", position, 3).copy(),
            checks.unit_quaternion(who, "orientation", orientation),
        )
        checks.at_most(who, LARGEST, position=pose[0])
        with self._lock:
            self._frames[name] = pose

    def load(self, path: str | Path) -> None:
        """Set the obstacles of a YAML file (:func:`wbmpc.obstacles.scene.read_scene`); a file with a mistake changes nothing. Raises
        :class:`InputError` naming file, obstacle and key."""
        scene, trial = list(read_scene(path)), Obstacles()
        with self._lock:
            trial._obstacles.update(self._obstacles)
            place_all(scene, trial)
            self._obstacles = trial._obstacles

    def remove(self, name: str) -> None:
        """Take an obstacle away. Raises :class:`InputError` naming the valid choices where there is none."""
        _named(name)
        with self._lock:
            if self._obstacles.pop(name, None) is None:
                raise unknown_name("obstacle", name, sorted(self._obstacles))

    def clear(self) -> None:
        """Take all obstacles away."""
        with self._lock:
            self._obstacles.clear()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all obstacles, sorted."""
        with self._lock:
            return tuple(sorted(self._obstacles))

    def __contains__(self, name: object) -> bool:
        with self._lock:
            return isinstance(name, str) and name in self._obstacles

    def __len__(self) -> int:
        with self._lock:
            return len(self._obstacles)

    def take(self, snapshot: Snapshot) -> None:
        """Replace all obstacles by those of a snapshot; they do not expire. For predictions over a long time."""
        with self._lock:
            self._obstacles = {o.name: replace(o, expire=np.inf, max_age=np.inf) for o in snapshot.obstacles}
            self._frames = dict(snapshot.frames)

    def snapshot(self, t: float) -> Snapshot:
        """The obstacles at time ``t`` [s]. Obstacles without a time count as seen now; expired ones are removed. Raises
        :class:`InputError` for what is no time, and :class:`~wbmpc.errors.SensorFailure` where one is older than its ``max_age``."""
        t = checks.absolute_time("obstacles", t)
        with self._lock:
            for name, obstacle in list(self._obstacles.items()):
                if np.isnan(obstacle.seen):
                    self._obstacles[name] = replace(obstacle, seen=t)
                elif t > obstacle.seen + obstacle.expire:
                    del self._obstacles[name]
                elif t > obstacle.seen + obstacle.max_age:
                    raise SensorFailure(
                        f"obstacle '{name}' was seen {t - obstacle.seen:.2f} s ago, {obstacle.max_age:g} s at most are possible"
                    )
            return Snapshot(tuple(self._obstacles[n] for n in sorted(self._obstacles)), dict(self._frames))

    def _check_frame(self, who: str, frame: str) -> None:
        if not isinstance(frame, str):
            raise InputError(f"{who}: 'frame' needs a name, got {checks.quoted(frame)}")
        if frame != WORLD and frame not in self._frames:
            raise unknown_name("frame", frame, [WORLD, *sorted(self._frames)], where=who)


def _frames(who: str, names: Sequence[str]) -> tuple[str, ...]:
    if isinstance(names, str) or not isinstance(names, Sequence) or not all(isinstance(n, str) for n in names):
        raise InputError(f"{who}: 'ignore' needs a list of names of frames, got {checks.quoted(names)}")
    return tuple(names)


def _named(name: str) -> str:
    if not isinstance(name, str) or not name:
        raise InputError(f"obstacle: a name is needed, got {name!r}")
    return f"obstacle '{name}'"


def place_all(scene: Sequence[SceneObstacle], world: Obstacles) -> None:
    """Set the obstacles of a file in a world. Raises :class:`InputError` naming file and obstacle."""
    for one in scene:
        try:
            world.set(one.name, one.shape, **one.place)
        except InputError as error:
            raise InputError(f"{one.where}: {error}") from error
