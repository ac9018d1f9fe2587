"""The nearest points of pairs of a robot's parts, with arrays that stay where they are: an MPC asks twice in every update."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from wbmpc.arrays import Array
from wbmpc.clearance.compilation import compiled, step
from wbmpc.clearance.depth_step import Hull, depth, hull_arrays, write_depth
from wbmpc.clearance.pairs_step import Gaps, bound, gap, place_solids, write_gap
from wbmpc.clearance.simplex_step import Work
from wbmpc.clearance.support_step import Solids
from wbmpc.clearance.table import SolidTable
from wbmpc.kernel.function import CompiledFunction
from wbmpc.kernel.ir import Floats, Integers, PointerCall
from wbmpc.kernel.step import Step, bind
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


@compiled
def nearest_own(n: int, parts: Parts, at_states: Places, solids: Solids, gaps: Gaps, hull: Hull, work: Floats) -> None:
    """Of the pairs of a robot's own solids, each of one of the rows, what is nearer than the ``distance`` (n, rows) of ``gaps`` on entry."""
    place, axes, shapes, rows = at_states.place, at_states.axes, parts.shapes, parts.rows
    for j in range(parts.pairs):
        a, b = parts.one[j], parts.two[j]
        for c in range(3):
            work[Work.V + c] = 0.0
        for k in range(n):
            i = k * rows + parts.row_of[j]
            limit = gaps.distance[i]
            pa, pb = 3 * (k * shapes + a), 3 * (k * shapes + b)
            if bound(solids, a, b, place, pa, axes, 3 * pa, place, pb, limit) >= limit:
                continue
            if bound(solids, b, a, place, pb, axes, 3 * pb, place, pa, limit) >= limit:
                continue
            d = gap(
                solids, a, b, place=place, pa=pa, axes=axes, ra=3 * pa, others=place, pb=pb, turns=axes, rb=3 * pb, limit=limit,
                work=work,
            )  # fmt: skip
            if d == -np.inf:
                d = depth(solids, a, b, pa, pb, place, axes, hull, work)
                if d < limit:
                    write_depth(solids, gaps, a, place, pa, d, i, work)
                for c in range(3):
                    work[Work.V + c] = 0.0
            elif d < limit:
                write_gap(solids, gaps, a, b, place, pa, d, i, work)


@step
def measure(
    n: int, reach: float, states: Floats, parts: Parts, at_states: Places, solids: Solids, gaps: Gaps, hull: Hull, work: Floats
) -> None:  # fmt: skip
    """Poses of frames at ``states`` (n, nx) by the function at ``address``, then :func:`nearest_own` within ``reach`` [m]."""
    address, nx, all_frames, frames, shapes, rows = (
        parts.address, parts.nx, parts.all_frames, parts.frames, parts.shapes, parts.rows,
    )  # fmt: skip
    poses, table, position, rotation = at_states.poses, at_states.table, at_states.position, at_states.rotation
    for k in range(n):
        table[0] = states.ctypes.data + 8 * k * nx
        table[1] = poses.ctypes.data + 8 * k * 12 * all_frames
        call2(address, table.ctypes.data, table.ctypes.data + 8)
        for f in range(frames):
            at, to = 12 * (k * all_frames + f), k * frames + f
            for i in range(3):
                position[3 * to + i] = poses[at + i]
            for i in range(9):
                rotation[9 * to + i] = poses[at + 3 + i]
    place_solids(
        n, shapes, frames, parts.frame_of, parts.local, parts.turn, position, rotation, at_states.place, at_states.axes
    )
    for i in range(n * rows):
        gaps.distance[i] = reach
    nearest_own(n, parts, at_states, solids, gaps, hull, work)


@step
def fill(
    n: int, all_frames: int, rows: int, reach: float, margins: Floats, poses: Floats, of_a: Integers, of_b: Integers, above: Integers,
    gaps: Gaps, parameters: Floats,
) -> None:  # fmt: skip
    """``parameters`` (n, rows, 10): normal in the axes of the frame ``above`` both, the nearest points in those of the pair's frames, the
    pair's margin; zeros beyond ``reach``, where ``distance`` becomes infinite."""
    distance, normal, own, other = gaps.distance, gaps.normal, gaps.own, gaps.other
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
                    a_c += (own[3 * i + j] - poses[a + j]) * poses[a + 3 + 3 * j + c]
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
        self._measure: Step = bind(measure, arrays, address=self._poses.address, **numbers)
        counts = {name: numbers[name] for name in ("n", "all_frames", "rows", "reach")}
        self._fill: Step = bind(fill, arrays, **counts)

    def measure(self, states: Array) -> None:
        """At states (n, nx or more: what a problem adds comes after the robot's own)."""
        if len(states) != len(self._states):
            self._allocate(len(states))
        self._states[:] = states[:, : self._nx]
        self._measure()
        self._fill()
