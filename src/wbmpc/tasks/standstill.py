"""How long a robot stands away from its reference, and how long it goes back before somebody who comes."""

from __future__ import annotations

from collections import deque

import numpy as np

from wbmpc.arrays import Array

#: Who moves within this [m] stands.
STANDS = 0.05
#: Who goes back from an obstacle within this [m], with this share of its speed at least, is driven back by it; pauses [s] that do not count.
NEAR, SHARE, PAUSE = 0.3, 0.5, 0.3


class Standing:
    """``longest`` [s]: the longest time in which somebody who ``waits`` stayed near the place where it then was."""

    def __init__(self) -> None:
        self.longest = 0.0
        self._places: deque[tuple[float, Array]] = deque()

    def update(self, t: float, place: Array, waits: bool) -> None:
        """At ``t`` [s] it is at ``place`` (3) [m]."""
        if not waits:
            self._places.clear()
            return
        self._places.append((t, place.copy()))
        while np.linalg.norm(self._places[0][1] - place) > STANDS:
            self._places.popleft()
        self.longest = max(self.longest, t - self._places[0][0])


class DrivenBack:
    """``longest`` [s]: the longest time in which a robot went away from its goal before an obstacle that comes after it."""

    def __init__(self) -> None:
        self.longest = 0.0
        self._since, self._until = 0.0, -np.inf

    def update(self, t: float, velocity: Array, to_goal: Array, obstacle: Array, distance: float) -> None:
        """At ``t`` [s] a robot with ``velocity`` (2) [m/s], whose goal lies in the direction ``to_goal`` (2), is ``distance`` [m] from the nearest
        obstacle, whose velocity is ``obstacle`` (2)."""
        speed = float(np.linalg.norm(obstacle))
        along = float(velocity @ obstacle) / max(speed, 1e-9)
        if speed == 0.0 or distance > NEAR or along < SHARE * speed or velocity @ to_goal >= 0.0:
            return
        if t - self._until > PAUSE:
            self._since = t
        self._until = t
        self.longest = max(self.longest, t - self._since)
