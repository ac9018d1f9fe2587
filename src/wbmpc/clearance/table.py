"""The solids of a robot, and of what is around it, as arrays for the compiled nearest points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wbmpc.arrays import Array
from wbmpc.clearance import pairs_step
from wbmpc.clearance.pairs_step import Around, Gaps
from wbmpc.clearance.simplex_step import Work
from wbmpc.clearance.support_step import Solids
from wbmpc.kernel.step import Backend
from wbmpc.obstacles.collider import Collider
from wbmpc.obstacles.geometry import RobotGeometry
from wbmpc.obstacles.solids import KINDS, Solid

Ints = NDArray[np.int64]
#: Closer than this [m] nearest points do not show a direction.
_TOUCH = 1e-7


def _flat(function: Callable[..., Any]) -> Callable[..., Any]:
    """A translated function called with arrays of any shape, contiguous ones: they are the memory that it sees."""
    return lambda *values: function(*[v.reshape(-1) if isinstance(v, np.ndarray) else v for v in values])


class Found(NamedTuple):
    """By state and what is asked of it (n, ...): ``distance`` [m], as it was asked for where nothing is nearer; ``normal`` (n, ..., 3) from the
    other solid to the robot's; nearest points ``own`` and ``other`` (n, ..., 3) in the world. ``compared``: pairs that were compared."""

    distance: Array
    normal: Array
    own: Array
    other: Array
    compared: int

    @classmethod
    def below(cls, limit: Array) -> Found:
        zeros = lambda: np.zeros((*limit.shape, 3))
        return cls(np.array(limit, float, order="C"), zeros(), zeros(), zeros(), 0)


class SolidTable:
    """A robot's solids, then others. ``backend``: machine code, or the same source as ordinary Python.

    Solids that overlap deeper than the radii about their cores are left to MuJoCo: a robot is hardly ever inside of an obstacle.
    """

    def __init__(self, geometry: RobotGeometry, backend: Backend = "compiled") -> None:
        self.geometry = geometry
        self._own = [s.solid for s in geometry.shapes]
        self._others: tuple[Solid, ...] = ()
        self._collider = Collider(self._own)
        self._local = np.ascontiguousarray([s.position for s in self._own], float)
        self._turn = np.ascontiguousarray([s.rotation for s in self._own], float)
        self._frame_of = geometry.frame_of.astype(np.int64)
        self._work = np.zeros(Work.SIZE)
        compiled = backend == "compiled"
        steps: Any = (pairs_step.place_solids, pairs_step.nearest)
        put, self._nearest = (f if compiled else f.interpreted for f in steps)
        self._put = _flat(put)
        self._fill()

    def _fill(self) -> None:
        solids = [*self._own, *self._others]
        self._kind = np.array([KINDS.index(s.kind) for s in solids], np.int64)
        self._size = np.array([s.size for s in solids], float).ravel()
        self._around = np.array([s.radius for s in solids])
        self._first = np.concatenate([[0], np.cumsum([len(s.vertices) for s in solids])]).astype(np.int64)
        self._vertices = np.concatenate([np.zeros(0), *[s.vertices.ravel() for s in solids]])

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """Of the robot's solids, by the names that steps have for them."""
        return {
            "kind": self._kind, "size": self._size, "around": self._around, "first": self._first, "vertices": self._vertices,
            "frame_of": self._frame_of, "local": self._local, "turn": self._turn, "work": self._work,
        }  # fmt: skip

    def load(self, others: Sequence[Solid]) -> None:
        """Take these solids, numbered after the robot's, in place of the last ones."""
        if len(others) != len(self._others) or any(a is not b for a, b in zip(others, self._others, strict=True)):
            self._others = tuple(others)
            self._fill()

    def put(self, position: Array, rotation: Array) -> tuple[Array, Array]:
        """Centers (n, s, 3) and axes (n, s, 3, 3) of the robot's solids at poses of its frames (n, F, 3), (n, F, 3, 3)."""
        n, s = len(position), len(self._own)
        place, axes = np.empty((n, s, 3)), np.empty((n, s, 3, 3))
        self._put(
            n, s, position.shape[1], self._frame_of, self._local, self._turn, np.ascontiguousarray(position),
            np.ascontiguousarray(rotation), place, axes,
        )  # fmt: skip
        return place, axes

    def nearest(
        self, position: Array, rotation: Array, others: Sequence[Solid], places: Array, turns: Array, limit: Array,
        deep: bool = True,
    ) -> Found:  # fmt: skip
        """Of the robot's frames at poses (n, F, ...) and other solids at ``places`` (n, o, 3) with axes ``turns`` (o, 3, 3), what is nearer
        than ``limit`` (n, F, o) [m]. ``deep``: whether to measure how deep solids overlap; their distance is 0 else."""
        self.load(others)
        out, (n, frames, count), s = Found.below(limit), limit.shape, len(self._own)
        place, axes = self.put(position, rotation)
        places, turns = np.ascontiguousarray(places), np.ascontiguousarray(turns)
        touching = np.empty(n * s * count, np.int64)
        solids = Solids(self._kind, self._size, self._around, self._first, self._vertices)
        gaps = Gaps(*(a.reshape(-1) for a in (out.distance, out.normal, out.own, out.other)))
        flat: list[Any] = [a.reshape(-1) for a in (self._frame_of, place, axes, places, turns, touching)]
        compared, touch = self._nearest(n, s, frames, count, solids, gaps, Around(*flat), self._work)
        if touch:
            k, a, o = np.unravel_index(touching[:touch], (n, s, count))
        if touch and not deep:
            np.minimum.at(out.distance, (k, self._frame_of[a], o), 0.0)
        elif touch:
            self._collider.load(others)
            for node in np.unique(k):
                self._collider.place(np.concatenate([place[node], places[node]]), np.concatenate([axes[node], turns]))
                for shape, other in zip(a[k == node].tolist(), o[k == node].tolist(), strict=True):
                    at = (int(node), int(self._frame_of[shape]), other)
                    self._deep(out, at, shape, s + other, place[node, shape] - places[node, other])
        return out._replace(compared=int(compared))

    def _deep(self, out: Found, at: tuple[int, ...], a: int, b: int, apart: Array) -> None:
        """A pair that touches, where it is deeper than what was found at an entry; ``apart``: its direction where points show none."""
        d = self._collider.distance(a, b, float(out.distance[at]))
        if d >= out.distance[at]:
            return
        p, q = self._collider.points[:3], self._collider.points[3:]
        away = apart if abs(d) <= _TOUCH else np.where(d < 0.0, -1.0, 1.0) * (p - q)
        length = float(np.linalg.norm(away))
        out.distance[at], out.own[at], out.other[at] = d, p, q
        out.normal[at] = away / length if length > 0.0 else [0.0, 0.0, 1.0]
