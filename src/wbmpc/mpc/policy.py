"""The feedback policy that the MPC hands to the controller."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wbmpc.errors import NotFinite
from wbmpc.solver import Solution

#: Share of a bound (or of 1, where that is more) beyond which an input counts as cut: the rest is rounding.
_ROUNDING = 1e-9


class InputLimits:
    """Bounds of the inputs, ``lower`` and ``upper`` (nu), that a policy holds; ``count``: how often it had to."""

    def __init__(self, lower: np.ndarray, upper: np.ndarray) -> None:
        self.lower, self.upper, self.count = lower, upper, 0

    def hold(self, u: np.ndarray) -> np.ndarray:
        """``u`` (nu), cut to the bounds in place."""
        lower, upper = self.lower, self.upper
        if (u > upper).any() or (u < lower).any():
            far = np.maximum(u - upper, lower - u) > _ROUNDING * np.maximum(np.abs(u), 1.0)
            self.count += int(far.any())
            np.clip(u, lower, upper, out=u)
        return u


@dataclass(frozen=True)
class Policy:
    """u(t, x) = u_ff(t) + K(t) (x − x_ff(t)), cut to the hard bounds of the inputs, indexed by absolute time.

    ``times`` (N + 1,) [s, absolute], ``x`` (N + 1, nx), ``u`` (N, nu) and ``gain`` (N, nu, nx). The input and the gain
    hold over an interval, as in the transcription (interpolated inputs would violate rolling between nodes); the state is
    linear between nodes. Before the first and after the last node the end values hold.

    ``passed``: by how much planned states, from node 1 on, are outside hard limits as a share of the range; 0 up to 0.1 %.
    ``limits``: bounds that the problem gives single inputs by hard constraints in all modes (None: it gives none). After a push
    the feedback asks for more than the plan, which knows nothing of it yet. Other hard rows (several inputs, inputs and states,
    some modes only) hold in the plan, i.e. for ``policy(t)``; cut feedback to those yourself, from :meth:`law`.
    """

    times: np.ndarray
    x: np.ndarray
    u: np.ndarray
    gain: np.ndarray
    limits: InputLimits | None = field(default=None, kw_only=True, compare=False)
    passed: float = field(default=0.0, kw_only=True)

    @classmethod
    def of(cls, solution: Solution, t0: float, limits: InputLimits | None = None, passed: float = 0.0) -> Policy:
        """The policy of a solution whose horizon starts at ``t0`` [s]."""
        return cls(t0 + solution.times, solution.x, solution.u, solution.gain, limits=limits, passed=passed)

    @property
    def end(self) -> float:
        """The last time [s] for which the policy was planned."""
        return float(self.times[-1])

    def _interval(self, t: float) -> int:
        k = int(np.searchsorted(self.times, t + 1e-9, side="right")) - 1
        return min(max(k, 0), len(self.u) - 1)

    def state(self, t: float) -> np.ndarray:
        """Planned state (nx) at time t [s]."""
        k = self._interval(t)
        a = (t - self.times[k]) / (self.times[k + 1] - self.times[k])
        a = min(max(a, 0.0), 1.0)
        return (1.0 - a) * self.x[k] + a * self.x[k + 1]

    def feedforward(self, t: float) -> np.ndarray:
        """Planned input (nu) at time t [s]."""
        return self.u[self._interval(t)].copy()

    def law(self, t: float, x: np.ndarray) -> np.ndarray:
        """Input (nu) at time t [s] that feedback asks for in the state x (nx), limits or not: for who cuts it in another way.

        Raises :class:`NotFinite` for a time or a state that is not finite.
        """
        if not (np.isfinite(t) and np.isfinite(x).all()):
            raise NotFinite("policy: time and state must be finite")
        k = self._interval(t)
        u: np.ndarray = self.gain[k] @ (x - self.state(t))
        u += self.u[k]
        return u

    def __call__(self, t: float, x: np.ndarray | None = None) -> np.ndarray:
        """Input (nu) within ``limits`` at time t [s] for the measured state (nx); the feed-forward alone when x is left out.

        Raises :class:`NotFinite` for a time or a state that is not finite.
        """
        if x is None and not np.isfinite(t):
            raise NotFinite("policy: time and state must be finite")
        u = self.feedforward(t) if x is None else self.law(t, x)
        return u if self.limits is None else self.limits.hold(u)
