"""Angles and rates of joints from their encoders alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.arrays import Array
from wbmpc.bases.ball.compilation import step
from wbmpc.bases.ball.filter import GAP
from wbmpc.checks import not_negative, numbers, positive_time, scales
from wbmpc.kernel.ir import Floats
from wbmpc.kernel.step import bind, zeros

#: A joint's reading jumps if it is farther from the last one that counted, and from where the joint was going, than this often
#: its speed limit allows, and this [rad] more: an arm that is flung by a hit moves faster than its drives can (0.27 rad from one
#: message to the next, through its stops, under 900 N).
SPEED_FACTOR, SPEED_REST = 4.0, 0.2
#: Two steps [rad] in a row of this size, the same way, are a motion.
FLUNG = 0.03
#: Rates are in doubt after a reading this far [rad] from the expected one, and farther by what its age may err by [s].
SURPRISE, LATE = 1e-3, 2e-3
#: Density of unknown accelerations [rad/s²/√Hz].
ACCELERATION = 3.0


class Joints(NamedTuple):
    """Joints (n), their encoders, and what is known of them."""

    n: int
    angle: Floats  # (n) [rad]
    rate: Floats  # (n) [rad/s]
    aa: Floats  # (n), covariances of angle and rate
    ar: Floats
    rr: Floats
    given: Floats  # (n) [rad], the encoders' readings
    reading: Floats  # (n) [rad], the last that counted
    raw: Floats  # (n) [rad], the last
    moved: Floats  # (n) [rad], its distance from the one before
    uncounted: Floats  # (n) [s], since a reading counted
    jumped: Floats  # (n), 1 where the last reading does not count
    surprised: Floats  # (n), 1 where it was far from the expected one
    speed: Floats  # (n) [rad/s], limits
    encoder: float  # deviation of a reading [rad]
    age: float  # mean age of readings [s]
    jitter: float  # deviation of the age [s]


@step
def track(j: Joints, h: float, first: bool) -> bool:
    """The readings ``given`` come ``h`` [s] after the message before; ``first``: there was none. Whether one of them does not count."""
    density, any_jumps = ACCELERATION**2, False
    for i in range(j.n):
        a = j.aa[i] + 2.0 * h * j.ar[i] + h * h * j.rr[i] + density * h * h * h / 3.0
        b, c = j.ar[i] + h * j.rr[i] + density * h * h / 2.0, j.rr[i] + density * h
        expected, new = j.angle[i] + h * j.rate[i], j.given[i]
        variance = a + j.encoder**2 + (j.jitter * j.rate[i]) ** 2
        wrong = new + j.age * j.rate[i] - expected
        j.surprised[i] = 1.0 if abs(wrong) > SURPRISE + LATE * abs(j.rate[i]) else 0.0
        if first:  # the start is not known as well as what follows
            j.reading[i], j.raw[i] = new, new
        # far from the motion that there was as well, and not on its way: an arm that is flung goes on
        off = min(abs(new - j.reading[i]), abs(wrong))
        had_jumped, before = j.jumped[i] > 0.0, j.moved[i]
        j.uncounted[i] = j.uncounted[i] + h if had_jumped else h
        now = new - j.raw[i]
        j.moved[i], j.raw[i] = now, new
        going = min(abs(before), abs(now)) > FLUNG and before * now > 0.0
        stays = had_jumped and abs(now) < off
        jumps = (stays or off > (j.uncounted[i] + LATE) * SPEED_FACTOR * j.speed[i] + SPEED_REST) and not going
        j.jumped[i], any_jumps = 1.0 if jumps else 0.0, any_jumps or jumps
        gain, gain_rate = 0.0, 0.0
        if not jumps:
            j.reading[i], gain, gain_rate = new, a / variance, b / variance
        j.angle[i], j.rate[i] = expected + gain * wrong, j.rate[i] + gain_rate * wrong
        j.aa[i], j.ar[i], j.rr[i] = (1.0 - gain) * a, (1.0 - gain) * b, c - gain_rate * b
    return any_jumps


#: An arm with a joint that is faster than this times its speed limit is flung, and turns the base with it: the inertial unit
#: is right then, however far from the message before. (Seen: 34 rad/s where the limit is 4, and 2 rad/s of yaw in 2.5 ms.)
FASTER = 2.0


class JointTracker:
    """Angles (n) [rad] and rates (n) [rad/s] of joints from encoders alone: a Kalman filter of each joint, whose
    acceleration is white noise of density :data:`ACCELERATION`. Readings are ``age`` ± ``jitter`` [s] old.

    ``reading`` (n): the last ones that counted; a joint ``jumped`` (n) if its own did not: beyond what joints with a limit of their
    ``speed`` (n) [rad/s] can do in the time since, or with the jump before it: nearer to that than to where the joint was. So a
    step that is never undone never counts, however far the joint could have moved meanwhile; one that is undone, and a joint
    of which no message came for a while, count by their distance. Those of ``surprised`` (n) are far from what was expected:
    their rates are in doubt. ``size``: n; ``arrays``: everything by its name above."""

    def __init__(
        self, angles: ArrayLike, encoder: float, age: float, jitter: float,
        speed: ArrayLike = np.inf,
    ) -> None:  # fmt: skip
        who = "joint tracker"
        not_negative(who, encoder=encoder, age=age, jitter=jitter)
        start = numbers(who, "angles", angles, np.size(angles))
        n = self.size = start.size
        a = self.arrays = zeros(Joints, n)
        a["speed"] = np.array(np.broadcast_to(scales(who, "speed", speed), n), float)
        a["angle"][:], a["raw"][:], a["aa"][:], a["rr"][:] = start, start, 1e-2, 1e-2
        self._first, self.any_jumped = True, False
        constants = {"encoder": encoder, "age": age, "jitter": jitter}
        self._track = bind(track, a, n=n, **constants)

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
