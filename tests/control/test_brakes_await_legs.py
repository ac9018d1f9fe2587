"""Brakes that wait for their legs. Truth: times and angles by hand, of legs that go at a constant rate."""

from __future__ import annotations

import numpy as np
import pytest

from toys import robot
from wbmpc.bases.swerve.brake_control import ARRIVED, MAX_WAIT, POSTPONEMENT, BrakeControl
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.messages import SwerveMeasurement
from wbmpc.mpc.policy import Policy
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.ocp import ModeSchedule

SWERVE = robot("swerve-ur10")
PERIOD, GOAL = 0.0025, 0.3


def scheduled(reported: list[ModeSchedule] | None = None) -> BrakeControl:
    """Open from 0 to 2 s, and from 6 to 7 s; legs are to be at GOAL."""
    brakes = BrakeControl(SWERVE, changed=None if reported is None else reported.append)
    for t, is_open in ((0.0, 1.0), (2.0, 0.0), (6.0, 1.0), (7.0, 0.0)):
        brakes.set(t, np.full(4, is_open))
    brakes.arrivals = lambda t: np.full(4, GOAL)
    return brakes


def closed_at(brakes: BrakeControl, arrives: np.ndarray, until: float = 5.5, rate: float = 0.4) -> np.ndarray:
    """When [s] after 1 s each brake (4) closes, of legs that come at ``rate`` [rad/s] and are there at ``arrives`` (4) [s]."""
    closed = np.full(4, np.inf)
    for t in np.arange(1.0, until, PERIOD):
        brakes.await_legs(t, GOAL - rate * np.maximum(arrives - t, 0.0))
        closed = np.where((brakes.commanded(t) == 0.0) & np.isinf(closed), t, closed)
    return closed


def test_a_brake_closes_when_its_leg_has_arrived_and_the_others_on_time() -> None:
    brakes = scheduled()
    closed = closed_at(brakes, np.array([1.5, 2.9, 1.8, 3.4]))
    np.testing.assert_allclose(closed[[0, 2]], 2.0, atol=PERIOD)
    near = np.array([2.9, 3.4]) - ARRIVED / 0.4  # then they are within ARRIVED
    assert np.all(closed[[1, 3]] >= near) and np.all(closed[[1, 3]] <= near + POSTPONEMENT + PERIOD)


@pytest.mark.parametrize("start", [0.0, 4.0])
def test_a_leg_that_never_comes_is_waited_for_so_long_and_no_longer(start: float) -> None:
    """So it is the next time: what was waited before does not count."""
    brakes = scheduled()
    if start:
        closed_at(brakes, np.full(4, 100.0))
    due = 7.0 if start else 2.0
    for t in np.arange(max(start, 1.0), 12.0, PERIOD):
        brakes.await_legs(t, np.array([GOAL, 0.0, 0.0, GOAL]))
        if t >= due and not brakes.commanded(t)[1]:
            break
        assert t < due or list(brakes.commanded(t)) == [0.0, 1.0, 1.0, 0.0]
    assert due + MAX_WAIT - POSTPONEMENT - PERIOD <= t <= due + MAX_WAIT + PERIOD
    assert list(brakes.commanded(6.5)) == [1.0] * 4  # what was scheduled for later stays


def test_an_event_while_a_brake_waits_is_kept() -> None:
    """It opens the others at 2.05 s, and closes all at 2.5 s: the one that waited then waits from then on."""
    brakes = scheduled()
    brakes.set(2.05, np.array([1.0, 0.0, 1.0, 1.0]))
    brakes.set(2.5, np.zeros(4))
    late = np.array([GOAL, 0.0, GOAL, GOAL])
    seen = {}
    for t in np.round(np.arange(1.8, 5.0, PERIOD), 4):
        brakes.await_legs(t, late)
        seen[float(t)] = list(brakes.commanded(t))
    assert seen[2.025] == [0.0, 1.0, 0.0, 0.0] and seen[2.3] == [1.0] * 4 and seen[2.6] == [0.0, 1.0, 0.0, 0.0]
    assert seen[4.2] == [0.0] * 4


def test_without_arrivals_brakes_close_on_time_and_the_planner_knows_what_waits() -> None:
    reported: list[ModeSchedule] = []
    brakes = scheduled(reported)
    count = len(reported)
    brakes.arrivals = None
    brakes.await_legs(1.95, np.zeros(4))
    assert len(reported) == count and list(brakes.commanded(2.0)) == [0.0] * 4
    brakes.arrivals = lambda t: np.array([0.0, GOAL, 0.0, 0.0])
    brakes.await_legs(1.95, np.zeros(4))
    modes = reported[-1]
    assert list(modes.modes[modes.index(2.0 + 0.5 * POSTPONEMENT)].values["brake"]) == [0.0, 1.0, 0.0, 0.0]
    assert list(modes.modes[modes.index(2.0 + 1.5 * POSTPONEMENT)].values["brake"]) == [0.0] * 4


def test_the_controller_asks_its_legs_without_the_zeros_of_their_encoders() -> None:
    brakes, plans = scheduled(), PolicyQueue()
    controller = SwerveController(SWERVE, np.zeros(3), PERIOD, brakes)
    home, times = SWERVE.state.split(SWERVE.home), np.array([0.0, 10.0])
    still = np.zeros((1, SWERVE.input.size)), np.zeros((1, SWERVE.input.size, SWERVE.state.size))
    plans.add(0.0, Policy(times, np.tile(SWERVE.home, (2, 1)), *still))
    plans.activate(0.0)
    for t in np.arange(1.9, 2.02, PERIOD):
        controller.measure(SwerveMeasurement(t, home["leg"], home["steer"], home["wheel"], home["arm"]))
        command = controller.command(t, plans)
    assert list(command.brake) == [1.0] * 4  # home is X, far from GOAL
