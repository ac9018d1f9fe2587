"""The nearest points of pairs of a robot's parts, with arrays that stay where they are: an MPC asks twice in every update."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from wbmpc.arrays import Array
from wbmpc.clearance.compilation import compiled, step
from wbmpc.clearance.depth_step import Hull, depth, hull_arrays, write_depth
from wbmpc.clearance.pairs_step import Body, Gaps, bound, gap, place_solids, write_gap
from wbmpc.clearance.simplex_step import Work
from wbmpc.clearance.support_step import Solids
from wbmpc.clearance.table import SolidTable
from wbmpc.kernel.function import CompiledFunction
from wbmpc.kernel.ir import Floats, Integers, PointerCall
from wbmpc.kernel.step import bind
from wbmpc.obstacles.geometry import RobotGeometry, common_link, frame_function, link_frames
from wbmpc.ocp.clearance_residuals import SELF_WIDTH

call2 = PointerCall(2)


class Parts(NamedTuple):
    """A robot's own parts, and which pairs of them are compared."""

    address: int  # of the function that gives the poses of frames
    nx: int  # numbers of a state
    all_frames: int  # with those in whose axes pairs are compared
    frames: int
    shapes: int
    rows: int  # pairs of frames
    pairs: int  # pairs of shapes
    frame_of: Integers  # (shapes)
    row_of: Integers  # (pairs)
    one: Integers  # (pairs), shapes
    two: Integers  # (pairs)
    local: Floats  # (shapes, 3) [m], in axes of their frames
    turn: Floats  # (shapes, 3, 3)


class Places(NamedTuple):
    """Where these are at n states."""

    poses: Floats  # (n, all_frames, 12), position [m] and rotation
    table: Integers  # (2), addresses of the function's argument and result
    position: Floats  # (n, frames, 3) [m]
    rotation: Floats  # (n, frames, 3, 3)
    place: Floats  # (n, shapes, 3) [m]
    axes: Floats  # (n, shapes, 3, 3)


class Compared(NamedTuple):
    """Pairs of a robot's own parts: what they are, where they are, and what is found."""

    parts: Parts
    places: Places
    solids: Solids
    gaps: Gaps
    hull: Hull


@compiled
def nearest_own(n: int, own: Compared, work: Floats) -> None:
    """Of the pairs of a robot's own solids, each of one of the rows, what is nearer than the ``distance`` (n, rows) of ``gaps`` on entry."""
    place, axes, shapes, rows = own.places.place, own.places.axes, own.parts.shapes, own.parts.rows
    for j in range(own.parts.pairs):
        a, b = own.parts.one[j], own.parts.two[j]
        for c in range(3):
            work[Work.V + c] = 0.0
        for k in range(n):
            i = k * rows + own.parts.row_of[j]
            p, q = k * shapes + a, k * shapes + b
            nearest_of(own, Body(a, place, 3 * p, axes, 9 * p), Body(b, place, 3 * q, axes, 9 * q), i, work)


@compiled
def nearest_of(own: Compared, a: Body, b: Body, i: int, work: Floats) -> None:
    """Of one pair, to entry ``i``."""
    limit = own.gaps.distance[i]
    if bound(own.solids, a, b, limit) >= limit or bound(own.solids, b, a, limit) >= limit:
        return
    d = gap(own.solids, a, b, limit, work)
    if d == -np.inf:
        d = depth(own.solids, a, b, own.hull, work)
        if d < limit:
            write_depth(own.solids, own.gaps, a, d, i, work)
        for c in range(3):
            work[Work.V + c] = 0.0
    elif d < limit:
        write_gap(own.solids, own.gaps, a, b, d, i, work)


@step
def measure(n: int, reach: float, states: Floats, own: Compared, work: Floats) -> None:
    """Poses of frames at ``states`` (n, nx) by the function at ``address``, then :func:`nearest_own` within ``reach`` [m]."""
    poses, table, position, rotation = own.places.poses, own.places.table, own.places.position, own.places.rotation
    frames, shapes, all_frames = own.parts.frames, own.parts.shapes, own.parts.all_frames
    for k in range(n):
        table[0] = states.ctypes.data + 8 * k * own.parts.nx
        table[1] = poses.ctypes.data + 8 * k * 12 * all_frames
        call2(own.parts.address, table.ctypes.data, table.ctypes.data + 8)
        for f in range(frames):
            at, to = 12 * (k * all_frames + f), k * frames + f
            for i in range(3):
                position[3 * to + i] = poses[at + i]
            for i in range(9):
                rotation[9 * to + i] = poses[at + 3 + i]
    place_solids(
        n, shapes, frames, own.parts.frame_of, own.parts.local, own.parts.turn, position, rotation, own.places.place,
        own.places.axes,
    )  # fmt: skip
    for i in range(n * own.parts.rows):
        own.gaps.distance[i] = reach
    nearest_own(n, own, work)


