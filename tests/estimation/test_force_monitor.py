"""A force sensor that is not believed. Truth: faults put into the messages of a sound sensor, at known times."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from wbmpc.bases.ball.messages import BallMeasurement
from wbmpc.errors import InputError, NotFinite
from wbmpc.studies.minniti2019.contact import ContactDetector
from wbmpc.studies.minniti2019.door_control import DoorController
from wbmpc.studies.minniti2019.force import (
    CONFIRMED,
    MAX_MISMATCH,
    MAX_ZERO,
    MISMATCH_TIME,
    ZERO_LEFT,
    ZERO_TIME,
    ForceMonitor,
    ForceReadings,
)

H, PUSH = 0.0025, np.array([0.0, 0.0, 8.0])


def judged(messages: list[np.ndarray]) -> tuple[float, ForceMonitor]:
    """When [s] the fault was reported (infinite: never), and the monitor."""
    monitor = ForceMonitor()
    for k, message in enumerate(messages):
        reading = monitor.judge(H, message)
        if monitor.fault:
            assert not reading.any()
            return k * H, monitor
    return np.inf, monitor


def noisy(n: int) -> list[np.ndarray]:
    return list(PUSH + 0.1 * np.random.default_rng(0).normal(size=(n, 3)))


@pytest.mark.parametrize(
    ("last", "says"),
    [(noisy(40)[-1], "same numbers"), (np.zeros(3), "same numbers"), (np.full(3, np.nan), "no finite numbers")],
)
def test_a_sensor_that_stands_is_found_after_25_ms(last: np.ndarray, says: str) -> None:
    """40 sound messages, then one and the same; zeros and what is no number too."""
    reported, monitor = judged(noisy(40) + [last] * 40)
    assert reported == pytest.approx(40 * H + 0.025, abs=1.01 * H) and says in monitor.fault


def test_sound_sensors_are_believed() -> None:
    """With noise; one whose messages come four times each; one without noise and a force that hardly changes; one with gaps."""
    slow = [m for m in noisy(40) for _ in range(4)]
    quiet = [PUSH + [0.0, 0.0, 1e-12 * k] for k in range(200)]
    gaps = [np.full(3, np.nan) if k % 12 > 2 else m for k, m in enumerate(noisy(200))]
    for messages in (noisy(400), slow, quiet, gaps):
        assert judged(messages)[0] == np.inf
    monitor = ForceMonitor()
    monitor.judge(H, PUSH)
    np.testing.assert_array_equal(monitor.judge(H, np.full(3, np.nan)), PUSH)  # the one before counts


def test_a_spike_does_not_count_and_a_hit_does() -> None:
    """One message of 200 N every tenth; 45 N that come at once, and stay, count from the second message on."""
    monitor, messages = ForceMonitor(), noisy(60)
    for k, message in enumerate(messages):
        read = monitor.judge(H, message + [0.0, 0.0, 200.0 * (k % 10 == 5)])
        np.testing.assert_array_equal(read, messages[k - 1] if k % 10 == 5 else message)
    hit = [monitor.judge(H, m + [0.0, 45.0, 0.0])[1] for m in noisy(3)]
    assert hit[0] < 1.0 and min(hit[1:]) > 44.0 and monitor.judge(H, PUSH)[1] > 44.0 and not monitor.judge(H, PUSH)[1]


@pytest.mark.parametrize(
    ("touching", "measured", "estimated", "fault"),
    [
        (True, 8.0, 8.0 + MAX_MISMATCH - 0.1, ""),
        (True, 8.0, 8.0 - MAX_MISMATCH - 0.1, "measures 8.0 N, the robot's motion shows 4.9 N"),
        (True, 8.0, 8.0 + MAX_MISMATCH + 0.1, "measures 8.0 N, the robot's motion shows 11.1 N"),
        (False, 0.0, MAX_MISMATCH + 0.1, "pushed by 3.1 N that the force sensor does not measure"),
        (False, 0.0, -2.0 * MAX_MISMATCH, ""),
    ],
)
def test_a_sensor_that_the_motion_contradicts_is_found(
    touching: bool, measured: float, estimated: float, fault: str
) -> None:
    monitor, reported = ForceMonitor(), np.inf
    for k in range(200):
        for _ in range(k == 50):  # once it agrees: the time restarts
            monitor.update(ForceReadings(k * H, H, touching, measured, measured))
        if monitor.update(ForceReadings(k * H, H, touching, measured, estimated)):
            reported = min(reported, k * H)
    assert reported == (pytest.approx(50 * H + MISMATCH_TIME, abs=2 * H) if fault else np.inf)
    assert fault in monitor.fault and bool(fault) == bool(monitor.fault)


def test_bad_messages_are_rejected() -> None:
    monitor = ForceMonitor()
    with pytest.raises(InputError, match="'force' needs 3"):
        monitor.judge(H, np.zeros(2))
    with pytest.raises(InputError, match="interval"):
        monitor.judge(0.0, np.zeros(3))
    with pytest.raises(NotFinite, match="force sensor: 'estimated'"):
        monitor.update(ForceReadings(0.0, H, True, 8.0, np.nan))


@pytest.mark.parametrize("off", [0.0, 0.9 * ZERO_LEFT, 2.6, 0.9 * MAX_ZERO, 1.1 * MAX_ZERO])
def test_a_sensor_is_zeroed_at_rest(off: float) -> None:
    """Noise of 0.1 N about a zero that is off; it was right until it jumped there, four averages before. What an ordinary
    zeroing leaves is not touched, to the bit; what no sound sensor has is reported, not taken out."""
    rng, monitor = np.random.default_rng(1), ForceMonitor()
    wrong = off * np.array([0.6, 0.0, -0.8])
    for k in range(round(8.0 * ZERO_TIME / H)):
        monitor.rest(H, (k * H > 4.0 * ZERO_TIME) * wrong + 0.1 * rng.normal(size=3))
    fault = monitor.tare()
    assert fault == monitor.fault and bool(fault) == (off > MAX_ZERO)
    assert ("5.4 N where nothing touches" in fault) == (off > MAX_ZERO)  # 98 % of it by now
    if off <= MAX_ZERO:
        np.testing.assert_allclose(monitor.judge(H, PUSH + wrong), PUSH + (off < ZERO_LEFT) * wrong, atol=0.1)
    if off < ZERO_LEFT:
        np.testing.assert_array_equal(monitor.judge(H, PUSH), PUSH)
    zero = monitor.zero.copy()
    assert monitor.tare() == fault and np.array_equal(monitor.zero, zero)  # once


@pytest.mark.parametrize(("measured", "estimated", "reported"), [(2.6, 0.5, True), (2.1, 0.5, True), (2.6, 1.6, False)])
def test_a_touch_that_the_motion_does_not_know_is_none(measured: float, estimated: float, reported: bool) -> None:
    """A zero that moves by more than a touch's threshold, and by less than what contradicts the motion: the end effector ran against the
    panel with 45 N 0.3 s later. The motion's numbers swing by 1.5 N (as recorded), about their truth."""
    monitor, first = ForceMonitor(), np.inf
    for k in range(200):
        swings = estimated + 1.5 * np.sin(2.0 * np.pi * k * H / 0.05)
        if monitor.update(ForceReadings(k * H, H, k >= 20, measured if k >= 20 else 0.0, swings)):
            first = min(first, (k - 20) * H)
    assert first == (pytest.approx(CONFIRMED, abs=2 * H) if reported else np.inf)
    assert bool(monitor.fault) == reported and (not reported or "that the robot's motion does not" in monitor.fault)


