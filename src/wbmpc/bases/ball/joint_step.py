"""One message of :class:`wbmpc.bases.ball.joint_tracker.JointTracker`, compiled."""

from __future__ import annotations

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


@step
def track(
    n: int, angle: Floats, rate: Floats, reading: Floats, raw: Floats, moved: Floats, uncounted: Floats, aa: Floats,
    ar: Floats, rr: Floats, jumped: Floats, surprised: Floats, speed: Floats, given: Floats, encoder: float, age: float,
    jitter: float, acceleration: float, h: float, first: bool,
) -> None:  # fmt: skip
    """``given`` (n) [rad] are read ``h`` [s] after the message before; ``first``: there was none. ``aa``, ``ar``, ``rr``: covariances
    of angle and rate; ``raw``: the last reading, ``moved`` its distance from the one before, ``uncounted`` [s] since a reading
    counted."""
    density = acceleration**2
    for i in range(n):
        a = aa[i] + 2.0 * h * ar[i] + h * h * rr[i] + density * h * h * h / 3.0
        b, c = ar[i] + h * rr[i] + density * h * h / 2.0, rr[i] + density * h
        expected, new = angle[i] + h * rate[i], given[i]
        variance = a + encoder**2 + (jitter * rate[i]) ** 2
        wrong = new + age * rate[i] - expected
        surprised[i] = 1.0 if abs(wrong) > SURPRISE + LATE * abs(rate[i]) else 0.0
        if first:  # the start is not known as well as what follows
            reading[i], raw[i] = new, new
        # far from the motion that there was as well, and not on its way: an arm that is flung goes on
        off = min(abs(new - reading[i]), abs(wrong))
        had_jumped, before = jumped[i] > 0.0, moved[i]
        uncounted[i] = uncounted[i] + h if had_jumped else h
        now = new - raw[i]
        moved[i], raw[i] = now, new
        going = min(abs(before), abs(now)) > FLUNG and before * now > 0.0
        stays = had_jumped and abs(now) < off
        jumps = (stays or off > (uncounted[i] + LATE) * SPEED_FACTOR * speed[i] + SPEED_REST) and not going
        jumped[i] = 1.0 if jumps else 0.0
        gain, gain_rate = 0.0, 0.0
        if not jumps:
            reading[i], gain, gain_rate = new, a / variance, b / variance
        angle[i], rate[i] = expected + gain * wrong, rate[i] + gain_rate * wrong
        aa[i], ar[i], rr[i] = (1.0 - gain) * a, (1.0 - gain) * b, c - gain_rate * b
