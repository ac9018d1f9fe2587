"""Paths of the end effector: a line, a circle, a sine, poses, a table of a file. One time law for all: ramps of speed along the arc."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.checks import parse_number
from wbmpc.configuration import OneOf
from wbmpc.errors import InputError
from wbmpc.input_file import read_file
from wbmpc.model.robot import RobotModel
from wbmpc.ocp import Path as SmoothPath
from wbmpc.ocp import Reference
from wbmpc.ocp.scaling import reach
from wbmpc.settings import ReadBy, Settings
from wbmpc.tasks.arm_reach import reached_share
from wbmpc.tasks.headings import headings, weigh_heading
from wbmpc.tasks.paths import rise, risen

#: Length [m] of a path where nothing says it: of a robot whose base moves, and (times its reach) of one that stands, the first of these
#: that the arm can follow with a margin.
LENGTH, SHARES, MARGIN = 5.0, tuple(0.5 * 0.85**k for k in range(12)), 1.1
#: Waves of a sine over its length, where nothing says them: aside, and up and down.
ASIDE, LIFT = 0.06, 0.02
#: Points of a path, interval [s] of its reference.
POINTS, SAMPLED = 2001, 0.02
#: Coordinates [m] of a path, poses of one, and time [s] that it takes, at most: what is longer is a mistake, and fills the memory.
FARTHEST, MAX_POSES, LONGEST = 1000.0, 1000, 7200.0
_Coordinate = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]


@dataclass(frozen=True)
class Curve:
    """Points (n, 3) [m] and quaternions (n, 4) in the world of the planner."""

    points: Array
    turns: Array


class PathSettings(Settings):
    """``length`` [m] of the path (left out: 5, or of a robot whose base stands what its arm can
    follow, up to half its reach); ``direction`` [rad] from straight ahead, in
    which it begins; ``speed`` [m/s]: along the arc; ``ramp`` [s]: time over which the speed rises and falls."""

    length: float | None = Field(None, gt=1e-3, le=1000)
    direction: float = Field(0.0, ge=-6.3, le=6.3)
    speed: float = Field(0.2, ge=1e-3, le=10)
    ramp: float = Field(2.0, ge=0.01, le=60)

    def size(self, robot: RobotModel) -> float:
        """Length [m] of this robot's path."""
        if self.length is not None:
            return self.length
        if robot.description.base.moves:
            return LENGTH
        pose, lengths = robot.pose(robot.home), [share * reach(robot) for share in SHARES]
        return next((length for length in lengths if self._followed(robot, MARGIN * length, *pose)), lengths[-1])

    def _followed(self, robot: RobotModel, length: float, position: Array, quaternion: Array) -> bool:
        curve = self._placed(length, position, quaternion)
        return reached_share(robot, curve.points, curve.turns) == 1.0

    def offsets(self, length: float) -> tuple[Array, Array]:
        """Offsets (n, 3) [m] from the start, in axes with x straight ahead, and turns (n) [rad] about the vertical."""
        raise NotImplementedError

    def curve(self, robot: RobotModel, position: Array, quaternion: Array) -> Curve:
        """The path from a pose of the end effector on."""
        return self._placed(self.size(robot), position, quaternion)

    def _placed(self, length: float, position: Array, quaternion: Array) -> Curve:
        offsets, turns = self.offsets(length)
        c, s = np.cos(self.direction), np.sin(self.direction)
        points = position + offsets @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        up = (0.0, 0.0, 1.0)
        return Curve(
            points, np.array([lie.quaternion_multiply(lie.quaternion_about(up, float(a)), quaternion) for a in turns])
        )

    def smooth(self, robot: RobotModel, position: Array, quaternion: Array) -> SmoothPath:
        """The same path by its arc length."""
        curve = self.curve(robot, position, quaternion)
        return SmoothPath(curve.points, curve.turns)


class Line(PathSettings):
    """Straight; it rises by ``climb`` [m]."""

    kind: Literal["line"] = "line"
    climb: float = Field(0.0, ge=-100, le=100)

    def offsets(self, length: float) -> tuple[Array, Array]:
        share = np.linspace(0.0, 1.0, POINTS)
        return np.stack([length * share, 0.0 * share, self.climb * share], axis=1), 0.0 * share


class Circle(PathSettings):
    """To the left. ``laps``: turns of it over the whole length; ``turn``: whether the end effector turns along; ``vertical``: the circle stands."""

    kind: Literal["circle"] = "circle"
    laps: float = Field(1.0, gt=0, le=1000)
    turn: bool = False
    vertical: bool = False

    def offsets(self, length: float) -> tuple[Array, Array]:
        angle = np.linspace(0.0, 2.0 * np.pi * self.laps, POINTS)
        radius, zero = length / (2.0 * np.pi * self.laps), 0.0 * angle
        along, aside = radius * np.sin(angle), radius * (1.0 - np.cos(angle))
        columns = [zero, along, aside] if self.vertical else [along, aside, zero]
        return np.stack(columns, axis=1), angle if self.turn else zero


