"""How the robot stands, as markers: its feet's support polygon, the zero-moment point, and where both are about to be."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from wbmpc.arrays import Array
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.policy import Policy
from wbmpc.ros2.convert import header
from wbmpc.stability import StanceOf, support_polygon

#: Numbers of visualization_msgs/Marker.
LINE_STRIP, SPHERE = 4, 2
#: Width of lines, size of points [m]; how many moments of the plan are shown.
LINE, POINT, MOMENTS = 0.01, 0.05, 5
#: A base without feet of its own stands on one point, shown as a ring: its radius as a share of the base's height.
RING = 0.3
GREEN, RED, GRAY = (0.1, 0.7, 0.2, 1.0), (0.9, 0.1, 0.1, 1.0), (0.5, 0.5, 0.5, 0.5)


class Footprint:
    """Markers of a robot's states, in the frame ``world``. ``yield_to_controller`` is called before each state, which takes a tenth of a
    millisecond."""

    def __init__(self, robot: RobotModel, world: str, yield_to_controller: Callable[[], None] = lambda: None) -> None:
        self.robot, self.world, self._yield_to_controller = robot, world, yield_to_controller
        self._stance = None if robot.base.footprint is None else StanceOf(robot)

    def markers(
        self, now: float, x: Array, u: Array | None, wrench: Array, policy: Policy | None
    ) -> list[dict[str, Any]]:
        """At the state x (nx) with the inputs u (nu) and the world's ``wrench`` (6) on the end effector; and along a policy."""
        stands, point = self.stance(x, u, wrench)
        inside = self._stance is None or _inside(stands, point)
        found = [
            self._line(now, "support", 0, stands, GREEN),
            self._dot(now, "zmp", point, GREEN if inside else RED),
        ]
        if policy is None:
            return found
        last = len(policy.u) - 1
        for i, k in enumerate(np.linspace(0, last, MOMENTS + 1, dtype=int)[1:]):
            polygon, _ = self.stance(policy.x[k], policy.u[k], wrench)
            found.append(self._line(now, "predicted", i, polygon, GRAY))
        return found

    def stance(self, x: Array, u: Array | None, wrench: Array) -> tuple[Array, Array]:
        """Corners (n, 2) of the support and the zero-moment point (2) [m] in the world."""
        self._yield_to_controller()
        place = x[self.robot.state["base"]][:2]
        if self._stance is None:
            angles = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
            ring = RING * self.robot.base.body_height * np.stack([np.cos(angles), np.sin(angles)], axis=1)
            return place + ring, place
        s = self._stance(x, wrench, u=u)
        return place + support_polygon(s.feet), place + s.zmp

    def _line(self, now: float, space: str, number: int, corners: Array, color: tuple[float, ...]) -> dict[str, Any]:
        points = [{"x": float(a), "y": float(b), "z": 0.0} for a, b in [*corners, corners[0]]]
        return self._marker(now, space, number, LINE_STRIP, color) | {"scale": {"x": LINE}, "points": points}

    def _dot(self, now: float, space: str, at: Array, color: tuple[float, ...]) -> dict[str, Any]:
        if not np.isfinite(at).all():  # nothing presses on the floor
            return self._marker(now, space, 0, SPHERE, color) | {"action": 2}
        pose = {"position": {"x": float(at[0]), "y": float(at[1])}}
        return self._marker(now, space, 0, SPHERE, color) | {"scale": dict.fromkeys("xyz", POINT), "pose": pose}

    def _marker(self, now: float, space: str, number: int, kind: int, color: tuple[float, ...]) -> dict[str, Any]:
        rgba = dict(zip("rgba", color, strict=True))
        return {"header": header(now, self.world), "ns": space, "id": number, "type": kind, "color": rgba}


def _inside(corners: Array, point: Array) -> bool:
    edges = np.roll(corners, -1, axis=0) - corners
    to = point - corners
    sides = edges[:, 0] * to[:, 1] - edges[:, 1] * to[:, 0]
    return bool(np.all(sides > 0.0) or np.all(sides < 0.0))
