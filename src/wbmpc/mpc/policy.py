"""The feedback policy that the MPC hands to the controller."""

from __future__ import annotations

import ctypes
import math
from bisect import bisect_right
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any

import numpy as np

from wbmpc.checks import real_numbers
from wbmpc.clearance.rows import Clearance
from wbmpc.errors import InputError, NotFinite
from wbmpc.solver import Solution


class InputLimits:
    """What a policy holds its inputs to; ``count``: how often it had to.

    Bounds ``lower`` and ``upper`` (nu) cut inputs one by one. Rows ``matrix`` u + ``offset`` ≥ 0, (r, nu) and (r,), scale back what
    feedback adds: u = u_ff + s (u − u_ff), for every group of inputs that rows couple with the largest s in [0, 1] that holds its
    rows. Other groups, and inputs in no row, keep their feedback: a base at its limit must not take the balance from a pole.
    Where bounds move with a reference or count in some modes alone, their rows are in ``matrix``, and cut inputs one by one too.
    Rows that a plan misses because of bounds that move are met by inputs that may still move.
    """

    def __init__(
        self, lower: np.ndarray, upper: np.ndarray, matrix: np.ndarray | None = None, offset: np.ndarray | None = None
    ) -> None:
        from wbmpc.solver.feedback import arrange

        self.lower, self.upper, self.count = lower, upper, 0
        self.matrix = np.zeros((0, lower.size)) if matrix is None else matrix
        self.offset = np.zeros(len(self.matrix)) if offset is None else offset
        rows, nu = self.offset.size, lower.size
        #: all of it in one array, as :mod:`wbmpc.solver.feedback` reads it
        self.table = np.empty(2 * nu + (2 * nu + 2) * rows)
        plain = lambda part: np.ascontiguousarray(part, float)
        arrange(plain(lower), plain(upper), plain(self.matrix), plain(self.offset), rows, nu, self.table)

    def hold(
        self, u: np.ndarray, planned: np.ndarray | None = None, active: np.ndarray | None = None,
        offset: np.ndarray | None = None,
    ) -> np.ndarray:  # fmt: skip
        """``u`` (nu), cut in place; ``planned`` (nu): without feedback; ``active`` (r): which rows count now (all: left out);
        ``offset`` (r): of the rows now, where they move."""
        from wbmpc.solver.feedback import within

        rows, nu = self.offset.size, self.lower.size
        room, plan = np.empty(3 * nu + rows), np.array(u if planned is None else planned, float)
        if offset is not None:
            room[3 * nu :] = offset
        counts = np.ones(max(rows, 1)) if active is None else np.array(active, float)
        cut = within(u, plan, 0, self.table, counts, rows, nu, offset is not None, planned is not None, room)
        self.count += int(cut)
        return u


def _is_finite(t: float) -> bool:
    try:
        return math.isfinite(t)
    except OverflowError:  # a whole number beyond all floats
        return False
    except (TypeError, ValueError, RuntimeError):  # the last one: of CasADi's matrices
        raise InputError(f"policy: a time in seconds is needed, got {t!r}") from None


