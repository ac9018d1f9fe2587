"""Distances of a robot to obstacles, and of its own parts to each other, linearized at every node by an MPC."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from typing import ClassVar, Literal

import casadi as ca
import numpy as np

from wbmpc import checks
from wbmpc.errors import InputError, unknown_name
from wbmpc.model.kinematics import Chain, constant
from wbmpc.model.robot import RobotModel
from wbmpc.model.tree import Frame
from wbmpc.obstacles.floor import FloorBox, floor_boxes
from wbmpc.obstacles.geometry import common_link, robot_geometry
from wbmpc.obstacles.pairs import own_margins, self_pairs
from wbmpc.ocp.symbols import Symbols

Pair = tuple[str, str]
#: Numbers of a row's parameters: normal, point, offset; of two bodies: normal, both points, offset.
WIDTH, SELF_WIDTH = 7, 10
#: Of an arm's accelerations, what it brakes with before it comes near itself; the rest is for lag, delay, and what else it has to do.
BRAKING_SHARE = 0.6
#: Frames whose shapes are as long as this [m] have twice as many rows: the nearest point of a long face that is parallel to another one
#: jumps from end to end, and a single row would let the other end in.
LONG = 0.5


@dataclass(frozen=True)
class Clearance:
    """Distance of each of the robot's ``frames`` (None: all with shapes) to its ``slots`` nearest obstacles, minus ``margin`` [m] (None: the
    robot file's ``collision.margin``), all to be at least zero: a hard constraint with a slack. Frames longer than :data:`LONG` have twice as
    many rows, for both ends of what is along an obstacle.

    ``MPC(ocp, obstacles=world)`` sets the rows before every solve.
    """

    robot: RobotModel
    frames: Sequence[str] | None = None
    slots: int = 2
    margin: float | None = None
    clear_of: ClassVar[Literal["obstacles"]] = "obstacles"

    def __post_init__(self) -> None:
        geometry = robot_geometry(self.robot)
        frames = geometry.frames if self.frames is None else tuple(self.frames)
        for name in frames:
            if name not in geometry.frames:
                raise unknown_name("frame with shapes", name, geometry.frames, where="clearance, frames")
        if not frames or len(set(frames)) < len(frames):
            raise InputError(f"clearance, frames: every frame once, and at least one, got {list(frames)}")
        checks.whole_number("clearance: slots", self.slots, 1)
        margin = self.robot.description.collision.margin if self.margin is None else self.margin
        checks.not_negative("clearance", margin=margin)
        object.__setattr__(self, "frames", frames)
        object.__setattr__(self, "margin", float(margin))

    @property
    def counts(self) -> tuple[int, ...]:
        """How many rows each frame has."""
        geometry = robot_geometry(self.robot)
        length = geometry.lengths.max(axis=1)
        index = [geometry.frames.index(f) for f in self.frames or ()]
        return tuple(int(self.slots) * (2 if length[i] >= LONG else 1) for i in index)

    @property
    def size(self) -> int:
        """How many rows."""
        return sum(self.counts)

    @property
    def reference(self) -> int:
        """How many numbers it is compared with."""
        return WIDTH * self.size

    @property
    def groups(self) -> Mapping[str, slice]:
        """The rows of each frame."""
        ends = list(accumulate(self.counts, initial=0))
        return {name: slice(ends[i], ends[i + 1]) for i, name in enumerate(self.frames or ())}

    def __call__(self, s: Symbols) -> ca.SX:
        chain, out = self.robot.base.chain(s.x), []
        for name, rows in self.groups.items():
            position, turn = chain.frame_place(self.robot.tree.frames[name])
            for k in range(rows.start, rows.stop):
                row = s.reference[WIDTH * k : WIDTH * (k + 1)]
                gap = ca.dot(row[:3], position + turn @ row[3:6]) - row[6]
                out.append(gap + _absent(row))
        return ca.vertcat(*out)


@dataclass(frozen=True)
class SelfClearance:
    """Distance of each pair of the robot's frames, with all that is fixed to them, minus ``margin`` [m] (None: the robot file's
    ``collision.self.margin``), all to be at least zero. ``pairs``: None for those of the robot file, or the ones that sampling proposes
    (:func:`wbmpc.obstacles.pairs.propose_pairs`). A pair that is near at home keeps less (:func:`wbmpc.obstacles.pairs.own_margins`):
    ``margins`` (n) [m].

    ``approach`` [s]: the arm's joints bring a pair nearer by no more than the rest of its distance h in that time, ḣ ≥ −h / approach, in
    place of h ≥ 0. Speeds then fall no faster than joints can brake, whatever the distance is: limits that count from the last command
    let plans put off an arm's braking from update to update until it is too late. None: :func:`stopping_time`; 0: the distance alone.
    """

    robot: RobotModel
    pairs: Sequence[Pair] | None = None
    margin: float | None = None
    approach: float | None = None
    margins: tuple[float, ...] = field(init=False, repr=False)
    clear_of: ClassVar[Literal["self"]] = "self"

    def __post_init__(self) -> None:
        geometry = robot_geometry(self.robot)
        pairs = self_pairs(self.robot) if self.pairs is None else tuple((str(a), str(b)) for a, b in self.pairs)
        for name in (n for pair in pairs for n in pair):
            if name not in geometry.frames:
                raise unknown_name("frame with shapes", name, geometry.frames, where="self-clearance, pairs")
        if not pairs or any(a == b for a, b in pairs):
            raise InputError(f"self-clearance, pairs: at least one pair of two frames is needed, got {list(pairs)}")
        margin = self.robot.description.collision.self.margin if self.margin is None else self.margin
        approach = stopping_time(self.robot) if self.approach is None else self.approach
        checks.not_negative("self-clearance", margin=margin, approach=approach)
        object.__setattr__(self, "pairs", pairs)
        object.__setattr__(self, "margin", float(margin))
        object.__setattr__(self, "margins", tuple(own_margins(self.robot, pairs, float(margin)).tolist()))
        object.__setattr__(self, "approach", float(approach))

    @property
    def size(self) -> int:
        """How many rows."""
        return len(self.pairs or ())

    @property
    def reference(self) -> int:
        """How many numbers it is compared with."""
        return SELF_WIDTH * self.size

    @property
    def groups(self) -> Mapping[str, slice]:
        """One row for each pair."""
        return {f"{a}-{b}": slice(i, i + 1) for i, (a, b) in enumerate(self.pairs or ())}

    def __call__(self, s: Symbols) -> ca.SX:
        chain, frames, out = self.robot.base.chain(s.x), self.robot.tree.frames, []
        for k, (a, b) in enumerate(self.pairs or ()):
            row = s.reference[SELF_WIDTH * k : SELF_WIDTH * (k + 1)]
            top = common_link(self.robot, frames[a].link, frames[b].link)
            gap = _below(chain, frames[a], row[3:6], top) - _below(chain, frames[b], row[6:9], top)
            out.append(ca.dot(row[:3], gap) - row[9] + _absent(row))
        distances = ca.vertcat(*out)
        if not self.approach:
            return distances
        arm = self.robot.state["arm"]
        change = self.robot.dynamics()(s.x, s.u, s.parameters, s.mode)[arm]
        return distances + self.approach * ca.jacobian(distances, s.x)[:, arm] @ change


@dataclass(frozen=True)
class FloorClearance:
    """Height [m] above the floor of boxes around the parts of the arm that can come near it
    (:func:`wbmpc.obstacles.floor.floor_boxes`), minus their margins, all to be at least zero. ``approach`` [s]: see
    :class:`SelfClearance`. Raises :class:`InputError` where nothing can."""

    robot: RobotModel
    approach: float | None = None
    boxes: tuple[FloorBox, ...] = field(init=False, repr=False, compare=False)
    reference: ClassVar[int] = 0

    def __post_init__(self) -> None:
        boxes = floor_boxes(self.robot)
        if not boxes:
            raise InputError(f"floor clearance: no part of '{self.robot.description.name}' comes near the floor")
        approach = stopping_time(self.robot) if self.approach is None else self.approach
        checks.not_negative("floor clearance", approach=approach)
        object.__setattr__(self, "boxes", boxes)
        object.__setattr__(self, "approach", float(approach))

    @property
    def size(self) -> int:
        """How many rows."""
        return len(self.boxes)

    @property
    def groups(self) -> Mapping[str, slice]:
        """One row for each part."""
        return {box.name: slice(i, i + 1) for i, box in enumerate(self.boxes)}

    def __call__(self, s: Symbols) -> ca.SX:
        chain, ground = self.robot.base.chain(s.x), self.robot.base.ground
        rows = [b.height(*chain.frame_place(b.frame)) - (ground + b.margin) for b in self.boxes]
        heights = ca.vertcat(*rows)
        if not self.approach:
            return heights
        return heights + self.approach * ca.jtimes(heights, s.x, self.robot.dynamics()(s.x, s.u, s.parameters, s.mode))


def stopping_time(robot: RobotModel) -> float:
    """How long [s] the slowest joint of the arm takes from full speed to rest with :data:`BRAKING_SHARE` of its acceleration; 0 where
    nothing limits accelerations."""
    arm, limits = robot.input["arm"], robot.limits
    speeds = np.maximum(np.abs(limits.input_lower[arm]), np.abs(limits.input_upper[arm]))
    rates = limits.input_rate[arm]
    limited = np.isfinite(rates)
    return float(np.max(speeds[limited] / (BRAKING_SHARE * rates[limited]), initial=0.0))


def _absent(row: ca.SX) -> ca.SX:
    """1 where the parameters are zeros, a row without an obstacle; 0 for unit normals."""
    return 1.0 - ca.dot(row[:3], row[:3])


def _below(chain: Chain, frame: Frame, point: ca.SX, top: int) -> ca.SX:
    """A point of a frame (3) in the axes of a link above it: only the joints in between are part of it."""
    found, link = constant(frame.position) + constant(frame.rotation) @ point, frame.link
    while link != top:
        place = chain.places[link]
        found, link = place.offset + place.rotation @ found, chain.links[link].parent
    return found
