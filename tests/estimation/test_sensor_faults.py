"""A ball robot's sensors that say what is not so. Truth: the faults put into a sound robot's messages, and MuJoCo's states."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from test_ball_filter import HOME, ROBOT, TORQUE, regulator

from wbmpc.bases.ball.estimator import BallEstimator
from wbmpc.bases.ball.joint_tracker import JointTracker
from wbmpc.bases.ball.messages import BallCommand, BallMeasurement
from wbmpc.bases.ball.perturbation import BallPerturbation
from wbmpc.bases.ball.plant import BallPlant

H, COUNT = 0.0025, 2.0 * np.pi / 2**17
#: When [s] the faults begin, and when they are looked at last.
START, END = 0.4, 0.7
Fault = Callable[[dict[str, np.ndarray], int], None]


class Sound(NamedTuple):
    """A robot that sways by 50 mm: its estimator at :data:`START`, then messages and true states (16)."""

    estimator: BallEstimator
    messages: list[BallMeasurement]
    states: list[np.ndarray]


@cache
def sound() -> Sound:
    p = BallPerturbation(state_age=0.0, actuator_time_constant=0.01)
    plant, estimator, limit = BallPlant(ROBOT.description, HOME, TORQUE, p, 0), BallEstimator(ROBOT, HOME), 4.0
    messages, states = [], []
    for k in range(round(END / H)):
        m = plant.measure()
        if k * H < START:
            estimator.update(m.time, m.wheel, m.arm, m.gyro, m.accel)
        else:
            messages.append(m)
            states.append(plant.state())
        target = HOME.copy()
        target[0] = 0.05 * np.sin(4.0 * m.time)
        plant.step(BallCommand(np.clip(TORQUE - regulator() @ (plant.state() - target), -limit, limit)), 5)
    return Sound(estimator, messages, states)


class Watched(NamedTuple):
    """What is said message by message; largest errors of place [m], tilt [rad], and the arm's rates [rad/s]."""

    said: list[tuple[str, ...]]
    place: float
    tilt: float
    rate: float

    def share(self, name: str) -> float:
        return float(np.mean([name in names for names in self.said]))

    @property
    def names(self) -> set[str]:
        return {n for names in self.said for n in names}


def watched(fault: Fault) -> Watched:
    """``fault`` changes the k-th message (fields as arrays)."""
    estimator, said, errors = deepcopy(sound().estimator), [], []
    for k, (m, state) in enumerate(zip(sound().messages, sound().states, strict=True)):
        given = {name: getattr(m, name).copy() for name in ("wheel", "arm", "gyro", "accel")}
        fault(given, k)
        errors.append(np.abs(estimator.update(m.time, **given) - state))
        said.append(estimator.faults)
    worst = np.max(errors, axis=0)
    return Watched(said, float(worst[:2].max()), float(worst[3:5].max()), float(worst[13:].max()))


def off(field: str, i: int, by: float, lasts: float = 1) -> Fault:
    """From message 20 on, for ``lasts`` messages, one number is off."""

    def fault(m: dict[str, np.ndarray], k: int) -> None:
        m[field][i] += by if 20 <= k < 20 + lasts else 0.0

    return fault


def stands(field: str, *flicker: int) -> Fault:
    """From the start on the numbers of a sensor stay; those of ``flicker`` by a count to and fro."""
    held: list[np.ndarray] = []

    def fault(m: dict[str, np.ndarray], k: int) -> None:
        held.append(m[field].copy())
        for i in flicker or range(3):
            m[field][i] = held[0][i] + (COUNT * (k % 3 - 1) if flicker else 0.0)

    return fault


def test_sound_sensors_are_not_accused() -> None:
    run = watched(lambda m, k: None)
    assert run.names == set() and run.place < 1e-3 and run.tilt < 5e-3


def test_an_encoder_that_stands_and_flickers_by_a_count_is_stalled() -> None:
    run = watched(stands("wheel", 0))
    assert run.share("wheel_0 stalled") > 0.7 and not run.names - {"wheel_0 stalled", "wheel_0 slips"}
    assert run.place < 2e-3


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        (off("gyro", 0, 35.0), "imu exceeds"),
        (off("gyro", 1, 1e9), "imu exceeds"),
        (off("accel", 0, 2000.0), "imu exceeds"),
        (off("gyro", 0, 3.0), "imu jumps"),
        (off("gyro", 2, 3.0), "imu jumps"),
        (off("accel", 0, 100.0), "imu jumps"),
    ],
)
def test_one_bad_message_of_the_inertial_unit_does_no_harm_and_wheels_are_not_blamed(fault: Fault, name: str) -> None:
    run = watched(fault)
    assert run.names == {name} and sum(map(len, run.said)) == 1
    assert run.place < 1e-3 and run.tilt < 5e-3


