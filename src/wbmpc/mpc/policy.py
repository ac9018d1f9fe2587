"""The feedback policy that the MPC hands to the controller."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np

from wbmpc.errors import InputError, NotFinite
from wbmpc.obstacles.rows import Clearance
from wbmpc.solver import Solution

#: Share of a bound (or of 1, where that is more) beyond which an input counts as cut: the rest is rounding.
_ROUNDING = 1e-9


class InputLimits:
    """What a policy holds its inputs to; ``count``: how often it had to.

    Bounds ``lower`` and ``upper`` (nu) cut inputs one by one. Rows ``matrix`` u + ``offset`` ≥ 0, (r, nu) and (r,), scale back what
    feedback adds: u = u_ff + s (u − u_ff), for every group of inputs that rows couple with the largest s in [0, 1] that holds its
    rows. Other groups, and inputs in no row, keep their feedback: a base at its limit must not take the balance from a pole.
    Where bounds move with a reference, their rows are in ``matrix``, and cut inputs one by one too.
    """

    def __init__(
        self, lower: np.ndarray, upper: np.ndarray, matrix: np.ndarray | None = None, offset: np.ndarray | None = None
    ) -> None:
        self.lower, self.upper, self.count = lower, upper, 0
        self.matrix = np.zeros((0, lower.size)) if matrix is None else matrix
        self.offset = np.zeros(len(self.matrix)) if offset is None else offset
        self._coupled = _groups(self.matrix != 0.0)  # (r, nu)
        single = np.flatnonzero((self.matrix != 0.0).sum(axis=1) == 1)
        self._single = [(int(r), int(np.argmax(self.matrix[r] != 0.0))) for r in single]

    def hold(
        self,
        u: np.ndarray,
        planned: np.ndarray | None = None,
        active: np.ndarray | None = None,
        offset: np.ndarray | None = None,
    ) -> np.ndarray:
        """``u`` (nu), cut in place; ``planned`` (nu): without feedback; ``active`` (r): which rows count now (all: left out);
        ``offset`` (r): of the rows now, where they move."""
        lower, upper, far = self.lower, self.upper, False
        if offset is not None:
            lower, upper = self._bounds(offset, active)
        if (u > upper).any() or (u < lower).any():
            far = bool((np.maximum(u - upper, lower - u) > _ROUNDING * np.maximum(np.abs(u), 1.0)).any())
            np.clip(u, lower, upper, out=u)
        offset = self.offset if offset is None else offset
        if planned is not None and offset.size and self._scale(u, planned, active, offset):
            far = True
            np.clip(u, lower, upper, out=u)  # a plan that is outside itself
        self.count += int(far)
        return u

    def _bounds(self, offset: np.ndarray, active: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """(lower, upper) (nu): the bounds that hold for good, and those of the rows of single inputs with these offsets (r)."""
        lower, upper = self.lower.copy(), self.upper.copy()
        for r, i in self._single:
            if active is not None and active[r] <= 0.0:
                continue
            slope = self.matrix[r, i]
            if slope > 0.0:
                lower[i] = max(lower[i], -offset[r] / slope)
            else:
                upper[i] = min(upper[i], -offset[r] / slope)
        return lower, upper

    def _scale(self, u: np.ndarray, planned: np.ndarray, active: np.ndarray | None, offset: np.ndarray) -> bool:
        """Whether rows made feedback smaller, in place. What the plan itself lacks of a row is not made worse."""
        now = self.matrix @ u + offset
        bad = now < -_ROUNDING if active is None else (now < -_ROUNDING) & (active > 0.0)
        if not bad.any():
            return False
        previous = np.maximum(self.matrix[bad] @ planned + offset[bad], 0.0)
        shares = previous / (previous - now[bad])
        share = np.where(self._coupled[bad], shares[:, None], 1.0).min(axis=0)
        np.copyto(u, (u - planned) * share + planned, where=share < 1.0)
        return True


def _groups(inside: np.ndarray) -> np.ndarray:
    """For every row, (r, nu), the inputs of its group: those that it, or rows it shares inputs with, look at (``inside``)."""
    reached = inside
    while True:
        wider = (reached @ inside.T) @ inside
        if (wider == reached).all():
            return wider
        reached = wider


@dataclass(frozen=True)
class Policy:
    """u(t, x) = u_ff(t) + K(t) (x − x_ff(t)), held within the hard rows of the inputs, indexed by absolute time.

    ``times`` (N + 1,) [s, absolute], ``x`` (N + 1, nx), ``u`` (N, nu) and ``gain`` (N, nu, nx). The input and the gain
    hold over an interval, as in the transcription (interpolated inputs would violate rolling between nodes); the state is
    linear between nodes. Before the first and after the last node the end values hold.

    ``limit_violation``: by how much planned states, from node 1 on, are outside hard limits as a share of the range; 0 up to 0.1 %.
    ``limits``: what the problem gives the inputs alone by straight hard constraints, bounds and rows of several (None: nothing).
    After a push the feedback asks for more than the plan, which knows nothing of it yet. ``active`` (N, r): which of the rows
    count in each interval's mode. ``moving`` (N, 2, r): their offsets at each interval's beginning and end, where references or
    parameters move them (None: nowhere); in between they are linear, so that ``policy(t)`` follows them too. Other hard rows
    (with states, and those that ``MPC(plan_only_limits=True)`` allows) hold in the plan, i.e. for ``policy(t)``; cut feedback to
    those yourself, from :meth:`law`.
    ``clearance``: what of the plan is nearest to an obstacle, or to another part of the robot, for its margin (None: no such rows).
    """

    times: np.ndarray
    x: np.ndarray
    u: np.ndarray
    gain: np.ndarray
    limits: InputLimits | None = field(default=None, kw_only=True, compare=False)
    limit_violation: float = field(default=0.0, kw_only=True)
    active: np.ndarray | None = field(default=None, kw_only=True, compare=False)
    moving: np.ndarray | None = field(default=None, kw_only=True, compare=False)
    clearance: Clearance | None = field(default=None, kw_only=True, compare=False)

    @classmethod
    def of(
        cls, solution: Solution, t0: float, limits: InputLimits | None = None, limit_violation: float = 0.0,
        active: np.ndarray | None = None, moving: np.ndarray | None = None, clearance: Clearance | None = None,
    ) -> Policy:  # fmt: skip
        """The policy of a solution whose horizon starts at ``t0`` [s]."""
        own = (t0 + solution.times, solution.x, solution.u, solution.gain)
        return cls(
            *own, limits=limits, limit_violation=limit_violation, active=active, moving=moving, clearance=clearance
        )

    @property
    def end(self) -> float:
        """The last time [s] for which the policy was planned."""
        return float(self.times[-1])

    def _interval(self, t: float) -> int:
        k = bisect_right(self.times, t + 1e-9) - 1  # type: ignore[type-var]  # (NumPy's search lets the interpreter go)
        return min(max(k, 0), len(self.u) - 1)

    def state(self, t: float) -> np.ndarray:
        """Planned state (nx) at time t [s]."""
        k = self._interval(t)
        a = self._share(t, k)
        return (1.0 - a) * self.x[k] + a * self.x[k + 1]

    def _share(self, t: float, k: int) -> float:
        """How much of interval k has passed at time t [s], from 0 to 1."""
        start, end = self.times[k : k + 2].tolist()
        return float(min(max((t - start) / (end - start), 0.0), 1.0))

    def feedforward(self, t: float) -> np.ndarray:
        """Planned input (nu) at time t [s]."""
        return self.u[self._interval(t)].copy()

    def law(self, t: float, x: np.ndarray) -> np.ndarray:
        """Input (nu) at time t [s] that feedback asks for in the state x (nx), limits or not: for who cuts it in another way.

        Raises :class:`InputError` for another shape, :class:`NotFinite` for a time or a state that is not finite, or so large that the
        input is not.
        """
        if np.shape(x) != self.x[0].shape:
            raise InputError(f"policy: a state of {self.x.shape[1]} numbers is needed, got shape {np.shape(x)}")
        if not (math.isfinite(t) and np.isfinite(x).all()):
            raise NotFinite("policy: time and state must be finite")
        k = self._interval(t)
        a = self._share(t, k)
        with np.errstate(over="ignore", invalid="ignore"):
            u: np.ndarray = self.gain[k] @ (x - ((1.0 - a) * self.x[k] + a * self.x[k + 1]))
        u += self.u[k]
        if not np.isfinite(u).all():  # no limit could hold it
            raise NotFinite("policy: the state is so far from the plan that the input is not finite")
        return u

    def __call__(self, t: float, x: np.ndarray | None = None) -> np.ndarray:
        """Input (nu) within ``limits`` at time t [s] for the measured state (nx); the feed-forward alone when x is left out.

        Raises what :meth:`law` raises.
        """
        if x is None and not math.isfinite(t):
            raise NotFinite("policy: time and state must be finite")
        u = self.feedforward(t) if x is None else self.law(t, x)
        if self.limits is None:
            return u
        if x is None and self.moving is None:
            return self.limits.hold(u)
        k, offset = self._interval(t), None
        if self.moving is not None:
            a = self._share(t, k)
            offset = (1.0 - a) * self.moving[k, 0] + a * self.moving[k, 1]
        active = None if self.active is None else self.active[k]
        return self.limits.hold(u, None if x is None else self.u[k], active, offset)