def controller_with_stalled_sensor(begin: float) -> DoorController:
    """An end effector at rest with a level forearm, the panel above it; it starts at ``begin`` [s]."""
    controller = DoorController.__new__(DoorController)
    controller.phase, controller.period, controller.door, controller.measured = "approach", H, np.zeros(2), None
    controller.force, controller.monitor, controller._found = np.zeros(3), None, []
    controller.learned = SimpleNamespace(lean_control=None)  # type: ignore[assignment]
    controller.contact, controller.sensor = ContactDetector(), ForceMonitor()
    controller.push = SimpleNamespace(begin=begin, give_up=9.0, open=1.0, tip_weight=0.0)  # type: ignore[assignment]
    controller.robot = SimpleNamespace(home=None, pose=lambda x: (None, np.array([1.0, 0.0, 0.0, 0.0])))  # type: ignore[assignment]
    controller.geometry = SimpleNamespace(directions=lambda angle: (np.zeros(3), np.array([0.0, 0.0, -1.0])))  # type: ignore[assignment]
    return controller


@pytest.mark.parametrize(("off", "reported"), [(2.6, False), (6.5, True)])
def test_nothing_touches_before_the_hand_starts(off: float, reported: bool) -> None:
    """A zero that is off by 2.6 N was a touch at 0.01 s, and the closed panel learned in the air. 8 N from 2 s on are one."""
    controller, rng = controller_with_stalled_sensor(1.0), np.random.default_rng(2)
    for k in range(round(2.5 / H)):
        force = np.array([0.0, 0.0, off + 8.0 * (k * H >= 2.0)]) + 0.1 * rng.normal(size=3)
        controller._read_force(BallMeasurement(k * H, np.zeros(0), 0.0, force=force))
        assert controller.contact.touching == (not reported and k * H >= 2.0 + controller.contact.debounce - 1e-9)
    assert controller.force[2] == pytest.approx(0.0 if reported else 8.0, abs=0.5)
    assert len(controller._found) == reported and all(
        "reads 6.5 N where nothing touches (1.00 s)" in str(f) for f in controller._found
    )


@pytest.mark.parametrize("phase", ["approach", "push", "release"])
def test_a_controller_whose_sensor_stands_lets_go_and_measures_nothing_any_more(phase: str) -> None:
    """An end effector at rest with a level forearm; its sensor stands at 8 N. One report; neither force nor contact then, in any phase."""
    controller = controller_with_stalled_sensor(0.0)
    controller.phase = phase
    touched = False
    for k in range(60):
        controller._read_force(BallMeasurement(k * H, np.zeros(0), 0.0, force=PUSH))
        touched |= controller.contact.touching and controller.force[2] == 8.0
    assert touched and not controller.contact.touching and not controller.force.any()
    assert controller._ends(60 * H)
    assert len(controller.faults) == 1 and "the force sensor gives the same numbers" in str(controller.faults[0])