@pytest.mark.parametrize(("field", "by"), [("gyro", 3.0), ("accel", 100.0)])
def test_an_inertial_unit_that_stays_off_is_reported_so(field: str, by: float) -> None:
    """Eight in a row: then the run ends."""
    run = watched(off(field, 0, by, np.inf))
    assert all(names == ("imu jumps",) for names in run.said[20:28])


@pytest.mark.parametrize(("rate", "reported"), [(0.0, True), (6.0, True), (30.0, False)])
def test_an_arm_that_is_flung_explains_what_the_unit_says(rate: float, reported: bool) -> None:
    """An end effector that hits a door throws the arm through its stops, faster than the drives can (4 rad/s), and the base turns: the unit
    was blamed. Here the roll rate changes by 3 rad/s after 50 ms in which the first joint goes at ``rate``."""

    def flung(m: dict[str, np.ndarray], k: int) -> None:
        m["arm"][0] += rate * H * k
        m["gyro"][0] += 3.0 * (k >= 20)

    assert ("imu jumps" in watched(flung).names) == reported


def test_a_hit_is_no_bad_message() -> None:
    """The ball that runs onto a cable: 70 m/s² within a message, and the wheels slip."""
    assert not any("imu" in n for n in watched(off("accel", 0, 70.0)).names)


@pytest.mark.parametrize("field", ["gyro", "accel"])
def test_an_inertial_unit_that_repeats_itself_is_found(field: str) -> None:
    run = watched(stands(field))
    assert all("imu repeats" in names for names in run.said[10:]) and "imu repeats" not in run.said[9]


def test_a_unit_that_is_slower_than_the_encoders_does_not_stand_still() -> None:
    """Each of its messages comes four times."""
    last: list[np.ndarray] = []

    def slow(m: dict[str, np.ndarray], k: int) -> None:
        last.append(m["gyro"].copy())
        m["gyro"][:] = last[k - k % 4]

    assert not any("imu" in n for n in watched(slow).names)


def test_a_joints_reading_that_jumps_does_not_count() -> None:
    run = watched(off("arm", 1, 0.5))
    assert run.said[20] == ("arm_shoulder jumps",) and sum(map(len, run.said)) == 1
    assert run.rate < watched(lambda m, k: None).rate + 0.05


@pytest.mark.parametrize("by", [0.3, -0.45, -2.0 * np.pi])
def test_a_reading_that_stays_where_it_jumped_to_never_counts(by: float) -> None:
    """In 0.25 s the joint could have moved by far more than the smaller steps; the run ends after 20 ms."""
    run = watched(off("arm", 1, by, np.inf))
    assert not any(run.said[:20]) and all(names == ("arm_shoulder jumps",) for names in run.said[20:])


def jumps(intervals: np.ndarray, readings: np.ndarray) -> list[bool]:
    """Which ``readings`` (n) [rad] of a joint with a limit of 4 rad/s jump, ``intervals`` (n) [s] after those before."""
    tracker, found = JointTracker(readings[:1], 1e-5, 1e-3, 7e-4, speed=4.0), []
    for interval, reading in zip(intervals, readings, strict=True):
        tracker.update(interval, np.array([reading]))
        found.append(bool(tracker.jumped[0]))
    return found


def test_a_joint_that_was_merely_not_read_for_a_while_has_not_jumped() -> None:
    """It rests, turns at its limit while no message comes for 0.1 s, and goes on. Without that while it is a jump that stays."""
    pauses = np.full(60, H)
    pauses[20] = 0.1
    readings = 0.2 + 4.0 * np.cumsum(np.where(np.arange(60) < 20, 0.0, pauses))
    assert not any(jumps(pauses, readings))
    assert jumps(np.full(60, H), readings) == [False] * 20 + [True] * 40


def test_readings_that_come_back_count_at_once() -> None:
    """Wrong by less than 0.5 rad for 15 ms, in which the joint turns by 60 mrad."""
    readings = 4.0 * H * np.arange(60)
    for wrong in (0.45, -0.45):
        off = np.where((np.arange(60) >= 20) & (np.arange(60) < 26), wrong, 0.0)
        assert jumps(np.full(60, H), readings + off) == list(off != 0.0)
