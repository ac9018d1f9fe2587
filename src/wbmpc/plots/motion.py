"""How a run moved, thinned out so far that it fits into its report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from wbmpc.arrays import Array

#: Pictures per second of a run at first; pictures in all, and numbers in them, at most: with more, every second one is left out.
RATE, PICTURES, NUMBERS = 10.0, 2400, 1_500_000
#: Points of a predicted path.
PATH = 11


@dataclass
class Part:
    """One loop of a run by its ``name``. ``shapes``: as in a recording's scene.json, with the place of their ``body`` among the bodies
    (-1: the world); ``robot``: the place of the robot's base. At ``times`` [s]: ``poses`` (n, 7) of all bodies and ``points`` (2 + 2 PATH, 3) in
    the world [m]: end effector, its reference, and the predicted paths of end effector and base (nan: there is none)."""

    name: str
    shapes: Sequence[Mapping[str, Any]]
    robot: int
    times: list[float] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    points: list[Array] = field(default_factory=list)


@dataclass
class Motion:
    """The ``parts`` of a run, with a picture every ``period`` [s]."""

    parts: list[Part] = field(default_factory=list)
    period: float = 1.0 / RATE

    def begin(self, name: str, scene: Mapping[str, Any]) -> None:
        """Another loop in a world; ``scene``: as in a recording's scene.json."""
        bodies = [body["name"] for body in scene["bodies"]]
        place = {name: k for k, name in enumerate(bodies)} | {"world": -1}
        shapes = [{**shape, "body": place[shape["body"]]} for shape in scene["shapes"]]
        self.parts.append(Part(name, shapes, place[scene["robot"]]))

    def due(self, t: float) -> bool:
        """Whether a picture is to be taken at time t [s] of the loop."""
        times = self.parts[-1].times
        return not times or t >= times[-1] + self.period - 1e-6

    def add(self, t: float, bodies: Array, points: Array) -> None:
        """A picture of the present loop, see :class:`Part`."""
        part = self.parts[-1]
        part.times.append(t)
        part.poses.append(np.asarray(bodies, np.float32))
        part.points.append(np.asarray(points, np.float32))
        count = sum(len(p.times) for p in self.parts)
        if count > PICTURES or count * (part.poses[-1].size + part.points[-1].size) > NUMBERS:
            self.period *= 2.0
            for p in self.parts:
                p.times, p.poses, p.points = p.times[::2], p.poses[::2], p.points[::2]


def picture_points(end_effector: Array, reference: Array | None, paths: Sequence[Array]) -> Array:
    """The points of a picture: of positions (3), and two paths (k, 3) of any number of points."""
    rows = np.full((2 + 2 * PATH, 3), np.nan)
    rows[0] = end_effector
    if reference is not None:
        rows[1] = reference
    for k, path in enumerate(paths):
        if len(path):
            chosen = np.linspace(0, len(path) - 1, PATH).round().astype(int)
            rows[2 + k * PATH : 2 + (k + 1) * PATH] = path[chosen]
    return rows
