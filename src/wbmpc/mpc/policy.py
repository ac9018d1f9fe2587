"""The feedback policy that the MPC hands to the controller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbmpc.errors import NotFinite
from wbmpc.solver import Solution


@dataclass(frozen=True)
class Policy:
    """u(t, x) = u_ff(t) + K(t) (x − x_ff(t)), indexed by absolute time.

    ``times`` (N + 1,) [s, absolute], ``x`` (N + 1, nx), ``u`` (N, nu) and ``gain`` (N, nu, nx). The input and the gain
    hold over an interval, as in the transcription (interpolated inputs would violate rolling between nodes); the state is
    linear between nodes. Before the first and after the last node the end values hold.
    """

    times: np.ndarray
    x: np.ndarray
    u: np.ndarray
    gain: np.ndarray

    @classmethod
    def of(cls, solution: Solution, t0: float) -> Policy:
        """The policy of a solution whose horizon starts at ``t0`` [s]."""
        return cls(t0 + solution.times, solution.x, solution.u, solution.gain)

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

    def __call__(self, t: float, x: np.ndarray | None = None) -> np.ndarray:
        """Input (nu) at time t [s] for the measured state (nx); the feed-forward alone when x is left out.

        Raises :class:`NotFinite` for a time or a state that is not finite.
        """
        if not np.isfinite(t) or (x is not None and not np.isfinite(x).all()):
            raise NotFinite("policy: time and state must be finite")
        k = self._interval(t)
        if x is None:
            return self.u[k].copy()
        return self.u[k] + self.gain[k] @ (x - self.state(t))
