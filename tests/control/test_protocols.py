"""Controllers are assembled from parts. Truth: the protocols, and the signatures of the classes."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

from toys import robot
from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.fall_detection import FallPredictor
from wbmpc.bases.ball.ros import BusBallController
from wbmpc.bases.ball.sensor_faults import EncoderMonitor
from wbmpc.bases.swerve.brake_monitor import BrakeMonitor
from wbmpc.bases.swerve.brake_supervision import LegGuard
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.messages import SwerveMeasurement
from wbmpc.bases.swerve.ros import BusSwerveController, DeferredMonitor
from wbmpc.control.protocols import Estimator, Fault, Monitor
from wbmpc.studies.minniti2019.force import ForceMonitor
from wbmpc.studies.pankert2022.rolling import RollingController

#: Constructor arguments that a controller may have.
MAXIMUM = 8
SWERVE, BALL = robot("swerve-ur10"), robot("rezero")


@pytest.mark.parametrize(
    "kind", [SwerveController, BusSwerveController, RollingController, BallController, BusBallController]
)
def test_a_controller_has_few_arguments(kind: type) -> None:
    assert 3 <= len(inspect.signature(kind).parameters) <= MAXIMUM


def found_by_brakes(monitor: Monitor) -> object:
    """A closed leg that has moved by 0.1 rad after a second."""
    still = np.zeros(1)
    monitor.update(0.0, still, still, still)
    return monitor.update(1.0, still + 0.1, still, still)


def found_by_guard(monitor: Monitor) -> object:
    """An open leg that moves by 0.1 rad though its plan stands."""
    monitor.update(0.0, np.zeros(1), np.zeros(1), np.ones(1))
    return monitor.update(0.01, np.full(1, 0.1), np.zeros(1), np.ones(1))


def found_by_encoders(monitor: Monitor) -> object:
    """A jump, which is reported at once."""
    one = np.zeros(1)
    return monitor.update(0.5, 0.0025, one, one, None, ["elbow jumps"])


def found_by_lean(monitor: Monitor) -> object:
    """A robot that lies on its side for 0.1 s."""
    x = BALL.home.copy()
    x[3] += 1.5
    monitor.update(0.0, x)
    return monitor.update(0.1, x)


def found_by_motion(monitor: Monitor) -> object:
    """A sensor of an end effector that touches feels 8 N, the motion says 20 N, for half a second."""
    return [fault for k in range(200) for fault in monitor.update(0.0025 * k, 0.0025, True, 8.0, 20.0)]


@pytest.mark.parametrize(
    ("monitor", "found"),
    [
        (ForceMonitor(), found_by_motion),
        (FallPredictor(BALL, BALL.home[BALL.state["arm"]]), found_by_lean),
        (BrakeMonitor(["leg"]), found_by_brakes),
        (LegGuard(1), found_by_guard),
        (EncoderMonitor(3, ["elbow"]), found_by_encoders),
    ],
)
def test_monitors_return_the_faults_that_are_new(monitor, found) -> None:  # type: ignore[no-untyped-def]
    """One protocol: a list of faults with a time and a message, of which each is returned once."""
    assert isinstance(monitor, Monitor)
    (fault,) = found(monitor)
    assert isinstance(fault, Fault) and fault.time >= 0.01
    assert str(fault)


def test_a_deferred_monitor_finds_what_its_monitor_does() -> None:
    """On a bus ticks are judged later, by another thread. Truth: the same ticks, judged at once."""
    at_once, deferred = BrakeMonitor(["leg"]), DeferredMonitor(BrakeMonitor(["leg"]))
    assert isinstance(deferred, Monitor)
    expected = found_by_brakes(at_once)
    assert found_by_brakes(deferred) == [] != expected
    assert list(deferred.judged()) == expected and deferred.real == at_once.real


def test_an_estimator_gives_the_state_after_a_measurement() -> None:
    """Truth: the angles of the message; the base has not moved."""
    controller, state = SwerveController(SWERVE, np.zeros(3), 0.0025), SWERVE.state
    assert isinstance(controller.estimator, Estimator)
    arm = np.linspace(0.1, 0.6, 6)
    x = controller.estimator.update(SwerveMeasurement(0.0, np.full(4, 0.2), *np.zeros((2, 4)), arm))
    np.testing.assert_array_equal(x[state["arm"]], arm)
    np.testing.assert_array_equal(x[state["leg"]], 0.2)
    np.testing.assert_array_equal(x[state["base"]], 0.0)
    assert controller.estimator.faults == ()
