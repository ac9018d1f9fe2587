"""What the real-time runner counted."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np


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
        median, p95, p99, most = (float(q) for q in np.percentile(samples, [50, 95, 99, 100]))
        return cls(median, p95, p99, most, count)


@dataclass(frozen=True)
class Report:
    """What was counted up to now.

    ``ticks`` of the controller and ``misses`` of its deadlines; ``updates`` of the MPC, ``mpc_misses``, ``failures`` to solve,
    ``repeated``: updates without a new observation; ``policies`` that came into force, ``late``: after the time they were
    planned for; ``clamped``: ticks at which the policy asked for more than the drives give. ``latency``: from observation to
    policy in force; ``ready``: to finished policy; ``jitter``: by how much ticks begin late; ``tick``: their duration.
    """

    state: str
    seconds: float
    ticks: int
    misses: int
    updates: int
    mpc_misses: int
    failures: int
    repeated: int
    policies: int
    late: int
    clamped: int
    latency: Spread
    ready: Spread
    jitter: Spread
    tick: Spread
    solve: Spread
    update: Spread

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)
