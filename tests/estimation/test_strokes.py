"""Errors of wheels from strokes between stands. Truth: wheels on paper that roll without slip along a known motion."""

from __future__ import annotations

import numpy as np
import pytest

from wbmpc import lie
from wbmpc.bases.planar_motion import calibration as strokes
from wbmpc.bases.planar_motion.calibration import Strokes, fit_errors
from wbmpc.bases.planar_motion.odometry import PlanarOdometry
from wbmpc.bases.planar_motion.wheel_errors import WheelErrors
from wbmpc.errors import InputError

Array = np.ndarray
#: Rates of four mecanum wheels (LF, RF, LB, RB) of radius 0.1 m by (vx, vy, wz), lever 0.58 m.
RATES = np.array([[1.0, -1.0, -0.58], [1.0, 1.0, 0.58], [1.0, 1.0, -0.58], [1.0, -1.0, 0.58]]) / 0.1
#: True errors: radii, and speeds that rollers which creep make slower.
RADIUS, SPEED = np.array([0.002, -0.001, 0.0015, -0.0025]), np.array([0.0, -0.01, 0.003])
PERIOD, STAND = 0.02, 1.0


def channels(noise: float = 0.0, ramp: float = 0.0) -> dict[str, Array]:
    """Ahead, back, left, right, turns to both sides of 4 m and half a turn, 10 s each, of which speeds rise and fall over a ``ramp`` [s];
    poses at 10 Hz with ``noise`` [m, 0.4 rad]."""
    rng, true = np.random.default_rng(1), WheelErrors(RADIUS, SPEED, np.zeros((7, 7))).corrected(RATES)
    wheel, pose, t, found = np.zeros(4), np.zeros(3), 0.0, dict[str, list[Array | float]]()
    for k in range(7):
        twist = np.zeros(3)
        if k:
            twist[(k - 1) // 2] = (-1.0) ** (k + 1) * (0.4 if k < 5 else 0.1 * np.pi)
        for i in range(round((STAND + 10.0 * bool(k)) / PERIOD)):
            moves = k > 0 and i < round(10.0 / PERIOD)
            found.setdefault("wheel", []).append(wheel.copy())
            found.setdefault("wheel.time", []).append(t)
            if round(t / PERIOD) % 5 == 0:
                seen = pose + noise * np.array([1.0, 1.0, 0.4]) * rng.normal(size=3)
                found.setdefault("place", []).append(np.array([*seen, 0.005, 0.005, 0.002]))
                found.setdefault("place.time", []).append(t)
            if moves:
                left = (min(i, round(10.0 / PERIOD) - i) + 0.5) * PERIOD
                way = twist * PERIOD * (min(left / ramp, 1.0) / (1.0 - ramp / 10.0) if ramp else 1.0)
                wheel, pose = wheel + true @ way, lie.se2_step(pose, way)
            t += PERIOD
    return {name: np.array(rows) for name, rows in found.items()}


def odometry(wheels: WheelErrors) -> PlanarOdometry:
    return PlanarOdometry(np.eye(3), RATES, np.zeros(3), wheels)


def drift(wheels: WheelErrors | None, twist: Array) -> Array:
    """How far (3) [m, rad] odometry is off after a second of a ``twist`` (3) that true wheels make."""
    found = PlanarOdometry(np.eye(3), RATES, np.zeros(3), wheels)
    true = WheelErrors(RADIUS, SPEED, np.zeros((7, 7))).corrected(RATES)
    found.update(0.0, np.zeros(4), None)
    return found.update(1.0, true @ twist, None) - lie.se2_exp(twist)


@pytest.mark.parametrize(("noise", "off"), [(0.0, 1e-4), (0.005, 8e-4)])
def test_the_way_by_wheels_is_right_once_their_errors_are_known(noise: float, off: float) -> None:
    """For every motion, not for those of the drive alone; no motion shows radii and speeds apart."""
    wheels = fit_errors(odometry, (4, 3), channels(noise), "drive")
    for twist in (*np.eye(3), np.array([0.5, -0.6, 0.4])):
        assert np.abs(drift(None, twist)).max() > 1e-3
        assert np.abs(drift(wheels, twist)).max() < off
    assert np.linalg.eigvalsh(wheels.covariance).min() > 0.0
    turned = np.sqrt(wheels.of_turn(4).sum()) / 4.0
    assert turned < 1e-3  # how far a turn is off: shown to less than a per mille


#: Twist and rates of two wheels of radius 0.1 m, 0.25 m beside the middle, by (v, wz).
AHEAD, TWO = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]]), np.array([[1.0, -0.25], [1.0, 0.25]]) / 0.1


