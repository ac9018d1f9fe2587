"""The impedance of a door, and contact. Truth: doors simulated by their equation with known numbers; the chi-squared law."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from wbmpc.errors import InputError
from wbmpc.studies.minniti2019.contact import ContactDetector
from wbmpc.studies.minniti2019.door_filter import DoorFilter, DoorNoise

H, TRUTH = 0.0025, np.array([4.0, 8.0, 5.0])
GUESS = np.array([2.5, 12.0, 3.5])


def door(seconds: float, torque, noise: DoorNoise | None, seed: int = 0, truth=TRUTH):  # type: ignore[no-untyped-def]
    """Samples (torque known, angle and rate measured) of a door that opens; without ``noise`` exact ones."""
    rng, angle, rate, out = np.random.default_rng(seed), 0.0, 0.2, []
    inertia, damping, resistance = truth
    for k in range(round(seconds / H)):
        known = torque(k * H)
        real = known + (0.0 if noise is None else noise.torque / np.sqrt(H) * rng.normal())
        previous = rate
        rate += H * (real - damping * rate - resistance) / inertia
        angle += H * previous
        wrong = (0.0, 0.0) if noise is None else (noise.angle * rng.normal(), noise.rate * rng.normal())
        out.append((known, angle + wrong[0], rate + wrong[1]))
    assert rate > 0.0
    return out


def swings(t: float) -> float:
    return 7.0 + 2.0 * t + 1.5 * np.sin(4.0 * t)


def estimated(samples, noise: DoorNoise) -> DoorFilter:  # type: ignore[no-untyped-def]
    f = DoorFilter(GUESS, noise)
    f.rest(0.0, 0.2)
    for torque, angle, rate in samples:
        f.update(H, torque, angle, rate)
    return f


def test_exact_data_give_the_exact_impedance() -> None:
    sharp = DoorNoise(angle=1e-5, rate=1e-4, torque=1e-4, walk=1e-5, guess=1.0)
    f = estimated(door(4.0, swings, None), sharp)
    assert f.impedance == pytest.approx(TRUTH, rel=5e-3)
    assert np.all(f.spread < 0.02)


def test_covariance_is_what_the_errors_are() -> None:
    """Squared errors of the three parameters in units of the covariance over 50 seeds: chi-squared with 150 degrees."""
    noise, total = DoorNoise(walk=1e-6, guess=0.3), 0.0
    for seed in range(50):
        rng = np.random.default_rng(1000 + seed)
        first = np.array([1.0, GUESS[1], GUESS[2]]) / GUESS[0]
        parameters = first * (1.0 + 0.3 * rng.normal(size=3).clip(-2.5, 2.5))
        truth = np.array([1.0, *parameters[1:]]) / parameters[0]
        f = DoorFilter(GUESS, noise)
        f.rest(0.0, 0.2)
        strong = lambda t, c=truth: c[2] + 0.2 * c[1] + 3.0 + 2.0 * t + 1.5 * np.sin(4.0 * t)
        for torque, angle, rate in door(2.0, strong, noise, seed, truth):
            f.update(H, torque, angle, rate)
        error = f.state[2:] - parameters
        total += float(error @ np.linalg.solve(f.covariance[2:, 2:], error))
    low, high = chi2.ppf([0.001, 0.999], 150)
    assert low < total < high


def test_steady_rate_shows_only_the_sum() -> None:
    """At φ̇ = 0.2 rad/s nothing distinguishes 8 · 0.2 + 5 from other pairs with the same sum."""
    noise = DoorNoise(walk=1e-6)
    f = estimated(door(6.0, lambda t: 8.0 * 0.2 + 5.0, noise), noise)
    _, damping, resistance = f.impedance
    assert damping * 0.2 + resistance == pytest.approx(6.6, rel=0.03)
    assert f.spread[1] > 0.2  # damping by itself stays unknown


def test_rest_keeps_the_impedance() -> None:
    f = estimated(door(1.0, swings, None), DoorNoise())
    known, spread = f.impedance.copy(), f.spread.copy()
    f.rest(0.7)
    np.testing.assert_array_equal(f.impedance, known)
    np.testing.assert_array_equal(f.spread, spread)
    assert tuple(f.state[:2]) == (0.7, 0.0)


@pytest.mark.parametrize("bad", [[1.0, 2.0], [1.0, 0.0, 3.0], [1.0, np.nan, 3.0]])
def test_impossible_guesses_are_rejected(bad: list[float]) -> None:
    with pytest.raises(InputError, match="positive"):
        DoorFilter(bad)


def touching(forces: list[float], **settings: float) -> list[bool]:
    monitor = ContactDetector(**settings)
    return [monitor.update(k * H, f) for k, f in enumerate(forces)]


def test_contact_needs_force_for_ten_milliseconds() -> None:
    """At 400 Hz 10 ms are four periods: the fifth sample above the threshold makes a contact."""
    assert touching([0.0] * 3 + [3.0] * 6) == [False] * 7 + [True] * 2
    assert not any(touching(([3.0] * 4 + [0.0]) * 20))  # shorter touches are none


def test_hysteresis_and_short_losses_keep_the_contact() -> None:
    contact = [3.0] * 6
    assert all(touching(contact + [1.2] * 50)[6:])  # between the two thresholds
    assert all(touching(contact + ([0.0] * 4 + [5.0]) * 20)[6:])  # losses below 10 ms
    assert touching(contact + [0.5] * 6)[-3:] == [True, False, False]
    with pytest.raises(InputError, match="off < on"):
        ContactDetector(on=1.0, off=1.0)
