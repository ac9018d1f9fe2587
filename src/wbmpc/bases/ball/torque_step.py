"""Torques within limits, compiled: see :class:`wbmpc.bases.ball.torque_limits.TorqueLimits`."""

from __future__ import annotations

from wbmpc.bases.ball.compilation import step
from wbmpc.kernel.ir import Floats


@step
def limit_torques(
    n: int,
    size: int,
    torque: Floats,
    out: Floats,
    along: Floats,
    limit: Floats,
    at: Floats,
    room: Floats,
    largest: float,
) -> None:
    """``torque`` (size) [N m] of n wheels and joints within ``limit`` (size), into ``out``; ``along`` (n): direction of spin, at most
    ``largest`` along it. Spins that wheel i can have beside c times what leans are -c at_i ± room_i; so is what there may be of it."""
    spin = 0.0
    for i in range(n):
        spin += along[i] * torque[i]
    at[n], room[n] = 0.0, largest
    for i in range(n):
        out[i] = torque[i] - spin * along[i]
        at[i], room[i] = out[i] / along[i], limit[i] / abs(along[i])
    scale = 1.0
    for i in range(n + 1):  # they overlap if every two of them do
        for j in range(n + 1):
            scale = min(scale, (room[i] + room[j]) / max(at[i] - at[j], 1e-12))
    low, high = -scale * at[0] - room[0], -scale * at[0] + room[0]
    for i in range(1, n + 1):
        low, high = max(low, -scale * at[i] - room[i]), min(high, -scale * at[i] + room[i])
    spin = min(max(spin, low), high)
    for i in range(n):  # only rounding is clipped
        out[i] = min(max(scale * out[i] + spin * along[i], -limit[i]), limit[i])
    for i in range(n, size):
        out[i] = min(max(torque[i], -limit[i]), limit[i])
