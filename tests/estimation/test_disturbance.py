"""The disturbance observer. Truth: a mass moved by a known force besides the one that is commanded."""

from __future__ import annotations

import numpy as np
import pytest

from wbmpc.bases.ball.disturbance import DisturbanceObserver

N, H = 5, 0.0025
MASS = np.diag([20.0, 22.0, 2.0, 3.0, 3.0]) + 0.1
CONSTANT = np.array([4.0, -6.0, 0.2, 0.3, -0.3])
GATE = np.array([0.06, 0.06, 0.25, 0.12, 0.12])


def step(x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
    """The model: the commanded force alone, exact for a constant one."""
    a = np.linalg.solve(MASS, u)
    return np.concatenate([x[:N] + h * x[N:] + 0.5 * h * h * a, x[N:] + h * a])


def observed(seconds: float, force, start: float = -2.0, **settings) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Estimates (n, N) from 0 s on of an observer that was started at ``start`` [s] with nothing to learn, while ``force(t)`` acts that
    the observer does not know, and a command that it knows.

    As in the loop, the observer's model has the present estimate as a parameter.
    """
    given = {"gate": GATE, "calm": (np.inf, np.inf), **settings}
    observer = DisturbanceObserver(lambda x, u, h: step(x, u + observer.force, h), lambda q: MASS, N, **given)
    x, out = np.zeros(2 * N), []
    for k in range(round(start / H), 0):
        observer.update(k * H, x, np.zeros(N), H)
    for k in range(round(seconds / H)):
        t = k * H
        u = np.sin(5.0 * t) * np.array([10.0, 5.0, 1.0, 1.0, 2.0])
        out.append(observer.update(t, x, u, H))
        x = step(x, u + force(t), H)
    return np.array(out)


def test_constant_disturbance_is_found() -> None:
    estimates = observed(6.0, lambda t: CONSTANT)
    np.testing.assert_allclose(estimates[-1], CONSTANT, atol=1e-6 * np.abs(CONSTANT).max())
    half = np.abs(estimates[round(0.3 / H)] / CONSTANT)
    assert np.all((half > 0.3) & (half < 0.9))  # slowly, as the gains say: L2 / L1 = 3 / s


def test_what_is_there_at_the_start_is_found_at_once() -> None:
    """However large it is: beyond the gate too (30 N for the mass of 20 kg) all but 10 % of it after 0.3 s, by the poles -12.5 ± 12 i /s of
    L1 = 25 /s and four times L2 = 75 /s². A start that is over says nothing."""
    large = 10.0 * CONSTANT
    at = lambda start: observed(0.35, lambda t: large, start, calm=(0.5, 0.2))[-1, 0] / large[0]
    assert at(0.0) == pytest.approx(1.0, abs=0.1)
    assert abs(at(-2.0)) < 0.2


def test_nothing_is_found_where_nothing_is() -> None:
    np.testing.assert_allclose(observed(1.0, lambda t: 0.0 * CONSTANT), 0.0, atol=1e-10)


def push(t: float) -> np.ndarray:
    hit = np.array([800.0, 0.0, 0.0, 0.0, 0.0]) if 3.0 <= t < 3.2 else np.zeros(N)
    return CONSTANT + hit


def test_a_push_is_not_taken_for_a_constant_disturbance() -> None:
    """From the moment the innovation shows the push, and for the hold after its last sign, the estimate stays."""
    estimates = observed(8.0, push)
    previous, after = estimates[round(3.0 / H) - 1], estimates[round(3.0 / H) :]
    assert np.abs(after - previous).max() < 20.0  # one or two samples of the onset
    held = estimates[round(3.1 / H) : round(4.1 / H)]
    np.testing.assert_array_equal(held, np.tile(held[0], (len(held), 1)))
    np.testing.assert_allclose(estimates[-1], CONSTANT, atol=1e-3)  # and then it looks again
    fooled = observed(8.0, push, gate=np.full(N, np.inf))
    assert np.abs(fooled - previous).max() > 100.0


@pytest.mark.parametrize("hold", [0.5, 2.0])
def test_hold_is_as_long_as_asked(hold: float) -> None:
    """From when the innovation has gone down from 800 N / 20 kg / 25 /s = 1.6 m/s to the gate of 0.06 m/s, at 25 /s."""
    estimates = observed(7.0, push, hold=hold)
    changed = np.abs(np.diff(estimates[:, 0])) > 0.0
    times = np.arange(1, len(estimates)) * H
    quiet = times[(times > 3.15) & changed][0] - 3.2
    assert quiet == pytest.approx(hold + np.log(1.6 / 0.06) / 25.0, abs=0.02)


def test_an_unknown_inertia_is_no_constant_force() -> None:
    """A load of 2 kg that swings with the robot takes ± 2 N for every m/s²: what is learned of it while the robot accelerates by
    2 m/s² is little, and a constant force is still found, if later."""
    accelerating = lambda t: np.array([-2.0 * 2.0 * np.sign(np.sin(3.0 * t)), 0.0, 0.0, 0.0, 0.0])

    def learned(calm: tuple[float, float]) -> float:
        observer = DisturbanceObserver(
            lambda x, u, h: step(x, u + observer.force, h), lambda q: MASS, N, GATE, calm=calm
        )
        x, out = np.zeros(2 * N), []
        observer.update(-2.0, x, np.zeros(N), H)  # it was started before
        for k in range(1200):
            u = MASS[:, 0] * 2.0 * np.sign(np.sin(3.0 * k * H))
            out.append(observer.update(k * H, x, u, H)[0])
            x = step(x, u + accelerating(k * H), H)
        return float(np.abs(out).max())

    assert learned((np.inf, np.inf)) > 2.0
    assert learned((0.5, 0.2)) < 1.0
    found = observed(12.0, lambda t: CONSTANT, calm=(0.5, 0.2))[-1]
    np.testing.assert_allclose(found, CONSTANT, rtol=0.03)


@pytest.mark.parametrize("size", [28.0, 300.0])
def test_a_force_that_goes_on_is_learned_and_forgotten_while_the_robot_moves(size: float) -> None:
    """Along x from 2 s to 5 s, below and far beyond the gate (30 N for the mass of 20 kg). Half a second after it came, and
    after it has gone, all but 10 % is known another 0.8 s later: poles of 3.5 and 21.5 /s."""
    lasting = lambda t: np.array([size if 2.0 <= t < 5.0 else 0.0, 0.0, 0.0, 0.0, 0.0])
    force = observed(8.0, lasting, calm=(0.5, 0.2))[:, 0]
    at = lambda t: force[round(t / H)] / size
    assert size < 30.0 or (abs(at(2.45)) < 0.1 and abs(at(5.45) - 1.0) < 0.1)  # it could be a push
    assert at(3.3) == pytest.approx(1.0, abs=0.1) and at(6.3) == pytest.approx(0.0, abs=0.1)
    assert at(4.9) == pytest.approx(1.0, abs=0.02) and at(7.9) == pytest.approx(0.0, abs=0.02)


def test_what_changes_its_direction_does_not_last() -> None:
    """60 N that turn once in 0.8 s are beyond the gate all the time, and no constant force."""
    turning = lambda t: 60.0 * np.array([np.cos(7.85 * t), np.sin(7.85 * t), 0.0, 0.0, 0.0])
    assert np.abs(observed(4.0, turning, calm=(0.5, 0.2))[:, :2]).max() < 12.0
