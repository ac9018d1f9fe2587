"""Sensors that fail. Truth: motions by formula, how long a constant acceleration takes for a way, and times that are set."""

from __future__ import annotations

import numpy as np
import pytest

from wbmpc.bases.ball.sensor_faults import EncoderMonitor

H = 0.0025
JOINTS = ["one", "two"]


def swung(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles, speeds and accelerations of two joints that swing; a quarter of a count is lost."""
    w, a = np.array([2.0, 3.0]), np.array([0.3, 0.2])
    count = 2.0 * np.pi / 2**17
    angle = np.round(a * np.sin(w * t) / count) * count
    return angle, a * w * np.cos(w * t), -a * w**2 * np.sin(w * t)


def seconds_to_find(acceleration: float, load: float = 0.0) -> float:
    """Of a joint whose reading stays, the model giving it an acceleration from 0 s on, and ``load`` always."""
    monitor = EncoderMonitor(3, JOINTS)
    for k in range(-400, 4000):
        by_model = load + (acceleration if k >= 0 else 0.0)
        if monitor.update(k * H, H, np.zeros(2), np.zeros(2), np.array([by_model, 0.0]), ()):
            return k * H
    return np.inf


def test_a_joint_that_swings_is_no_fault_until_its_encoder_stands() -> None:
    monitor = EncoderMonitor(3, JOINTS)
    for k in range(2000):
        angle, speed, acceleration = swung(k * H)
        # the model errs by as much as it may
        assert not monitor.update(k * H, H, angle, speed, acceleration + [1.9, -1.9], ())
    assert not monitor.lost
    held = angle[1]
    for k in range(2000, 2200):
        angle, speed, acceleration = swung(k * H)
        new = monitor.update(k * H, H, np.array([angle[0], held]), np.array([speed[0], 0.0]), acceleration, ())
        if new:
            break
    assert [f.part for f in monitor.faults] == ["two"]
    assert monitor.lost == "the encoder of two stands still"
    assert abs(0.2 * np.sin(3.0 * k * H) - held) < 0.1
    assert str(new[0]) == f"the encoder of two stands still ({k * H:.2f} s)"


@pytest.mark.parametrize("acceleration", [4.0, -10.0])
def test_how_long_it_takes_at_rest(acceleration: float) -> None:
    """From rest a way s takes √(2 s / a)."""
    takes = np.sqrt(2.0 * 0.02 / (abs(acceleration) - 2.0))
    assert seconds_to_find(acceleration) == pytest.approx(takes, abs=2.0 * H)


@pytest.mark.parametrize(("acceleration", "load"), [(1.99, 0.0), (1.99, 20.0)])
def test_a_joint_that_friction_or_a_load_may_hold_is_no_fault(acceleration: float, load: float) -> None:
    """1 kg in the hand that nobody knows of is 20 rad/s² at the elbow."""
    assert seconds_to_find(acceleration, load) == np.inf


def test_readings_that_repeat_for_a_few_messages_are_no_fault() -> None:
    """At 8 rad/s three messages are 60 mrad."""
    monitor, rate = EncoderMonitor(3, JOINTS), np.full(2, 8.0)
    for k in range(400):
        monitor.update(k * H, H, np.full(2, 8.0 * 3 * (k // 3) * H), rate, np.zeros(2), ())
    assert not monitor.faults


def test_a_joint_at_its_stop_is_not_judged() -> None:
    zero, stops = np.zeros(2), (np.array([-0.005, -1.0]), np.ones(2))
    monitor = EncoderMonitor(3, JOINTS, stops)
    for k in range(400):
        monitor.update(k * H, H, zero, zero, np.full(2, 0.1 * k), ())
    assert [f.part for f in monitor.faults] == ["two"]


def test_wheels_count_once_the_filter_has_said_so_for_a_while() -> None:
    monitor, t = EncoderMonitor(3, JOINTS), 0.0

    def say(messages: int, *said: str) -> list[str]:
        nonlocal t
        new = []
        for _ in range(messages):
            t += H
            angle, speed, acceleration = swung(t)
            new += [f"{f.part} {f.kind}" for f in monitor.update(t, H, angle, speed, acceleration, said)]
        return new

    assert say(400, "ball spins") == []
    assert say(19, "wheel_0 slips") == []
    assert say(40) == []
    assert say(21, "wheel_0 slips") == ["wheel_0 slips"]
    assert say(30, "wheel_1 stalled") == ["wheel_1 stalled"]
    assert not monitor.lost
    # one that moves again is no longer lost, and is not told twice
    assert say(60) == [] and say(30, "wheel_1 stalled") == []
    assert say(21, "wheel_1 stalled", "wheel_2 stalled") == ["wheel_2 stalled"]
    assert monitor.lost == "the encoders of wheel_1 and wheel_2 stand still, and 2 are needed"


def test_rates_after_a_surprise_are_not_believed() -> None:
    """One reading that is off by 8 mrad leaves a rate of 4 rad/s, and accelerations to match, to a joint that rests."""

    def found(surprised: bool) -> list[str]:
        monitor = EncoderMonitor(3, JOINTS)
        for k in range(60):
            back = k == 31
            arm, rate = np.array([0.008 if k == 30 else 0.0, 0.0]), np.array([-4.0 * back, 0.0])
            doubt = np.array([surprised and k in (30, 31), False])
            monitor.update(k * H, H, arm, rate, np.array([0.0, 300.0 * back]), (), doubt)
        return [f.part for f in monitor.faults]

    assert found(True) == []
    assert "one" in found(False)


@pytest.mark.parametrize(
    ("said", "seconds", "why"),
    [
        ("ball slips", 0.4, "the ball slips or the inertial unit is wrong for 0.4 s"),
        ("imu exceeds", 0.02, "the inertial unit exceeds its range for 0.02 s"),
        ("imu jumps", 0.02, "the inertial unit jumps for 0.02 s"),
        ("imu repeats", 0.1, "the inertial unit stands still for 0.1 s"),
        ("two jumps", 0.02, "the encoder of two jumps for 0.02 s"),
        ("wheel_0 slips", np.inf, ""),
    ],
)
def test_what_lasts_ends_a_run_by_its_name(said: str, seconds: float, why: str) -> None:
    monitor, t = EncoderMonitor(3, JOINTS), 0.0
    while not monitor.lost and t < 1.0:
        t += H
        angle, speed, acceleration = swung(t)
        monitor.update(t, H, angle, speed, acceleration, (said,))
    assert t == pytest.approx(min(seconds, 1.0), abs=1.5 * H) and monitor.lost == why
    assert len(monitor.faults) == 1


def test_seldom_messages_end_a_run_after_three() -> None:
    monitor = EncoderMonitor(3, JOINTS)
    lost = []
    for k in range(3):
        monitor.update(0.05 * k, 0.05, *swung(0.05 * k), ("imu jumps",))
        lost.append(bool(monitor.lost))
    assert lost == [False, False, True]


def test_one_bad_message_of_the_inertial_unit_is_reported_and_ends_nothing() -> None:
    monitor = EncoderMonitor(3, JOINTS)
    for k in range(100):
        monitor.update(k * H, H, *swung(k * H), ("imu jumps",) if k == 40 else ())
    assert [str(f) for f in monitor.faults] == ["the inertial unit jumps (0.10 s)"] and not monitor.lost
