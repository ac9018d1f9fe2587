"""The nearest points of pairs of a robot's parts, with arrays that stay where they are: an MPC asks twice in every update."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from wbmpc.arrays import Array
from wbmpc.clearance import own_step
from wbmpc.clearance.table import SolidTable
from wbmpc.kernel.function import CompiledFunction
from wbmpc.kernel.step import Step, bind
from wbmpc.obstacles.geometry import RobotGeometry, common_link, frame_function, link_frames
from wbmpc.ocp.clearance_residuals import SELF_WIDTH


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
        self._poses = CompiledFunction(frame_function(robot, [*frames, *link_frames(links)]))
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

    def _allocate(self, n: int) -> None:
        """Arrays for n states, bound to the steps."""
        shapes, frames, rows, pairs = (
            len(self._table.arrays["frame_of"]),
            self._frames,
            self.rows,
            len(self._index["row_of"]),
        )
        own = len(self._table.geometry.frames)
        zeros = lambda *shape: np.zeros((n, *shape))
        self._states, self.distance, self.parameters = zeros(self._nx), zeros(rows), zeros(rows * SELF_WIDTH)
        self._normal, self._own, self._other = (zeros(rows, 3) for _ in range(3))
        self._place, self._axes, self._touching = zeros(shapes, 3), zeros(shapes, 9), np.zeros(n * pairs, np.int64)
        arrays = {
            **self._table.arrays, **self._index, "states": self._states, "poses": zeros(frames, 12),
            "table": np.zeros(2, np.int64), "position": zeros(own, 3), "rotation": zeros(own, 9), "place": self._place,
            "axes": self._axes, "distance": self.distance, "normal": self._normal, "own": self._own, "other": self._other,
            "touching": self._touching, "parameters": self.parameters, "margins": self._margins,
        }  # fmt: skip
        counts: dict[str, Any] = {"n": n, "all_frames": frames, "rows": rows, "reach": self._reach}
        self._measure: Step = bind(
            own_step.measure, arrays, address=self._poses.address, nx=self._nx, frames=own, shapes=shapes, pairs=pairs, **counts
        )  # fmt: skip
        self._fill: Step = bind(own_step.fill, arrays, **counts)

    def measure(self, states: Array) -> None:
        """At states (n, nx or more: what a problem adds comes after the robot's own)."""
        if len(states) != len(self._states):
            self._allocate(len(states))
        self._states[:] = states[:, : self._nx]
        touch = self._measure()
        if touch:
            self._settle(touch)
        self._fill()

    def _settle(self, touch: int) -> None:
        """How deep pairs are that touch."""
        found = self._touching[:touch]
        n, (row, one, two) = len(self._states), (self._index[k] for k in ("row_of", "one", "two"))
        k, pair = np.unravel_index(found, (n, len(row)))
        self._table.settle(
            (self.distance, self._normal, self._own, self._other), self._place, self._axes.reshape(n, -1, 3, 3), k, row[pair],
            one[pair], two[pair],
        )  # fmt: skip