class Sine(PathSettings):
    """Straight ahead with waves, which grow over the first fifth. ``amplitude`` [m]: aside (left out: 0.06 of the length); ``lift`` [m]: up
    and down, with 0.7 times the frequency (left out: 0.02 of the length); ``periods``: number of waves to the side."""

    kind: Literal["sine"] = "sine"
    amplitude: float | None = Field(None, ge=0, le=100)
    lift: float | None = Field(None, ge=0, le=100)
    periods: float = Field(2.0, gt=0, le=1000)

    def offsets(self, length: float) -> tuple[Array, Array]:
        share = np.linspace(0.0, 1.0, POINTS)
        grown, phase = rise(share, 0.2), 2.0 * np.pi * self.periods * share
        aside = ASIDE * length if self.amplitude is None else self.amplitude
        lift = LIFT * length if self.lift is None else self.lift
        waves = [aside * grown * np.sin(phase), lift * grown * np.sin(0.7 * phase)]
        return np.stack([length * share, *waves], axis=1), 0.0 * share


class Waypoints(PathSettings):
    """Straight pieces; at the robot's own speed their corners are rounded by a centimeter."""

    def waypoints(self, position: Array, quaternion: Array) -> tuple[Array, Array]:
        """Positions (n, 3) and quaternions (n, 4) in the world of the planner, the first one where the path starts."""
        raise NotImplementedError

    def curve(self, robot: RobotModel, position: Array, quaternion: Array) -> Curve:
        return _dense(*self.waypoints(position, quaternion))

    def smooth(self, robot: RobotModel, position: Array, quaternion: Array) -> SmoothPath:
        return SmoothPath.polyline(*self.waypoints(position, quaternion))


class Poses(Waypoints):
    """Straight from one to the next. ``poses``: each 3 numbers (x, y, z) [m] from the start in axes with x ahead, or 7 with a quaternion
    (w, x, y, z) that turns the first orientation."""

    kind: Literal["poses"] = "poses"
    poses: tuple[tuple[_Coordinate, ...], ...] = Field(
        ((0.3, 0.0, 0.0), (0.3, 0.3, 0.0)), min_length=1, max_length=MAX_POSES
    )

    def waypoints(self, position: Array, quaternion: Array) -> tuple[Array, Array]:
        if any(len(p) not in (3, 7) for p in self.poses):
            raise InputError("path.poses: each needs 3 numbers (x, y, z), or 7 with a quaternion (w, x, y, z)")
        rows = np.array([[*p, 1.0, 0.0, 0.0, 0.0][:7] if len(p) == 3 else p for p in self.poses], float)
        return _waypoints(rows, position, quaternion, self.direction, "path.poses")


class Table(Waypoints):
    """As with poses. ``file``: a CSV whose first line names its columns x, y, z [m], or these and qw, qx, qy, qz."""

    kind: Literal["csv"] = "csv"
    file: Annotated[Path, ReadBy(lambda path: read_table(path))] = Path("path.csv")

    def waypoints(self, position: Array, quaternion: Array) -> tuple[Array, Array]:
        return _waypoints(read_table(self.file), position, quaternion, self.direction, str(self.file))


#: Bytes of a CSV file, at most.
LARGEST_TABLE = 4 * 1024 * 1024


def read_table(path: Path) -> Array:
    """Poses (n, 7) of a CSV file. Raises :class:`InputError` naming the file and the line."""
    if not path.is_file():
        raise InputError(f"path.file: there is no file '{path}'")
    try:
        lines = [line.strip() for line in read_file(path, LARGEST_TABLE).decode("utf-8").splitlines()]
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file in UTF-8") from error
    names = [n.strip() for n in lines[0].split(",")] if lines else []
    if names not in (["x", "y", "z"], ["x", "y", "z", "qw", "qx", "qy", "qz"]):
        raise InputError(
            f"{path}, line 1: columns 'x,y,z' or 'x,y,z,qw,qx,qy,qz' are needed, got '{','.join(names):.60}'"
        )
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        if line:
            rows.append(_row(line, len(names), f"{path}, line {number}"))
        if len(rows) > MAX_POSES:
            raise InputError(f"{path}, line {number}: at most {MAX_POSES} poses are read")
    if not rows:
        raise InputError(f"{path}: it has no poses")
    return np.array([[*row, 1.0, 0.0, 0.0, 0.0][:7] for row in rows])


