"""Sensors that fail with the estimator in the loop. Truth: the faults that were set, and MuJoCo's robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from effort import some
from wbmpc.bases.ball.messages import BallMeasurement
from wbmpc.bases.ball.sensors import SensorFault
from wbmpc.result import RunResult
from wbmpc.studies.minniti2019 import task as rezero_task
from wbmpc.studies.minniti2019.push import HAND_EXPERIMENT
from wbmpc.studies.minniti2019.push_settings import RezeroPushHandSettings
from wbmpc.studies.minniti2019.servo_plant import ServoPlant

START = 0.6


def pushed(monkeypatch: pytest.MonkeyPatch, *faults: SensorFault) -> RunResult:
    """One push of 60 N at 0.5 s."""

    class Faulty(ServoPlant):
        def __init__(self, *given: Any, **more: Any) -> None:
            super().__init__(*given, **more)
            self.sensors.faults = faults

    monkeypatch.setattr(rezero_task, "ServoPlant", Faulty)
    return HAND_EXPERIMENT.run(RezeroPushHandSettings(forces=(60.0,), settle_time=0.5, push_duration=0.1, pause=2.0), 0)


def stalled(number: int, of: Any = "wheel", start: float = START) -> SensorFault:
    return SensorFault("stalled", number, start, np.inf, of=of)


def test_an_arm_without_its_encoder_stops(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    result = pushed(monkeypatch, stalled(1, "arm"))
    assert not result.completed
    assert "the encoder of arm_shoulder stands still; motors off" in result.reason
    # before the arm has carried the robot over: it falls a second after the fault when nobody looks
    ended = result.log.times("state")[-1]
    assert START < ended < START + 0.3 and result.log.array("tilt")[-1] < 0.3
    assert (
        len(result.faults) == 1 and "arm_shoulder" in result.faults[0] and result.metrics["encoder_faults"].value == 1.0
    )
    assert [r.getMessage() for r in caplog.records if "stands still" in r.getMessage()] == result.faults


def test_two_wheels_are_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    """With one of three the robot goes on, and says so; with two it stops before its place is lost."""
    result = pushed(monkeypatch, stalled(0), stalled(1, start=1.0))
    assert not result.completed and "wheel_0 and wheel_1 stand still, and 2 are needed; motors off" in result.reason
    assert [f.split(" (")[0] for f in result.faults] == [f"the encoder of wheel_{i} stands still" for i in (0, 1)]
    # while the ball rolls along one line, a ball that spins on the floor would show the same
    assert START < float(result.faults[0].split("(")[1].split()[0]) < START + 0.4
    assert 1.0 < result.log.times("state")[-1] < 1.4
    assert result.metrics["estimated_position_error_max"].value < 0.02


def changed(monkeypatch: pytest.MonkeyPatch, fault: Callable[[BallMeasurement], BallMeasurement]) -> RunResult:
    """The same push, with messages that ``fault`` changes from 0.1 s on."""

    class Faulty(ServoPlant):
        def measure(self) -> BallMeasurement:
            m = super().measure()
            return fault(m) if m.time > 0.1 - 1e-9 else m

    monkeypatch.setattr(rezero_task, "ServoPlant", Faulty)
    return HAND_EXPERIMENT.run(RezeroPushHandSettings(forces=(60.0,), settle_time=0.5, push_duration=0.1, pause=2.0), 0)


@pytest.mark.parametrize("field", some(["gyro", "wheel", "arm"], [1]))
def test_a_reading_that_is_not_finite_ends_the_run_with_its_log(monkeypatch: pytest.MonkeyPatch, field: str) -> None:
    """It was raised as bad input: nothing was written, and the last torques stayed on."""
    result = changed(monkeypatch, lambda m: replace(m, **{field: getattr(m, field) * np.nan}))
    assert (
        not result.completed and result.reason.startswith("stopped at 0.10 s: ") and f"'{field}' needs" in result.reason
    )
    assert result.log.times("state")[-1] == pytest.approx(0.1 - 0.0025)


def test_an_accelerometer_that_says_nothing_stops_the_robot_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    result = changed(monkeypatch, lambda m: replace(m, accel=np.zeros(3)))
    assert "the inertial unit stands still for 0.1 s; motors off" in result.reason
    assert [f.split(" (")[0] for f in result.faults] == ["the inertial unit stands still"]
    assert result.log.array("tilt")[-1] < 0.2
