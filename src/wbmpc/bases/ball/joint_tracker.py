"""Angles and rates of joints from their encoders alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.arrays import Array
from wbmpc.bases.ball.gap import GAP
from wbmpc.bases.ball.joint_step import Joints, track
from wbmpc.checks import not_negative, numbers, positive, positive_time, scales
from wbmpc.kernel.step import Backend, bind, zeros

#: An arm with a joint that is faster than this times its speed limit is flung, and turns the base with it: the inertial unit
#: is right then, however far from the message before. (Seen: 34 rad/s where the limit is 4, and 2 rad/s of yaw in 2.5 ms.)
FASTER = 2.0


class JointTracker:
    """Angles (n) [rad] and rates (n) [rad/s] of joints from encoders alone: a Kalman filter of each joint, whose
    acceleration is white noise of density ``acceleration`` [rad/s²/√Hz]. Readings are ``age`` ± ``jitter`` [s] old.

    ``reading`` (n): the last ones that counted; a joint ``jumped`` (n) if its own did not: beyond what joints with a limit of their
    ``speed`` (n) [rad/s] can do in the time since, or with the jump before it: nearer to that than to where the joint was. So a
    step that is never undone never counts, however far the joint could have moved meanwhile; one that is undone, and a joint
    of which no message came for a while, count by their distance. Those of ``surprised`` (n) are far from what was expected:
    their rates are in doubt. ``size``: n; ``arrays``: everything by its name above."""

    def __init__(
        self, angles: ArrayLike, encoder: float, age: float, jitter: float, acceleration: float = 3.0,
        speed: ArrayLike = np.inf, backend: Backend = "compiled",
    ) -> None:  # fmt: skip
        who = "joint tracker"
        not_negative(who, encoder=encoder, age=age, jitter=jitter)
        positive(who, acceleration=acceleration)
        start = numbers(who, "angles", angles, np.size(angles))
        n = self.size = start.size
        a = self.arrays = zeros(Joints, n)
        a["speed"] = np.array(np.broadcast_to(scales(who, "speed", speed), n), float)
        a["angle"][:], a["raw"][:], a["aa"][:], a["rr"][:] = start, start, 1e-2, 1e-2
        self._first, self.any_jumped = True, False
        constants = {"encoder": encoder, "age": age, "jitter": jitter, "acceleration": acceleration}
        self._track = bind(track, a, backend, n=n, **constants)

    @property
    def angle(self) -> Array:
        """(n) [rad]."""
        return self.arrays["angle"].copy()

    @property
    def rate(self) -> Array:
        """(n) [rad/s]."""
        return self.arrays["rate"].copy()

    @property
    def first(self) -> bool:
        """Whether there has been no reading."""
        return self._first

    @property
    def jumped(self) -> NDArray[np.bool_]:
        """(n) whether a joint's last reading did not count."""
        return np.asarray(self.arrays["jumped"] > 0.0)

    @property
    def surprised(self) -> NDArray[np.bool_]:
        """(n) whether a joint's last reading was far from what was expected."""
        return np.asarray(self.arrays["surprised"] > 0.0)

    @property
    def flung(self) -> bool:
        """Whether something moves a joint faster than its drive can (:data:`FASTER`)."""
        return bool((np.abs(self.arrays["rate"]) > FASTER * self.arrays["speed"]).any())

    def update(self, interval: float, reading: Array) -> None:
        """``interval`` [s] since the ``reading`` (n) [rad] before. Raises :class:`InputError` for numbers that cannot be."""
        positive_time("joint tracker", interval)
        self.take_in(interval, numbers("joint tracker", "reading", reading, self.size))

    def take_in(self, interval: float, reading: Array) -> None:
        """As :meth:`update`, of numbers that have been checked."""
        if interval > GAP:
            self._restart(reading)
        else:
            self.arrays["given"][:] = reading
            self.any_jumped = self._track(interval, self._first)
        self._first = False

    def _restart(self, reading: Array) -> None:
        """After a gap the joints are at their measured positions, and their speeds are unknown."""
        a = self.arrays
        for name in ("angle", "reading", "raw"):
            a[name][:] = reading
        for name in ("rate", "ar", "jumped", "uncounted", "moved"):
            a[name][:] = 0.0
        a["aa"][:], a["rr"][:], a["surprised"][:], self.any_jumped = 1e-2, 1.0, 1.0, False
