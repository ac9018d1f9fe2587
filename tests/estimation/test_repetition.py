"""Encoders that repeat themselves while the gyro turns, in odometries that are used by hand. Truth: the way of a base on paper that turns
evenly, summed up exactly, and the gyro's bias as it was put in."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from wbmpc.bases.planar_motion.odometry import PlanarOdometry
from wbmpc.bases.swerve.fused_odometry import FusedOdometry
from wbmpc.estimation.repetition import RESTS, Repetition
from wbmpc.lie import se2_step
from wbmpc.model.robot import load_robot
from wbmpc.model.wheels import rolling_inverse_kinematics

SWERVE, DIFFERENTIAL = load_robot("swerve-ur10"), load_robot("differential-ur10")
PERIOD, BIAS = 0.005, 0.002
#: What an odometry is given: time, wheels' angles, gyro.
Take = Callable[[float, np.ndarray, float], np.ndarray]


class Swerve:
    """Turns on the spot while it drives ahead."""

    def __init__(self) -> None:
        geometry, leg = SWERVE.base.geometry, SWERVE.home[SWERVE.state["leg"]]
        self.odometry = FusedOdometry(geometry)
        self.twist = np.array([0.3, 0.0, 0.5])
        steer, self.rates = rolling_inverse_kinematics(geometry, leg, np.zeros(4), self.twist)
        self.take: Take = lambda t, wheel, gyro: self.odometry.update(t, leg, steer, wheel, gyro)
        self.bias = lambda: self.odometry.gyro_bias


class Differential:
    """The same on two wheels."""

    def __init__(self) -> None:
        base = DIFFERENTIAL.base
        self.odometry = PlanarOdometry(base.twist, base.rates, np.zeros(3))
        self.twist, self.rates = base.twist @ np.array([0.3, 0.5]), base.rates @ np.array([0.3, 0.5])
        self.take: Take = self.odometry.update
        self.bias = lambda: self.odometry.gyro.bias


def error(base: Swerve | Differential, seconds: float, said: Callable[[int, float], bool]) -> float:
    """After 3 s of standing and some seconds of driving: the odometry's largest error [m, rad]; ``said(k, t)``: whether message k, t [s]
    after the drive has begun, has new angles; the last one has."""
    pose, wheel, shown = np.zeros(3), np.zeros(len(base.rates)), np.zeros(len(base.rates))
    count = round((3.0 + seconds) / PERIOD)
    for k in range(count + 1):
        t = k * PERIOD
        if drives := t >= 3.0:
            pose, wheel = se2_step(pose, base.twist * PERIOD), wheel + base.rates * PERIOD
        if said(k, t - 3.0) or k == count:
            shown = wheel.copy()
        found = base.take(t, shown, BIAS + drives * base.twist[2])
    return float(np.abs(found - pose).max())


@pytest.mark.parametrize("make", [Swerve, Differential])
@pytest.mark.parametrize("frozen", [0.5, 3.0])
def test_encoders_that_stand_still_for_a_while_teach_no_bias(make: type[Swerve | Differential], frozen: float) -> None:
    base = make()
    assert error(base, 8.0, lambda k, t: not 2.0 <= t < 2.0 + frozen) < 0.01
    assert base.bias() == pytest.approx(BIAS, abs=5e-4)


@pytest.mark.parametrize("make", [Swerve, Differential])
def test_an_inertial_unit_may_be_faster_than_encoders(make: type[Swerve | Differential]) -> None:
    base = make()
    assert error(base, 8.0, lambda k, t: k % 8 == 0) < 0.01
    assert base.bias() == pytest.approx(BIAS, abs=5e-4)


@pytest.mark.parametrize("make", [Swerve, Differential])
def test_a_base_that_others_turn_on_blocked_wheels_learns_no_bias(make: type[Swerve | Differential]) -> None:
    """It was turned by 1 rad, and what its wheels say then is believed again."""
    base = make()
    still = np.zeros(len(base.rates))
    for k in range(round(20.0 / PERIOD)):
        base.take(k * PERIOD, still, BIAS + 0.5 * (3.0 <= k * PERIOD < 5.0))
    assert base.bias() == pytest.approx(BIAS, abs=5e-4)
    wheel = still
    for k in range(round(20.0 / PERIOD), round(22.0 / PERIOD)):
        wheel = wheel + base.rates * PERIOD
        found = base.take(k * PERIOD, wheel, BIAS + base.twist[2])
    assert found[2] == pytest.approx(1.0, abs=0.01)


def test_times_and_means_of_what_is_held_back() -> None:
    """By hand, in steps of 50 ms."""
    same, moved, r = np.zeros(2), np.ones(2), Repetition()
    assert r.count(0.0, -np.inf, same, 0.5) == (True, 0.5)  # the first one
    assert [r.count(t, 0.0, same, 0.5) for t in (0.05, 0.10)] == [(False, None)] * 2
    counts, rate = r.count(0.15, 0.0, moved, 0.8)
    assert counts and rate == pytest.approx((0.5 + 0.5 + 0.8) / 3.0)
    assert r.count(0.2, 0.15, moved, 0.1) == (True, 0.1)  # less than what a bias may be
    assert not r.count(0.25, 0.2, moved, 0.5).counts
    rests = [r.count(0.25 + 0.05 * k, 0.2, moved, 0.0) for k in range(1, 101)]
    assert (
        rests == [(False, None)] * 99 + [(True, None)] and 99 * 0.05 < RESTS <= 100 * 0.05
    )  # what it turned is no bias
    assert not r.count(5.3, 5.25, moved, 0.5).counts
    assert r.count(5.5, 5.25, moved, 0.5) == (True, None)  # a gap in time
    assert not r.count(5.55, 5.5, moved, 0.5).counts
    r.forget()
    assert r.count(0.05, 0.0, moved, 0.1) == (True, 0.1)