@dataclass(frozen=True)
class Policy:
    """u(t, x) = u_ff(t) + K(t) (x − x_ff(t)), held within the hard rows of the inputs, indexed by absolute time.

    ``times`` (N + 1,) [s, absolute], ``x`` (N + 1, nx), ``u`` (N, nu) and ``gain`` (N, nu, nx). The input and the gain
    hold over an interval, as in the transcription (interpolated inputs would violate rolling between nodes); the state is
    linear between nodes. Before the first and after the last node the end values hold.

    ``limit_violation``: by how much planned states, from node 1 on, are outside hard limits as a share of the range; 0 up to 0.1 %.
    ``limits``: what the problem gives the inputs alone by straight hard constraints, bounds and rows of several (None: nothing).
    After a push the feedback may exceed the limits, because the plan does not include the push yet. ``active`` (N, r): which of the rows
    count in each interval's mode. ``moving`` (N, 2, r): their offsets at each interval's beginning and end, where references or
    parameters move them (None: nowhere); in between they are linear, and nowhere larger than a reference that bends or jumps there
    allows (with the quaternion of a pose: less, by the length of its arc). A reference that moves within one interval by more than its
    limits are wide leaves no input for the whole interval: there the upper limits hold alone. Other hard rows (with states, and those
    that ``MPC(plan_only_limits=True)`` allows) hold in the plan, i.e. for ``policy(t)``; cut feedback to those yourself, from :meth:`law`.
    ``clearance``: the pair of the plan with the largest margin violation, robot and obstacle or two parts of the robot (None: no such
    rows).
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

    def __repr__(self) -> str:
        return (
            f"Policy({self.times[0]:.3f} to {self.end:.3f} s, {len(self.u)} intervals, "
            f"{self.x.shape[1]} states, {self.u.shape[1]} inputs)"
        )

    def _repr_html_(self) -> str:
        from wbmpc.plots.notebook import html_table

        rows = [
            ("limit violation", f"{100 * self.limit_violation:.3g} %"),
            ("largest gain", f"{np.abs(self.gain).max(initial=0.0):.4g}"),
        ]
        rows += [("input at its start", np.array2string(self.u[0], precision=4, suppress_small=True))]
        return html_table(repr(self), (), rows)

    def plot(self, dynamics: Any = None) -> Any:
        """Planned states and inputs over absolute time as a Plotly figure; ``dynamics``: whose names and units they have (left out: numbers)."""
        from wbmpc.plots.notebook import figure, trajectories

        return figure(trajectories(self.times, self.x, self.u, dynamics))

    @property
    def end(self) -> float:
        """The last time [s] for which the policy was planned."""
        return float(self.times[-1])

    def _interval(self, t: float) -> int:
        if not _is_finite(t):  # which would be the last one
            raise NotFinite("policy: time and state must be finite")
        k = bisect_right(self._nodes, t + 1e-9) - 1
        return min(max(k, 0), len(self.u) - 1)

    @cached_property
    def _nodes(self) -> list[float]:
        """``times`` as Python's own numbers, among which a search takes a tenth of the time."""
        return self.times.tolist()  # type: ignore[no-any-return]

    def state(self, t: float) -> np.ndarray:
        """Planned state (nx) at time t [s]. Raises :class:`NotFinite` for a time that is not finite."""
        k = self._interval(t)
        a = self._share(t, k)
        return (1.0 - a) * self.x[k] + a * self.x[k + 1]

    def _share(self, t: float, k: int) -> float:
        """How much of interval k has passed at time t [s], from 0 to 1."""
        start, end = self._nodes[k], self._nodes[k + 1]
        return float(min(max((t - start) / (end - start), 0.0), 1.0))

    def feedforward(self, t: float) -> np.ndarray:
        """Planned input (nu) at time t [s]. Raises what :meth:`state` raises."""
        return self.u[self._interval(t)].copy()

    def planned(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Planned state (nx) and input (nu) at time t [s]. Raises what :meth:`state` raises."""
        k = self._interval(t)
        a = self._share(t, k)
        return (1.0 - a) * self.x[k] + a * self.x[k + 1], self.u[k].copy()

    def law(self, t: float, x: np.ndarray) -> np.ndarray:
        """Input (nu) at time t [s] by feedback in the state x (nx), without limits: for a caller that limits it in another way.

        Raises :class:`InputError` for another shape, :class:`NotFinite` for a time or a state that is not finite, or so large that the
        input is not.
        """
        return self._code.input(t, self._checked(t, x), False)[0]

    def _checked(self, t: float, x: np.ndarray) -> np.ndarray:
        x = real_numbers("policy", x)
        if x.shape != self.x.shape[1:]:
            raise InputError(f"policy: a state of {self.x.shape[1]} numbers is needed, got shape {x.shape}")
        if not (_is_finite(t) and all(map(math.isfinite, x.tolist()))):
            raise NotFinite("policy: time and state must be finite")
        return x

    def __call__(self, t: float, x: np.ndarray | None = None) -> np.ndarray:
        """Input (nu) within ``limits`` at time t [s] for the measured state (nx); the feed-forward alone when x is left out.

        Raises what :meth:`law` raises.
        """
        if x is None:
            u = self.feedforward(t)
            cut = self.limits is not None and self._code.hold(t, u)
        else:
            u, cut = self._code.input(t, self._checked(t, x), self.limits is not None)
        if cut and self.limits is not None:
            self.limits.count += 1
        return u

    @cached_property
    def _code(self) -> _Code:
        return _Code(self)

    def __getstate__(self) -> dict[str, Any]:
        """Without what is bound to this process."""
        return {name: value for name, value in self.__dict__.items() if name not in ("_code", "_nodes")}


@cache
def _free(nu: int) -> np.ndarray:
    """Bounds of nu inputs that have none."""
    return np.concatenate([np.full(nu, -np.inf), np.full(nu, np.inf)])


def _sizes(policy: Policy) -> tuple[int, int, int, int]:
    """Intervals, inputs, states and rows; :class:`InputError` for arrays that do not fit: compiled code reads them without a look."""
    u, x, limits = np.shape(policy.u), np.shape(policy.x), policy.limits
    if len(u) != 2 or len(x) != 2 or not u[0]:
        raise InputError(f"policy: u (N, nu), x (N + 1, nx), at least one interval are needed, got shapes {u} and {x}")
    (n, nu), nx, rows = u, x[1], 0 if limits is None else limits.offset.size
    needed = {"times": (n + 1,), "x": (n + 1, nx), "gain": (n, nu, nx), "active": (n, rows), "moving": (n, 2, rows)}
    for name, shape in needed.items():
        value = getattr(policy, name)
        if value is not None and np.shape(value) != shape:
            raise InputError(f"policy: {name} {shape} is needed for u {u}, got shape {np.shape(value)}")
    if limits is not None and limits.lower.size != nu:
        raise InputError(f"policy: limits of {nu} inputs are needed, got those of {limits.lower.size}")
    return n, nu, nx, rows


class _Code:
    """The compiled functions of :mod:`wbmpc.solver.feedback` with the addresses of a policy's arrays: a call costs microseconds."""

    def __init__(self, policy: Policy) -> None:
        from wbmpc.solver.feedback import EVALUATION, hold

        self._evaluate, self._hold = EVALUATION, hold.pointer
        limits = policy.limits
        n, nu, nx, rows = _sizes(policy)
        active = np.ones((n, max(rows, 1))) if policy.active is None else policy.active
        moves = policy.moving is not None
        arrays = (
            policy.times, policy.x, policy.u, policy.gain, _free(nu) if limits is None else limits.table, active,
            policy.moving if moves else np.zeros(1),
        )  # fmt: skip
        self._kept = [np.ascontiguousarray(a, float) for a in arrays]
        times, x, u, gain, table, active_at, moving = (a.ctypes.data for a in self._kept)
        self._room, self._sizes = 3 * nu + rows, (nx, nu, 3 * nu + rows)
        self._law = np.array([times, x, u, gain, table, active_at, moving, n, nx, nu, rows, int(moves)], np.int64)
        self._held = (*self._law.tolist(), 0)

    def input(self, t: float, x: np.ndarray, limited: bool) -> tuple[np.ndarray, bool]:
        """With feedback; whether it was cut. Raises :class:`NotFinite`."""
        u, outcome = self._evaluate(self._law, self._sizes, limited, t, x)
        if outcome < 0:  # no limit could hold it
            raise NotFinite("policy: the state is so far from the plan that the input is not finite")
        return u, outcome > 0

    def hold(self, t: float, u: np.ndarray) -> bool:
        """Cut a planned input, in place; whether it was."""
        out, room = ctypes.c_int64(), np.empty(self._room)  # of this call's own: threads share a policy
        self._hold(*self._held, t, room.ctypes.data, u.ctypes.data, ctypes.addressof(out))
        return out.value > 0
