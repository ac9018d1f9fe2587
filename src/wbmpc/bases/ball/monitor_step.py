"""Encoders of joints that stand still, compiled: see :class:`wbmpc.bases.ball.sensor_faults.EncoderMonitor`."""

from __future__ import annotations

from wbmpc.bases.ball.compilation import compiled, step
from wbmpc.kernel.ir import Floats


@compiled
def deadband(value: float, doubt: float) -> float:
    """What of a value is beyond ± ``doubt``."""
    return max(value - doubt, 0.0) - max(-value - doubt, 0.0)


@step
def has_jumped(n: int, arm: Floats, surprised: Floats, anchor: Floats, still: float) -> bool:
    """Whether a reading came as a surprise and moved. (One that did not move is what is looked for.)"""
    found = False
    for i in range(n):
        if surprised[i] > 0.0 and abs(arm[i] - anchor[i]) > still:
            found = True
    return found


@step
def detect_frozen(
    n: int, arm: Floats, speed: Floats, acceleration: Floats, anchor: Floats, believed: Floats, gone: Floats, then: Floats,
    stood: Floats, low: Floats, high: Floats, standing: Floats, still: float, expected: float, crawl: float, doubt: float,
    min_standstill: float, h: float, doubted: bool,
) -> int:  # fmt: skip
    """How many encoders, marked in ``standing`` (n), have not moved though they should have; counted anew while that is ``doubted``."""
    count = 0
    for i in range(n):
        stands = abs(arm[i] - anchor[i]) <= still and arm[i] >= low[i] and arm[i] <= high[i]
        if stands and not doubted:
            believed[i] += h * deadband(acceleration[i] - then[i], doubt)
            gone[i] += h * believed[i]
            stood[i] += h
        else:  # at the first reading too
            anchor[i], believed[i], then[i] = arm[i], deadband(speed[i], crawl), acceleration[i]
            gone[i], stood[i] = 0.0, 0.0
        standing[i] = 1.0 if abs(gone[i]) > expected and stood[i] >= min_standstill - 1e-9 else 0.0
        if standing[i] > 0.0:
            count += 1
    return count
