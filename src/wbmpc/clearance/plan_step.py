"""What a plan says before a solve, compiled: where it is at the next one's nodes, and the inputs of a stop."""

from __future__ import annotations

from wbmpc.clearance.compilation import compiled, step
from wbmpc.kernel.ir import Floats, Integers

#: A stop takes so long [s] at least and, where no limit says how fast inputs change, exactly the second; no longer than the last.
SHORTEST, USUAL, LONGEST = 0.2, 0.5, 1.5


@step
def predict(
    n: int, nx: int, old: Floats, old_at: int, x: Floats, x_at: int, nodes: Floats, delta: float, out: Floats
) -> None:
    """States ``out`` (n + 1, nx) at ``nodes`` (n + 1) [s] of a plan that is ``delta`` [s] old: its nodes begin at ``old[old_at]``, its states
    at ``x[x_at]``; linear in between, held beyond its end."""
    i = 0
    for k in range(n + 1):
        t = min(nodes[k] + delta, old[old_at + n])
        while i < n - 1 and old[old_at + i + 1] <= t:
            i += 1
        a = (t - old[old_at + i]) / (old[old_at + i + 1] - old[old_at + i])
        for c in range(nx):
            at = x_at + i * nx + c
            out[k * nx + c] = (1.0 - a) * x[at] + a * x[at + nx]


@step
def stop_duration(count: int, rates: Floats, sources: Integers, x0: Floats, u0: Floats) -> float:
    """How long [s] a stop from the state ``x0`` under the input ``u0`` takes with all inputs in proportion. ``rates`` (count): limits;
    ``sources`` (count): the entry of u0, or −1 less that of x0, that changes so fast at most."""
    longest = SHORTEST if count > 0 else USUAL
    for i in range(count):
        s = sources[i]
        value = u0[max(s, 0)] if s >= 0 else x0[max(-1 - s, 0)]
        longest = max(longest, abs(value) / rates[i])
    return min(longest, LONGEST)


@compiled
def driven(t: float, duration: float) -> float:
    """What of a speed of 1 has been driven at ``t`` [s] of a stop."""
    t = min(t, duration)
    return t - 0.5 * (t * t) / duration


@step
def stop_inputs(
    n: int, nu: int, nodes: Floats, x0: Floats, u0: Floats, state_of: Integers, duration: float, out: Floats
) -> None:
    """Inputs ``out`` (n, nu) that stop within ``duration`` [s]: of each interval the mean of what is left of ``u0`` (nu); of those that are
    rates of a state, ``state_of`` (nu; −1: of none), what takes it from ``x0`` to zero while the stop lasts."""
    for k in range(n):
        h = nodes[k + 1] - nodes[k]
        left = (driven(nodes[k + 1], duration) - driven(nodes[k], duration)) / h
        lasts = min(max((duration - nodes[k]) / h, 0.0), 1.0)
        for i in range(nu):
            s = state_of[i]
            out[k * nu + i] = left * u0[i] if s < 0 else -lasts * x0[max(s, 0)] / duration
