"""The compiled disturbance observer against the same source as ordinary Python, and against NumPy's algebra."""

from __future__ import annotations

import numpy as np
import pytest

from toys import made
from wbmpc.bases.ball.disturbance import DisturbanceObserver

N, GATE = 7, np.array([0.06, 0.06, 0.25, 0.12, 0.12])


def model(x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
    return x + h * np.concatenate([x[N:], -0.5 * x[N:] - x[:N] + np.resize(u, N)])


@pytest.mark.parametrize("seed", range(3))
def test_both_back_ends_say_the_same(seed: int) -> None:
    """Motions with pushes that stop and resume the learning."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(N, N))
    mass = root @ root.T
    both = [
        made(b, DisturbanceObserver, model, lambda q: mass, N, GATE, hold=0.05, longest=0.1, settled=0.1)
        for b in ("compiled", "interpreted")
    ]
    x, t, seen = rng.normal(size=2 * N), 0.0, set()
    for k in range(300):
        h = rng.uniform(1e-3, 5e-3)
        t += h
        push = 3.0 * np.sign(np.sin(0.05 * k)) * (k % 100 > 40)
        x = model(x, rng.normal(size=3) + push, h)
        found = [observer.update(t, x, np.zeros(3), h) for observer in both]
        np.testing.assert_allclose(found[0], found[1], rtol=1e-11, atol=1e-12)
        assert both[0].learning == pytest.approx(both[1].learning, rel=1e-11)
        seen.add(both[0].learning == 0.0)
    assert seen == {True, False}


def test_one_update_is_that_of_the_equations() -> None:
    """Truth: v̂' = … + L1 ṽ and d̂' = L2 M ṽ / (1 + (a / calm)² + (ω / calm)²) by NumPy's algebra."""
    rng, h = np.random.default_rng(4), 0.0025
    mass, x, u = np.eye(N) + 0.1, rng.normal(size=2 * N), rng.normal(size=3)
    observer = DisturbanceObserver(model, lambda q: mass, N, gate=np.full(5, np.inf))
    observer.update(-2.0, x, u, h)  # the start is over
    speed = model(x, u, h)[N:]
    x = x + 0.01 * rng.normal(size=2 * N)
    after = model(np.concatenate([x[:N], speed]), u, h)[N:]
    quick = (np.hypot(*(after[:2] - speed[:2]) / h) / 0.5) ** 2 + (np.hypot(*x[N + 3 : N + 5]) / 0.2) ** 2
    force = observer.update(h, x, u, h)
    np.testing.assert_allclose(force, h * 75.0 / (1.0 + quick) * mass @ (x[N:] - speed), rtol=1e-12)
    assert observer.learning == pytest.approx(1.0 / (1.0 + quick))