def bends(creep: float) -> dict[str, Array]:
    """Half a minute of bends to and fro between two stands; tires give way to the outside by ``creep`` [s] times v ω, on paper."""
    wheel, pose, found = np.zeros(2), np.zeros(3), dict[str, list[Array | float]]()
    for i in range(round(32.0 / PERIOD)):
        t = i * PERIOD
        found.setdefault("wheel", []).append(wheel.copy())
        found.setdefault("wheel.time", []).append(t)
        found.setdefault("place", []).append(np.array([*pose, 0.005, 0.005, 0.002]))
        found.setdefault("place.time", []).append(t)
        if 1.0 <= t < 31.0:
            v, turn = np.array([0.4, 0.5]) * np.sin(0.5 * np.pi * (t - 1.0))
            wheel = wheel + TWO @ [v, turn] * PERIOD
            pose = lie.se2_step(pose, np.array([v, -creep * v * turn, turn]) * PERIOD)
    return {name: np.array(rows) for name, rows in found.items()}


@pytest.mark.parametrize("creep", [0.0, 0.008])
def test_bends_show_how_tires_creep_to_the_side(creep: float) -> None:
    odometry = lambda wheels: PlanarOdometry(AHEAD, TWO, np.zeros(3), wheels)
    record = bends(creep)
    wheels = fit_errors(odometry, (2, 2), record, "drive")
    assert wheels.creep == pytest.approx(creep, abs=1e-3)
    driven, blind = odometry(wheels), odometry(WheelErrors.unknown(2, 2))
    for t, row in zip(record["wheel.time"], record["wheel"], strict=True):
        driven.update(t, row, None)
        blind.update(t, row, None)
    there = record["place"][-1, :2]
    assert np.linalg.norm(driven.pose[:2] - there) < 2e-3
    assert np.linalg.norm(blind.pose[:2] - there) == pytest.approx(
        3.0 * creep, rel=0.1
    )  # 0.2 m/s² on average for 30 s, halved


def test_strokes_are_between_stands_and_poses_of_one_stand_are_averaged() -> None:
    found = Strokes.of(channels(), "drive")
    assert len(found.turned) == 6
    moved, _ = found.moved()
    np.testing.assert_allclose(moved[:4, :2], [[4, 0], [-4, 0], [0, 4], [0, -4]], atol=1e-9)
    np.testing.assert_allclose(found.std[1, 0], 0.005 / np.sqrt(8), rtol=0.15)  # 8 or so poses at 10 Hz


def test_a_base_that_creeps_to_its_stands_shows_its_true_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Encoders that count meters let a base creep for 30 mm within a stand: as far as these wheels roll in 0.3 rad."""
    monkeypatch.setattr(strokes, "STILL", 0.3)
    wheels = fit_errors(odometry, (4, 3), channels(ramp=4.0), "drive")
    for twist in np.eye(3):
        assert np.abs(drift(wheels, twist)).max() < 1e-4


def test_a_record_that_contradicts_itself_is_an_error() -> None:
    swapped = channels()
    swapped["wheel"] = swapped["wheel"][:, [1, 0, 2, 3]]
    with pytest.raises(InputError, match="log: wheels and global poses contradict each other"):
        fit_errors(odometry, (4, 3), swapped, "log")


@pytest.mark.parametrize("missing", ["place", "wheel.time"])
def test_what_a_record_lacks_is_named(missing: str) -> None:
    less = channels()
    less.pop(missing)
    with pytest.raises(InputError, match=f"log: there is no channel '{missing.split('.')[0]}'"):
        fit_errors(odometry, (4, 3), less, "log")


def test_a_drive_without_stands_is_an_error() -> None:
    rolling = channels()
    rolling["wheel"] = rolling["wheel"] + rolling["wheel.time"][:, None]
    with pytest.raises(InputError, match="stands 0 times"):
        Strokes.of(rolling, "log")
