"""Brakes over time for drives and planner. Truth: a table of states worked out by hand; the MPC's plans."""

from __future__ import annotations

import numpy as np
import pytest

from toys import robot
from wbmpc.bases.swerve.brake_control import BrakeControl
from wbmpc.bases.swerve.brake_monitor import BrakeFault
from wbmpc.bases.swerve.defaults import SwerveCost, swerve_mpc
from wbmpc.errors import InputError
from wbmpc.ocp import ModeSchedule, Reference
from wbmpc.settings import MpcSettings
from wbmpc.types import Observation

SWERVE = robot("swerve-ur10")


def planned(schedule: ModeSchedule, t: float) -> list[float]:
    return list(schedule.modes[schedule.index(t)].values["brake"])


def test_a_leg_is_planned_open_only_when_its_brake_has_opened() -> None:
    reported: list[ModeSchedule] = []
    brakes = BrakeControl(SWERVE, delay=0.2, changed=reported.append)
    brakes.set(2.0, [1, 1, 0, 0])
    brakes.set(5.0, [0, 1, 0, 1])
    table = {
        1.0: ([0, 0, 0, 0], [0, 0, 0, 0]),
        2.1: ([1, 1, 0, 0], [0, 0, 0, 0]),
        2.3: ([1, 1, 0, 0], [1, 1, 0, 0]),
        5.1: ([0, 1, 0, 1], [0, 1, 0, 0]),  # closing: held at once; opening: not yet
        5.3: ([0, 1, 0, 1], [0, 1, 0, 1]),
    }
    for t, (commanded, plan) in table.items():
        assert list(brakes.commanded(t)) == commanded
        assert planned(reported[-1], t) == plan
    assert len(reported) == 3  # at the start and after each event


def test_events_at_any_time_and_in_any_command() -> None:
    brakes = BrakeControl(SWERVE)
    brakes.set(5.0, np.zeros(4))
    brakes.set(1.0, np.ones(4))
    brakes.set(3.0, [1, 0, 1, 0])
    brakes.set(3.0, [0, 1, 0, 1])  # a second thought
    assert [list(brakes.commanded(t)) for t in (0.9, 1.0, 3.0, 5.0)] == [[0] * 4, [1] * 4, [0, 1, 0, 1], [0] * 4]
    assert [len(brakes.schedule().events), len(brakes.schedule().modes)] == [3, 4]
    brakes.set(3.0, np.ones(4))  # nothing changes then: no event is left of it
    assert brakes.schedule().events == (1.0, 5.0)


def test_the_plan_takes_a_faulty_brake_as_it_is() -> None:
    brakes = BrakeControl(SWERVE)
    brakes.set(1.0, np.ones(4))
    brakes.accept(BrakeFault(1.5, 2, "leg_LB", "does not open", 0.1))
    assert list(brakes.commanded(2.0)) == [1, 1, 1, 1]
    assert planned(brakes.schedule(), 2.0) == [1, 1, 0, 1]
    brakes.accept(BrakeFault(1.5, 0, "leg_LF", "does not hold", 0.1))
    assert planned(brakes.schedule(), 0.0) == [1, 0, 0, 0]
    brakes.accept(BrakeFault(1.6, 2, "leg_LB", "opens after all", 0.01))
    assert planned(brakes.schedule(), 2.0) == [1, 1, 1, 1]
    brakes.accept(BrakeFault(1.7, 0, "leg_LF", "holds after all", 0.2))  # was reported not to hold
    assert planned(brakes.schedule(), 0.0) == [0, 0, 0, 0]


def test_the_next_command_of_a_brake_is_believed() -> None:
    """Of leg 1 alone: leg 0, which is not commanded, stays as it was found."""
    brakes = BrakeControl(SWERVE, delay=0.1)
    brakes.set(20.0, [0, 0, 0, 1])  # scheduled long before
    for leg in (0, 1):
        brakes.accept(BrakeFault(1.0, leg, "", "does not hold", 0.1))
    brakes.set(3.0, [0, 1, 0, 0])
    brakes.set(5.0, [0, 0, 0, 0])
    assert [planned(brakes.schedule(), t)[:2] for t in (2.0, 4.0, 6.0, 30.0)] == [[1, 1], [1, 1], [1, 0], [1, 0]]
    brakes.reset(7.0)  # what was found of leg 0 is not forgotten with the events, and leg 1 stays believed
    assert planned(brakes.schedule(), 7.0) == [1, 0, 0, 0]
    assert planned(brakes.schedule(), 20.2) == [1, 0, 0, 1]


def test_events_that_are_over_are_forgotten() -> None:
    """Sixty events one after the other, as on a bus: what is kept does not grow, and nothing changes from now on."""
    reported: list[ModeSchedule] = []
    brakes, every = BrakeControl(SWERVE, delay=0.2, changed=reported.append), BrakeControl(SWERVE, delay=0.2)
    for k in range(60):
        t = 0.15 * k
        state = [k % 2, k // 2 % 2, k // 3 % 2, 1]
        brakes.reset(t)
        brakes.set(t, state)
        every.set(t, state)
        assert len(reported[-1].modes) < 8
        for later in (0.0, 0.01, 0.1, 0.2, 0.21, 1.0):
            assert list(brakes.commanded(t + later)) == list(every.commanded(t + later))
            assert planned(reported[-1], t + later) == planned(every.schedule(), t + later)


def test_the_mpc_moves_open_legs_only() -> None:
    """Legs are asked to turn by 0.3 rad; the plan moves the two that are open, from when they are."""
    settings = MpcSettings(horizon=6.0, intervals=30, first_interval=0.0)
    mpc = swerve_mpc(SWERVE, settings, SwerveCost())
    brakes = BrakeControl(SWERVE, delay=0.2, changed=mpc.set_schedule)
    brakes.set(1.0, [1, 0, 0, 1])
    home, leg = SWERVE.home, SWERVE.state["leg"]
    goal = home.copy()
    goal[leg] -= 0.3 * np.sign(home[leg])
    mpc.reference["state"] = Reference.constant(goal)
    mpc.reference["end_effector"] = Reference.poses([0.0], *[np.atleast_2d(v) for v in SWERVE.pose(home)])
    mpc.reset(home)
    policy = mpc.update(Observation(0.0, home))
    moved = np.abs(policy.x[:, leg] - home[leg])
    assert moved[:, 1:3].max() < 1e-6
    assert moved[policy.times <= 1.2 + 1e-9][:, [0, 3]].max() < 1e-6
    assert moved[-1, [0, 3]].min() > 0.1


def test_bad_input_is_one_message() -> None:
    with pytest.raises(InputError, match="no brakes"):
        BrakeControl(robot("swerve-fixed-ur10"))
    with pytest.raises(InputError, match=r"0 .closed. or 1 .open."):
        BrakeControl(SWERVE, [0, 1])
    with pytest.raises(InputError, match="finite"):
        BrakeControl(SWERVE).set(np.inf, np.zeros(4))
