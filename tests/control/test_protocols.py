"""Controllers are assembled from parts. Truth: the protocols, and the signatures of the classes."""

from __future__ import annotations

import inspect
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from toys import robot
from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.estimator import BallEstimator
from wbmpc.bases.ball.messages import BallMeasurement
from wbmpc.bases.ball.ros import BusBallController
from wbmpc.bases.ball.sensor_faults import BallReadings, EncoderMonitor
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.bases.planar_motion.controller import PlanarController
from wbmpc.bases.planar_motion.messages import PlanarMeasurement
from wbmpc.bases.swerve.brake_monitor import BrakeMonitor, SwerveReadings
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.messages import SwerveMeasurement
from wbmpc.bases.swerve.ros import BusSwerveController, DeferredMonitor
from wbmpc.control.direct import DirectController, StateMeasurement
from wbmpc.control.monitor import Monitor, SimpleFault
from wbmpc.control.protocols import RobotController
from wbmpc.studies.minniti2019.force import ForceMonitor, ForceReadings
from wbmpc.studies.pankert2022.rolling import RollingController

#: Constructor arguments that a controller may have.
MAXIMUM = 8
SWERVE, BALL = robot("swerve-ur10"), robot("rezero")


@pytest.mark.parametrize(
    "kind", [SwerveController, BusSwerveController, RollingController, BallController, BusBallController]
)
def test_a_controller_has_few_arguments(kind: type) -> None:
    assert 3 <= len(inspect.signature(kind).parameters) <= MAXIMUM


def found_by_brakes(monitor: Monitor[SwerveReadings]) -> object:
    """A closed leg that has moved by 0.1 rad after a second."""
    still = np.zeros(1)
    monitor.update(SwerveReadings(0.0, still, still, still))
    return monitor.update(SwerveReadings(1.0, still + 0.1, still, still))


def found_by_encoders(monitor: Monitor[BallReadings]) -> object:
    """A jump, which is reported at once."""
    one = np.zeros(1)
    return monitor.update(BallReadings(0.5, 0.0025, one, one, None, ["elbow jumps"]))


def found_by_motion(monitor: Monitor[ForceReadings]) -> object:
    """A sensor of an end effector that touches feels 8 N, the motion says 20 N, for half a second."""
    return [fault for k in range(200) for fault in monitor.update(ForceReadings(0.0025 * k, 0.0025, True, 8.0, 20.0))]


@pytest.mark.parametrize(
    ("monitor", "found"),
    [
        (ForceMonitor(), found_by_motion),
        (BrakeMonitor(["leg"]), found_by_brakes),
        (EncoderMonitor(3, ["elbow"]), found_by_encoders),
    ],
)
def test_monitors_return_the_faults_that_are_new(monitor, found) -> None:  # type: ignore[no-untyped-def]
    """One protocol: a list of faults with a time and a message, of which each is returned once."""
    (fault,) = found(monitor)
    assert fault.time >= 0.01
    assert str(fault)


def test_a_deferred_monitor_finds_what_its_monitor_does() -> None:
    """On a bus ticks are judged later, by another thread. Truth: the same ticks, judged at once."""
    at_once, deferred = BrakeMonitor(["leg"]), DeferredMonitor(BrakeMonitor(["leg"]))
    expected = found_by_brakes(at_once)
    assert found_by_brakes(deferred) == [] != expected
    assert list(deferred.judged()) == expected and deferred.real == at_once.real


class Hot:
    """A monitor of a user: of one message, whatever its base."""

    def update(self, readings: object, /) -> list[SimpleFault]:
        return [SimpleFault(0.5, "a drive is hot")]


def messages() -> Iterator[tuple[RobotController[Any, Any], Any]]:
    """Controllers of all kinds, each with a message of its robot at home."""
    panda, planar, x = robot("panda"), robot("differential-ur10"), BALL.home
    solver = SimpleNamespace(simulate=lambda x, u, h: x, set_parameters=lambda values: None)
    mpc: Any = SimpleNamespace(dynamics=panda, solver=solver)
    yield DirectController(panda, mpc, 0.0025), StateMeasurement(0.0, panda.home)
    still, arm = np.zeros(2), np.zeros(6)
    yield PlanarController(planar, np.zeros(3), 0.0025), PlanarMeasurement(0.0, still, arm)
    yield SwerveController(SWERVE, np.zeros(3), 0.0025), SwerveMeasurement(0.0, *np.zeros((3, 4)), arm)
    ball = BallController(
        BALL, mpc, np.zeros(BALL.input.size), 0.0025, DriveSettings(), observer=False, estimator=BallEstimator(BALL, x)
    )
    ball._steps_alike = False  # no solver of the model here
    gravity = np.array([0.0, 0.0, 9.81])
    yield ball, BallMeasurement(0.0, x, 0.0, np.zeros(3), x[BALL.state["arm"]], np.zeros(3), gravity)


def test_a_monitor_of_a_user_reports_to_every_controller() -> None:
    """It is appended to the controller's monitors: no file of a base is edited."""
    for controller, message in messages():
        controller.monitors.append(Hot())  # type: ignore[attr-defined]
        assert not controller.faults
        controller.measure(message)
        if isinstance(controller, SwerveController):  # its monitors compare with what is commanded
            controller.watch(0.0, np.zeros(4), np.zeros(4))
        assert list(map(str, controller.faults)) == ["a drive is hot (0.50 s)"], type(controller)


TYPED = """
from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.sensor_faults import BallReadings, EncoderMonitor
from wbmpc.bases.swerve.brake_monitor import BrakeMonitor, SwerveReadings
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.control.monitor import Monitor
from wbmpc.control.protocols import RobotController
from wbmpc.studies.minniti2019.force import ForceMonitor, ForceReadings

def check(swerve: SwerveController, ball: BallController, one: EncoderMonitor, two: BrakeMonitor, three: ForceMonitor) -> None:
    monitors: tuple[Monitor[BallReadings], Monitor[SwerveReadings], Monitor[ForceReadings]] = one, two, three
    controllers: tuple[RobotController, RobotController] = swerve, ball
    wrong: Monitor[BallReadings] = two
"""


def test_the_protocols_are_those_of_the_classes(tmp_path: Path) -> None:
    """Truth: mypy, which finds the one wrong line."""
    (tmp_path / "typed.py").write_text(TYPED)
    source = Path(__file__).parents[2] / "src"
    options = ("--follow-imports=silent", "--ignore-missing-imports", "--config-file=", f"--cache-dir={tmp_path}")
    done = subprocess.run(
        [sys.executable, "-m", "mypy", *options, "typed.py"],
        cwd=tmp_path, env={**os.environ, "MYPYPATH": str(source)}, capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert re.findall(r"typed.py:(\d+): error", done.stdout) == [str(TYPED.count("\n"))], done.stdout
