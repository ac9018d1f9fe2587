"""When a rocking began. Truth: an inverted pendulum, integrated, whose load crosses its edge at a known time."""

from __future__ import annotations

import numpy as np
import pytest

from wbmpc.errors import InputError
from wbmpc.studies.pankert2022.rocking import Rocking, rockings

T = np.arange(0.0, 8.0, 1.0 / 400.0)
#: Noise [rad/s] of a gyro with 2e-4 rad/s/√Hz at 400 Hz.
NOISE = 2e-4 * np.sqrt(400.0)


def pendulum(crossing: float, growth: float, speed: float = 0.05, stop: float = 0.15) -> np.ndarray:
    """Rates (k,) of a body that falls from its edge, θ'' = k² (θ + speed · (t − crossing)), and lands at ``stop`` [rad]."""
    angle = rate = 0.0
    rates = np.zeros(T.size)
    h = T[1] - T[0]
    for i, t in enumerate(T):
        rates[i] = rate
        if t >= crossing:
            rate += h * growth**2 * (angle + speed * (t - crossing))
            angle += h * rate
        if angle > stop:
            rates[i + 1 : i + 41] = -0.3 * rate * np.linspace(1.0, 0.0, 40)  # it bounces
            break
    return rates


@pytest.mark.parametrize("growth", [2.5, 3.0, 3.5])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_beginning_of_a_fall(growth: float, sign: int) -> None:
    rng = np.random.default_rng(0)
    for crossing in (2.0, 3.137):
        rate = sign * pendulum(crossing, growth) + NOISE * rng.normal(size=T.size)
        (found,) = rockings(T, rate)
        assert found == Rocking(pytest.approx(crossing, abs=0.03), sign)


def test_a_threshold_would_be_late_by_tenths_of_a_second() -> None:
    rate = pendulum(2.0, 3.0)
    assert T[np.argmax(rate > 0.05)] > 2.3
    (found,) = rockings(T, rate)
    assert found.time == pytest.approx(2.0, abs=0.01)


def test_two_rockings_and_noise_alone() -> None:
    noise = NOISE * np.random.default_rng(1).normal(size=T.size)
    assert rockings(T, noise) == []
    found = rockings(T, pendulum(1.0, 3.0) - pendulum(5.0, 3.0) + noise)
    assert [(round(r.time, 1), r.sign) for r in found] == [(1.0, 1), (5.0, -1)]


@pytest.mark.parametrize(
    ("times", "rates", "words"),
    [
        ([0.0], [0.0], "one for each"),
        (T, T[:-1], "one for each"),
        (T, np.where(T > 1.0, np.nan, 0.0), "finite"),
        ([0.0, 1.0, 1.5], [0.0, 0.0, 0.0], "even steps"),
        ([1.0, 0.0], [0.0, 0.0], "even steps"),
    ],
)
def test_senseless_rates_are_rejected(times: np.ndarray, rates: np.ndarray, words: str) -> None:
    with pytest.raises(InputError, match=words):
        rockings(times, rates)
