"""Encoders of joints that stand still, compiled: see :class:`wbmpc.bases.ball.sensor_faults.EncoderMonitor`."""

from __future__ import annotations

from typing import NamedTuple

from wbmpc.bases.ball.compilation import compiled, step
from wbmpc.kernel.ir import Floats


@compiled
def deadband(value: float, doubt: float) -> float:
    """What of a value is beyond ± ``doubt``."""
    return max(value - doubt, 0.0) - max(-value - doubt, 0.0)


class Encoders(NamedTuple):
    """Joints (n), their encoders, and what a monitor remembers of them."""

    n: int
    arm: Floats  # (n) [rad], readings
    surprised: Floats  # (n), 1 for readings that are far from the expected ones
    speed: Floats  # (n) [rad/s], of the joints by their tracker
    acceleration: Floats  # (n) [rad/s²], by the model
    anchor: Floats  # (n) [rad], where an encoder stands
    believed: Floats  # (n) [rad/s], by how much the joint must be faster than at the anchor
    gone: Floats  # (n) [rad], how far it must have moved
    then: Floats  # (n) [rad/s²], acceleration at the anchor
    stood: Floats  # (n) [s]
    low: Floats  # (n) [rad], readings beyond which a joint rests at a stop
    high: Floats
    standing: Floats  # (n), 1 for encoders that should have moved
    still: float  # [rad], motion that is none
    expected: float  # [rad], motion that must be seen
    crawl: float  # [rad/s], speed that is none
    doubt: float  # [rad/s²], of the accelerations
    min_standstill: float  # [s]


@step
def watch(e: Encoders, h: float, doubted: bool, known: bool) -> tuple[bool, int]:
    """Whether a reading came as a surprise and moved (one that did not move is what is looked for); how many encoders, marked in
    ``standing`` (n), have not moved though they should have: counted again after such a reading and while that is ``doubted``, not
    at all while accelerations are not ``known``."""
    surprise, count = False, 0
    for i in range(e.n):
        if e.surprised[i] > 0.0 and abs(e.arm[i] - e.anchor[i]) > e.still:
            surprise = True
    if not known:
        return surprise, 0
    for i in range(e.n):
        stands = abs(e.arm[i] - e.anchor[i]) <= e.still and e.arm[i] >= e.low[i] and e.arm[i] <= e.high[i]
        if stands and not (doubted or surprise):
            e.believed[i] += h * deadband(e.acceleration[i] - e.then[i], e.doubt)
            e.gone[i] += h * e.believed[i]
            e.stood[i] += h
        else:  # at the first reading too
            e.anchor[i], e.believed[i], e.then[i] = e.arm[i], deadband(e.speed[i], e.crawl), e.acceleration[i]
            e.gone[i], e.stood[i] = 0.0, 0.0
        e.standing[i] = 1.0 if abs(e.gone[i]) > e.expected and e.stood[i] >= e.min_standstill - 1e-9 else 0.0
        if e.standing[i] > 0.0:
            count += 1
    return surprise, count
