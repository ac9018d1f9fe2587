"""What runs over seeds say: order statistics, bootstrap intervals, paired comparisons, failure rates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import stats

#: Share of the intervals, and resamples of a bootstrap.
CONFIDENCE, RESAMPLES = 0.95, 2000
#: A difference that is a smaller share of a figure is of its last digits.
_ROUNDING = 1e-6
#: Values that are drawn at a time.
_PART = 200_000


@dataclass(frozen=True)
class Spread:
    """Of ``count`` values: median with its interval, 5 and 95 %, and the worst one."""

    count: int
    median: float
    low: float
    high: float
    p5: float
    p95: float
    worst: float


@dataclass(frozen=True)
class Rate:
    """``failed`` of ``count`` runs, as a share with its Wilson interval."""

    failed: int
    count: int
    share: float
    low: float
    high: float


@dataclass(frozen=True)
class Paired:
    """Two variants on ``count`` equal seeds: median of the difference (this minus the other) with its interval, and in how many this
    is better and worse."""

    count: int
    difference: float
    low: float
    high: float
    wins: int
    losses: int

    @property
    def text(self) -> str:
        """Whether it is better or worse; neither where the interval has 0 in it."""
        return "better" if self._shifted and self.wins > self.losses else "worse" if self._shifted else "no difference"

    @property
    def _shifted(self) -> bool:
        return self.low > 0.0 or self.high < 0.0


def quantile(values: np.ndarray, share: float) -> float:
    """A value of ``values`` (n,): nothing between two, since a mean with infinity is no figure."""
    return float(np.quantile(values, share, method="nearest"))


def _median(values: np.ndarray, axis: int = -1) -> np.ndarray:
    with np.errstate(invalid="ignore"):  # of -inf and inf
        return np.asarray(np.median(values, axis=axis))


@lru_cache(maxsize=8)
def _drawn(count: int) -> tuple[np.ndarray, ...]:
    """Which of ``count`` values every resample of a bootstrap has, in parts (m, count) of little memory: the same for every figure of a study."""
    rng = np.random.default_rng(0)
    drawn = rng.integers(0, count, (RESAMPLES, count))
    return tuple(np.array_split(drawn, max(RESAMPLES * count // _PART, 1)))


def interval(values: np.ndarray, statistic: Callable[..., np.ndarray] = _median) -> tuple[float, float]:
    """The percentile bootstrap's interval of a statistic of ``values`` (n,), the same for the same values; nan of fewer than two."""
    if values.size < 2:
        return float("nan"), float("nan")
    if np.all(values == values[0]):
        return float(values[0]), float(values[0])
    with np.errstate(invalid="ignore"):
        made = np.concatenate([statistic(values[drawn], axis=-1) for drawn in _drawn(values.size)])
    tail = 0.5 * (1.0 - CONFIDENCE)
    return quantile(made, tail), quantile(made, 1.0 - tail)


def spread(values: np.ndarray, largest_is_worst: bool = True) -> Spread:
    """Of ``values`` (n,), which may be infinite; nan of none."""
    if not values.size:
        return Spread(0, *(6 * [float("nan")]))
    low, high = interval(values)
    worst = values.max() if largest_is_worst else values.min()
    return Spread(
        values.size, float(_median(values)), low, high, quantile(values, 0.05), quantile(values, 0.95), float(worst)
    )


def failure_rate(failed: int, count: int) -> Rate:
    """Of ``count`` ≥ 1 runs."""
    found = stats.binomtest(failed, count).proportion_ci(CONFIDENCE, method="wilson")
    return Rate(failed, count, failed / count, float(found.low), float(found.high))


def paired(these: np.ndarray, others: np.ndarray, smaller_is_better: bool = True) -> Paired:
    """Of values (n,) on the same seeds, n ≥ 1; an infinite one loses against a finite one, two of them are
    equal, and so are figures whose first six digits are."""
    with np.errstate(invalid="ignore"):
        difference = np.where(np.isclose(these, others, rtol=_ROUNDING, atol=0.0), 0.0, these - others)
    better = difference < 0.0 if smaller_is_better else difference > 0.0
    wins, losses = int(better.sum()), int((difference != 0.0).sum() - better.sum())
    low, high = interval(difference)
    return Paired(difference.size, float(_median(difference)), low, high, wins, losses)