@step
def fill(
    n: int, reach: float, margins: Floats, own: Compared, of_a: Integers, of_b: Integers, above: Integers, parameters: Floats
) -> None:  # fmt: skip
    """``parameters`` (n, rows, 10): normal in the axes of the frame ``above`` both, the nearest points in those of the pair's frames, the
    pair's margin; zeros beyond ``reach``, where ``distance`` becomes infinite."""
    distance, normal, near, other = own.gaps.distance, own.gaps.normal, own.gaps.own, own.gaps.other
    poses, all_frames, rows = own.places.poses, own.parts.all_frames, own.parts.rows
    for k in range(n):
        for r in range(rows):
            i, to = k * rows + r, 10 * (k * rows + r)
            a, b = 12 * (k * all_frames + of_a[r]), 12 * (k * all_frames + of_b[r])
            top = 12 * (k * all_frames + above[r])
            there = distance[i] < reach
            for c in range(3):
                n_c, a_c, b_c = 0.0, 0.0, 0.0
                for j in range(3):
                    n_c += normal[3 * i + j] * poses[top + 3 + 3 * j + c]
                    a_c += (near[3 * i + j] - poses[a + j]) * poses[a + 3 + 3 * j + c]
                    b_c += (other[3 * i + j] - poses[b + j]) * poses[b + 3 + 3 * j + c]
                parameters[to + c] = n_c if there else 0.0
                parameters[to + 3 + c] = a_c if there else 0.0
                parameters[to + 6 + c] = b_c if there else 0.0
            parameters[to + 9] = margins[r] if there else 0.0
            if not there:
                distance[i] = np.inf


class OwnPairs:
    """Of ``pairs`` of a geometry's frames what is nearer than ``reach`` [m]: ``distance`` (n, rows) [m], infinite elsewhere, and
    ``parameters`` (n, rows · :data:`SELF_WIDTH`) of rows that keep ``margins`` (rows) [m]. Both belong to the last :meth:`measure`."""

    def __init__(self, geometry: RobotGeometry, pairs: Sequence[tuple[int, int]], reach: float, margins: Array) -> None:
        self._made_of = geometry, pairs, reach, margins
        robot, self.rows, self._reach, self._margins = geometry.robot, len(pairs), reach, margins
        self._table, self._nx = SolidTable(geometry), robot.state.size
        frames = [robot.tree.frames[f] for f in geometry.frames]
        #: links in whose axes pairs are compared: no joint above them moves one against the other
        tops = [common_link(robot, frames[a].link, frames[b].link) for a, b in pairs]
        links = sorted(set(tops))
        #: the poses of frames and links, of a state of the robot
        self.poses = frame_function(robot, [*frames, *link_frames(links)])
        self._poses = CompiledFunction(self.poses)
        self._frames = len(frames) + len(links)
        of = [geometry.fixed_to(f) for f in geometry.frames]
        listed = np.array([(r, i, j) for r, (a, b) in enumerate(pairs) for i in of[a] for j in of[b]], np.int64)
        a, b = np.array(pairs, np.int64).T
        self._index = {
            "row_of": listed[:, 0].copy(), "one": listed[:, 1].copy(), "two": listed[:, 2].copy(), "of_a": a.copy(),
            "of_b": b.copy(), "above": len(frames) + np.searchsorted(links, tops).astype(np.int64),
        }  # fmt: skip
        self._allocate(1)

    def __reduce__(self) -> Any:
        """Addresses do not leave their process."""
        return OwnPairs, self._made_of

    def memory(self, n: int) -> tuple[dict[str, np.ndarray], dict[str, int | float]]:
        """Arrays for n states, and numbers, by the names of the arguments of :func:`measure` and :func:`fill`."""
        frames, rows, own = self._frames, self.rows, len(self._table.geometry.frames)
        shapes, pairs = len(self._table.arrays["frame_of"]), len(self._index["row_of"])
        zeros = lambda *shape: np.zeros((n, *shape))
        arrays = {
            **self._table.arrays, **self._index, **hull_arrays(), "states": zeros(self._nx), "poses": zeros(frames, 12),
            "table": np.zeros(2, np.int64), "position": zeros(own, 3), "rotation": zeros(own, 9), "place": zeros(shapes, 3),
            "axes": zeros(shapes, 9), "distance": zeros(rows), "normal": zeros(rows, 3), "own": zeros(rows, 3),
            "other": zeros(rows, 3), "parameters": zeros(rows * SELF_WIDTH), "margins": self._margins,
        }  # fmt: skip
        numbers: dict[str, int | float] = {
            "n": n, "all_frames": frames, "rows": rows, "reach": self._reach, "nx": self._nx, "frames": own, "shapes": shapes,
            "pairs": pairs,
        }  # fmt: skip
        return arrays, numbers

    def _allocate(self, n: int) -> None:
        arrays, numbers = self.memory(n)
        self._states, self.distance, self.parameters = arrays["states"], arrays["distance"], arrays["parameters"]
        numbers["address"] = self._poses.address
        self._measure, self._fill = bind(measure, arrays, **numbers), bind(fill, arrays, **numbers)

    def measure(self, states: Array) -> None:
        """At states (n, nx or more: what a problem adds comes after the robot's own)."""
        if len(states) != len(self._states):
            self._allocate(len(states))
        self._states[:] = states[:, : self._nx]
        self._measure()
        self._fill()
