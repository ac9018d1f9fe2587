"""What the real-time runner counted."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from wbmpc.runtime.shared_memory import Board


@dataclass(frozen=True)
class Spread:
    """Median, 95 %, 99 % and largest [s] of a figure, and how many samples."""

    median: float
    p95: float
    p99: float
    max: float
    count: int

    @classmethod
    def of(cls, samples: np.ndarray) -> Spread:
        """All NaN without samples."""
        if not samples.size:
            samples, count = np.full(1, np.nan), 0
        else:
            count = int(samples.size)
        median, p95, p99, maximum = (float(q) for q in np.percentile(samples, [50, 95, 99, 100]))
        return cls(median, p95, p99, maximum, count)


class Punctuality:
    """Whether commands leave at their time, by the sender's own clock, and what took long before those that did not.

    A command's time is its tick's plus what the way from there to the robot usually takes (a running mean). ``late``: how many
    left more than :data:`LATE` after it; ``because``: the same by the part of the tick that exceeded its own usual time most.
    """

    #: Parts of a tick in their order; ``begin``: until it began.
    PARTS = ("begin", "read", "estimate", "predict", "command", "write")
    #: What is late [s], and the share by which one tick moves the means.
    LATE, SHARE = 1e-3, 0.01

    def __init__(self) -> None:
        self.late, self.because = 0, dict.fromkeys(self.PARTS, 0)
        self._usual: list[float] | None = None
        self._last, self._parts = 0.0, [0.0]

    def begin(self, due: float, now: float) -> None:
        """A tick that was due at ``due`` [s] begins."""
        self._last, self._parts = now, [now - due]

    def over(self, now: float) -> None:
        """The next part of the tick is over."""
        self._parts.append(now - self._last)
        self._last = now

    def sent(self) -> float:
        """The command has left, and all parts are over: how long after the tick's time [s]."""
        parts, usual = self._parts, self._usual or self._parts
        beyond = [a - b for a, b in zip(parts, usual, strict=True)]
        if sum(beyond) > self.LATE:
            self.late += 1
            self.because[self.PARTS[beyond.index(max(beyond))]] += 1
        else:
            self._usual = [b + self.SHARE * d for b, d in zip(usual, beyond, strict=True)]
        return sum(parts)


@dataclass(frozen=True)
class Report:
    """What was counted up to now.

    ``ticks`` of the controller, ``misses``: how many of them were not over at their deadline, ``skipped``: deadlines that passed
    meanwhile; ``updates`` of the MPC, ``mpc_misses`` and ``mpc_skipped`` as for ticks, ``failures`` to solve,
    ``repeated``: updates without a new observation; ``policies`` that became active, ``late``: after the time they were
    planned for; ``limit_violations``: plans with states outside hard limits by more than 0.1 % of the range,
    ``worst_limit_violation``: by how much of it at most, ``worst_limit_violation_message``: a message that names the row;
    ``initial_state_mismatches``: plans that start elsewhere than in the state they were asked to,
    ``worst_initial_state_mismatch``: by how much of 1 + |x| at most; ``clamped``: ticks at which the policy asked for more than the drives
    give. ``latency``: from observation to active policy; ``ready``: to finished policy; ``jitter``: by how much ticks begin
    late; ``tick``: their duration; ``sent``: from a tick's time to its command; ``late_commands``: by part of the tick, see
    :class:`Punctuality`.
    """

    state: str
    seconds: float
    ticks: int
    misses: int
    skipped: int
    updates: int
    mpc_misses: int
    mpc_skipped: int
    failures: int
    repeated: int
    policies: int
    late: int
    clamped: int
    limit_violations: int
    worst_limit_violation: float
    worst_limit_violation_message: str
    initial_state_mismatches: int
    worst_initial_state_mismatch: float
    latency: Spread
    ready: Spread
    jitter: Spread
    tick: Spread
    sent: Spread
    late_commands: dict[str, int]
    solve: Spread
    update: Spread

    @classmethod
    def of(cls, state: str, seconds: float, own: Board, board: Board, punctuality: Punctuality) -> Report:
        """From what the control thread (``own``) and the MPC's side (``board``) have written down up to now."""
        # misses before the total that they are of, which goes on meanwhile: else more deadlines may be missed than there were
        mpc_misses, mpc_skipped = int(board["misses"]), int(board["skipped"])
        totals: dict[str, Any] = {n: int(board[n]) for n in ("failures", "repeated", "updates")}
        totals |= {n: int(own[n]) for n in ("misses", "skipped", "clamped", "ticks", "late", "policies")}
        spreads: dict[str, Any] = {n: Spread.of(own.samples(n)) for n in ("latency", "ready", "jitter", "tick", "sent")}
        return cls(
            state=state,
            seconds=seconds,
            mpc_misses=mpc_misses,
            mpc_skipped=mpc_skipped,
            solve=Spread.of(board.samples("solve_time")),
            update=Spread.of(board.samples("update_time")),
            limit_violations=int(board["limit_violations"]),
            worst_limit_violation=board["worst_limit_violation"],
            worst_limit_violation_message=board.note,
            initial_state_mismatches=int(board["initial_state_mismatches"]),
            worst_initial_state_mismatch=board["worst_initial_state_mismatch"],
            late_commands=dict(punctuality.because),
            **totals,
            **spreads,
        )

    def __str__(self) -> str:
        ms = lambda s: f"{1e3 * s.median:.2f} ms (99 % {1e3 * s.p99:.2f}, longest {1e3 * s.max:.2f})"
        worst, row = 100.0 * self.worst_limit_violation, self.worst_limit_violation_message
        outside = f"; {self.limit_violations} plans outside hard limits, worst {worst:.2g} % ({row})"
        by = 100.0 * self.worst_initial_state_mismatch
        mismatches = f"; {self.initial_state_mismatches} plans start elsewhere, worst by {by:.2g} % of 1 + |x|"
        return "\n".join(
            [
                f"{self.state}",
                f"controller: {self.ticks} ticks, {self.misses} missed; begins late by {ms(self.jitter)}, takes {ms(self.tick)}",
                f"MPC: {self.updates} updates, {self.mpc_misses} missed, {self.failures} failed; solve {ms(self.solve)}"
                + (outside if self.limit_violations else "")
                + (mismatches if self.initial_state_mismatches else ""),
                f"policies: {self.policies} used, {self.late} late; {self.clamped} ticks clamped; latency {ms(self.latency)}",
            ]
        )

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)