def _row(line: str, count: int, where: str) -> list[float]:
    try:
        values = [parse_number(cell) for cell in line.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not all(-FARTHEST <= v <= FARTHEST for v in values):
        raise InputError(
            f"{where}: {count} finite numbers from -{FARTHEST:g} to {FARTHEST:g} are needed, got '{line:.60}'"
        )
    return values


def _waypoints(rows: Array, position: Array, quaternion: Array, direction: float, where: str) -> tuple[Array, Array]:
    lengths = np.linalg.norm(rows[:, 3:], axis=1)
    if np.abs(lengths - 1.0).max() > 1e-2:
        raise InputError(f"{where}: pose {int(np.argmax(np.abs(lengths - 1.0)))}: its quaternion must have length 1")
    c, s = np.cos(direction), np.sin(direction)
    points = position + rows[:, :3] @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    turns = np.array([lie.quaternion_multiply(q, quaternion) for q in rows[:, 3:] / lengths[:, None]])
    points, turns = np.vstack([position, points]), np.vstack([quaternion, turns])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if steps.sum() < 1e-6:
        raise InputError(f"{where}: the path has no length; 'wbmpc run goals' turns in place")
    if steps.sum() > FARTHEST:
        raise InputError(f"{where}: the path is {steps.sum():.4g} m long; at most {FARTHEST:g} m are planned")
    keep = np.concatenate([[True], steps > 1e-9])
    return points[keep], turns[keep]


def _dense(points: Array, turns: Array) -> Curve:
    """Straight pieces with many points each, so that orientations go along the arc."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, way[-1], POINTS)
    piece = np.clip(np.searchsorted(way, at, side="right") - 1, 0, len(way) - 2)
    share = (at - way[piece]) / np.diff(way)[piece]
    return Curve(
        points[piece] + share[:, None] * (points[piece + 1] - points[piece]),
        np.array([lie.slerp(turns[k], turns[k + 1], a) for k, a in zip(piece, share, strict=True)]),
    )


#: One of them, by its ``kind``.
AnyPath = OneOf[Line | Circle | Sine | Poses | Table]


def duration(length: float, speed: float) -> float:
    """Time [s] along a path of ``length`` [m] at ``speed`` [m/s]; :class:`InputError` for more than :data:`LONGEST`."""
    if length > LONGEST * speed:
        raise InputError(
            f"path.speed: {length:.4g} m with {speed:g} m/s take {length / speed:.4g} s; at most {LONGEST:g} s are planned"
        )
    return length / speed


def timed(curve: Curve, speed: float, ramp: float, start: float) -> tuple[Reference, float]:
    """The curve as a reference that begins at ``start`` [s], and when it ends [s]."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve.points, axis=0), axis=1))])
    end = start + duration(way[-1], speed) + ramp
    times = np.arange(0.0, end + SAMPLED, SAMPLED)
    t = times - start
    arc = np.clip(speed * (risen(t, ramp) - risen(t - way[-1] / speed, ramp)), 0.0, way[-1])
    points = np.stack([np.interp(arc, way, column) for column in curve.points.T], axis=1)
    near = np.clip(np.searchsorted(way, arc), 0, len(way) - 1)
    return Reference.poses(times, points, curve.turns[near]), end


def carried_base(robot: RobotModel, poses: Array) -> Array:
    """Poses (n, 3) of a base beside which the end effector, at poses (n, 7), stays as at home."""
    part = robot.state["base"].start
    home = robot.home[part : part + 3]
    position, quaternion = robot.pose(robot.home)
    back = lie.quaternion_conjugate(quaternion)
    turned = [lie.quaternion_log(lie.quaternion_multiply(q, back))[2] for q in poses[:, 3:]]
    yaw = home[2] + np.unwrap(np.array(turned))
    beside = position[:2] - home[:2]
    c, s = np.cos(yaw - home[2]), np.sin(yaw - home[2])
    return np.stack(
        [poses[:, 0] - c * beside[0] + s * beside[1], poses[:, 1] - s * beside[0] - c * beside[1], yaw], axis=1
    )


def follow(robot: RobotModel, mpc: Any, reference: Reference) -> None:
    """The end effector follows ``reference``; where the problem has a reference of the base too, the base goes along, with the
    :func:`~wbmpc.tasks.headings.headings` of one that needs them."""
    mpc.reference["end_effector"] = reference
    if (
        "state" in mpc.reference
        and "base" in robot.state
        and mpc.reference["state"].values.shape[1] == robot.state.size
    ):
        values = np.tile(mpc.reference["state"].values[:1], (len(reference.times), 1))
        part = robot.state["base"].start
        values[:, part : part + 3] = carried_base(robot, reference.values)
        if (planned := headings(robot, reference)) is not None:
            values[:, part + 2] = np.interp(reference.times, *planned)
            weigh_heading(mpc.solver, robot)
        mpc.reference["state"] = Reference(
            reference.times, values, "hold" if reference.kind == "pose_hold" else "linear"
        )
