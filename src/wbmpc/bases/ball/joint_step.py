"""One message of :class:`wbmpc.bases.ball.joint_tracker.JointTracker`, compiled."""

from __future__ import annotations

from typing import NamedTuple

from wbmpc.bases.ball.compilation import step
from wbmpc.kernel.ir import Floats

#: A joint's reading jumps if it is farther from the last one that counted, and from where the joint was going, than this often
#: its speed limit allows, and this [rad] more: an arm that is flung by a hit moves faster than its drives can (0.27 rad from one
#: message to the next, through its stops, under 900 N).
SPEED_FACTOR, SPEED_REST = 4.0, 0.2
#: Two steps [rad] in a row of this size, the same way, are a motion.
FLUNG = 0.03
#: Rates are in doubt after a reading this far [rad] from the expected one, and farther by what its age may err by [s].
SURPRISE, LATE = 1e-3, 2e-3


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
    acceleration: float  # density of unknown accelerations [rad/s²/√Hz]


@step
def track(j: Joints, h: float, first: bool) -> bool:
    """The readings ``given`` come ``h`` [s] after the message before; ``first``: there was none. Whether one of them does not count."""
    density, any_jumps = j.acceleration**2, False
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
