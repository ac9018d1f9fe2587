"""The guard of open legs. Truth: legs that fall by φ = a t² / 2 and brakes that take 0.1 s, by hand; times added up by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from toys import robot
from wbmpc.bases.swerve.brake_control import BrakeControl
from wbmpc.bases.swerve.brake_monitor import BrakeFault
from wbmpc.bases.swerve.brake_supervision import LegGuard, SupervisionSettings
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.leg_folding import LegFolding
from wbmpc.bases.swerve.messages import SwerveMeasurement
from wbmpc.bases.swerve.ros import BusSwerveController, SwerveRosAdapter
from wbmpc.errors import InputError
from wbmpc.mpc.policy import Policy
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.ocp import ModeSchedule

PERIOD, CLOSES = 0.0025, 0.1
SWERVE = robot("swerve-ur10")
#: Of a leg that hangs on a slope of 3°: g sin(3°) over its length of 0.42 m [rad/s²].
FALL = 9.81 * np.sin(np.radians(3.0)) / 0.42


def watched(
    guard: LegGuard, moves: np.ndarray, plan: np.ndarray, seconds: float, start: float = 0.0
) -> list[np.ndarray]:
    """Which legs are held at each tick, of legs that turn at ``moves`` (n) [rad/s] unless they are held."""
    angle, held = np.zeros(len(moves)), []
    for t in start + PERIOD * np.arange(round(seconds / PERIOD)):
        guard.update(t, angle, plan, np.ones(len(moves)))
        held.append(guard.held(t))
        angle = angle + np.where(held[-1], 0.0, moves) * PERIOD
    return held


@pytest.mark.parametrize("guarded", [True, False])
def test_a_leg_that_falls_downhill_is_caught_within_five_degrees(guarded: bool) -> None:
    """Without the guard it falls for a second: by hand a t² / 2 = 0.61 rad."""
    guard, angle, rate, engaged = LegGuard(1), 0.0, 0.0, 0.0
    for t in PERIOD * np.arange(400):
        guard.update(t, [angle], [0.0], [1.0])
        closing = guarded and guard.holds[0] and t < guard.until[0]
        engaged = min(engaged + PERIOD / CLOSES, 1.0) if closing else 0.0
        rate = 0.0 if engaged >= 1.0 else rate + FALL * PERIOD
        angle += rate * PERIOD
        if guarded and guard.holds[0] and not closing:
            break  # its hold is over
    if guarded:
        assert guard.holds[0] == 1 and angle < np.radians(5.0)
    else:
        assert angle == pytest.approx(0.5 * FALL, rel=0.01)


def test_legs_that_stand_or_lag_behind_or_follow_are_not_held() -> None:
    """A brake would only keep them from where they are to go."""
    guard, plan = LegGuard(5), np.array([0.4, 0.4, -0.4, 0.3, 0.0])
    held = watched(guard, np.array([0.0, 0.1, -0.4, 0.35, 0.0]), plan, 3.0)
    assert not np.any(held) and not guard.holds.any()


def test_legs_that_go_the_other_way_or_too_fast_are_held() -> None:
    guard = LegGuard(3)
    watched(guard, np.array([-0.3, 0.3, 1.0]), np.array([0.3, 0.0, 0.2]), 0.3)
    assert list(guard.holds) == [1, 1, 1]


def test_a_leg_that_slides_is_held_where_its_foot_is_as_far_off() -> None:
    """0.2 m/s are the foot's speed at the end of a leg of 0.4 m that turns by 0.5 rad/s: both are 0.018 rad off after 0.040 s."""
    guard = LegGuard(2, ["m", "rad"])
    held = np.array(watched(guard, np.array([0.2, 0.5]), np.zeros(2), 0.2))
    np.testing.assert_allclose(np.argmax(held, axis=0) * PERIOD, 0.040, atol=2 * PERIOD)
    supervision = SwerveController(
        robot("telescope-ur10"), np.zeros(3), PERIOD, BrakeControl(robot("telescope-ur10"))
    ).supervision
    assert supervision.guard is not None
    supervision.guard_legs(0.0, np.zeros(4), np.zeros(4))
    supervision.commanded = lambda t: np.ones(4)
    supervision.guard_legs(0.01, np.zeros(4), np.zeros(4))
    supervision.guard_legs(0.02, np.array([0.006, 0.010, 0.0, 0.0]), np.zeros(4))
    assert supervision.guard.holds.tolist() == [0, 1, 0, 0]


def test_a_leg_that_always_goes_astray_is_held_longer_and_longer() -> None:
    """0.5 rad/s are 0.018 rad off (with the time constant 0.2 s) after −0.2 ln(1 − 0.018 / 0.1) = 0.040 s."""
    guard = LegGuard(1)
    held = np.array(watched(guard, np.array([0.5]), np.zeros(1), 6.0))[:, 0]
    edges = np.flatnonzero(np.diff(held.astype(int))) * PERIOD
    closed, opened = edges[::2], edges[1::2]
    np.testing.assert_allclose((opened - closed[: len(opened)])[:4], [0.3, 0.6, 0.6, 0.6], atol=2 * PERIOD)
    np.testing.assert_allclose(closed[1:] - opened[: len(closed) - 1], 0.040, atol=3 * PERIOD)


def test_legs_open_one_after_the_other_and_the_planner_knows_when() -> None:
    guard = LegGuard(3)
    watched(guard, np.full(3, 0.5), np.zeros(3), 0.1)
    assert guard.holds.all() and np.ptp(guard.until) == 0.0
    first, changed = guard.until[0], []
    for t in np.arange(0.1, 1.6, PERIOD):
        if guard.update(t, np.zeros(3), np.zeros(3), np.ones(3)):
            changed.append(t)
    np.testing.assert_allclose(guard.until - first, [0.0, 0.2, 0.4], atol=2 * PERIOD)
    assert len(changed) == 2


def test_a_brake_that_is_reported_to_close_or_does_not_hold_is_left_alone() -> None:
    guard, moves = LegGuard(2), np.array([0.5, 0.5])
    guard.give_up(1)
    watched(guard, moves, np.zeros(2), 0.2)
    assert list(guard.holds) == [1, 0]
    guard.update(
        0.3, np.zeros(2), np.zeros(2), np.zeros(2)
    )  # commanded to close: nothing is held besides, and both are believed again
    assert not guard.held(0.3).any() and guard.until[0] == 0.3
    watched(guard, moves, np.zeros(2), 0.2, start=0.4)
    assert list(guard.holds) == [2, 1]
    guard.give_up(1)  # while it is held: its time is not prolonged until its turn to open has come
    until = guard.until[1]
    for t in np.arange(0.6, 1.2, PERIOD):
        guard.update(float(t), np.zeros(2), np.zeros(2), np.ones(2))
    assert guard.until[1] == until


def test_times_may_restart_and_bad_numbers_are_rejected() -> None:
    guard = LegGuard(2)
    watched(guard, np.array([0.5, 0.0]), np.zeros(2), 0.2)
    assert guard.update(0.0, [3.0, 3.0], np.zeros(2), np.ones(2)), (
        "the planner has to report to that nothing is held any more"
    )
    assert not guard.held(0.0).any()
    for bad in ([np.nan, 0.0], [0.0]):
        with pytest.raises(InputError, match="leg guard: 'leg' needs 2 finite numbers"):
            guard.update(1.0, bad, np.zeros(2), np.ones(2))


def planned(schedule: ModeSchedule, t: float) -> list[float]:
    return list(schedule.modes[schedule.index(t)].values["brake"])


def test_the_plan_holds_a_leg_until_its_brake_has_opened_again() -> None:
    brakes = BrakeControl(SWERVE, delay=0.1)
    brakes.set(1.0, np.ones(4))
    brakes.accept(BrakeFault(1.5, 2, "leg_LB", "does not hold", 0.1))
    brakes.hold([-np.inf, 3.0, 3.5, -np.inf])  # leg_LB's brake has a new command: it is believed
    table = {2.9: [1, 0, 0, 1], 3.05: [1, 0, 0, 1], 3.15: [1, 1, 0, 1], 3.65: [1, 1, 1, 1]}
    for t, plan in table.items():
        assert planned(brakes.schedule(), t) == plan and list(brakes.commanded(t)) == [1, 1, 1, 1]
    brakes.set(3.3, np.zeros(4))
    assert planned(brakes.schedule(), 3.65) == [0, 0, 0, 0]
    for bad in ([np.nan] * 4, [np.inf] * 4, [1.0]):
        with pytest.raises(InputError, match="brakes: hold: 4 times"):
            brakes.hold(bad)


def standing() -> PolicyQueue:
    """A plan in which nothing moves."""
    plans, times = PolicyQueue(), np.array([0.0, 10.0])
    plans.add(
        0.0,
        Policy(
            times,
            np.tile(SWERVE.home, (2, 1)),
            np.zeros((1, SWERVE.input.size)),
            np.zeros((1, SWERVE.input.size, SWERVE.state.size)),
        ),
    )
    plans.activate(0.0)
    return plans


def swung(controller: SwerveController, seconds: float = 0.2) -> list[float]:
    """The brakes that are commanded at last, while leg 1 turns at 0.5 rad/s though the plan stands."""
    home, plans = SWERVE.state.split(SWERVE.home), standing()
    for t in PERIOD * np.arange(round(seconds / PERIOD)):
        leg = home["leg"] + [0.0, 0.5 * t, 0.0, 0.0]
        controller.measure(SwerveMeasurement(t, leg, home["steer"], home["wheel"], home["arm"]))
        command = controller.command(t, plans)
    return list(command.brake)


def opened(reported: list[ModeSchedule]) -> BrakeControl:
    brakes = BrakeControl(SWERVE, changed=reported.append)
    brakes.set(0.0, np.ones(4))
    return brakes


def test_the_controller_closes_the_brake_and_informs_the_planner() -> None:
    reported: list[ModeSchedule] = []
    controller = SwerveController(SWERVE, np.zeros(3), PERIOD, opened(reported))
    assert swung(controller) == [1, 0, 1, 1] and controller.holds == 1 and not controller.faults
    assert planned(reported[-1], 0.2) == [1, 0, 1, 1] and planned(reported[-1], 2.0) == [1, 1, 1, 1]
    controller.stop()
    assert planned(reported[-1], 0.2) == [1, 1, 1, 1]


def test_legs_that_fold_where_it_is_narrow_are_guarded() -> None:
    reported: list[ModeSchedule] = []
    controller = SwerveController(SWERVE, np.zeros(3), PERIOD)
    LegFolding.attach(SimpleNamespace(brakes=opened(reported)), controller)  # type: ignore[arg-type]
    assert swung(controller) == [1, 0, 1, 1] and planned(reported[-1], 0.2) == [1, 0, 1, 1]


def test_it_can_be_turned_off_and_rests_where_the_planner_would_not_know() -> None:
    controller = SwerveController(SWERVE, np.zeros(3), PERIOD, opened([]), supervision=SupervisionSettings(guard=False))
    assert swung(controller) == [1, 1, 1, 1] and controller.holds == 0
    controller = SwerveController(SWERVE, np.zeros(3), PERIOD, lambda t: np.ones(4))
    assert swung(controller) == [1, 1, 1, 1]
    controller = SwerveController(SWERVE, np.zeros(3), PERIOD, opened([]))
    controller.brakes = lambda t: np.ones(4)  # as a view does
    assert swung(controller) == [1, 1, 1, 1]


def test_on_a_bus_the_nodes_own_thread_informs_the_planner() -> None:
    reported: list[ModeSchedule] = []
    brakes = opened(reported)
    controller = BusSwerveController(SWERVE, np.zeros(3), PERIOD, brakes)
    assert swung(controller) == [1, 0, 1, 1] and planned(reported[-1], 0.2) == [1, 1, 1, 1]
    SwerveRosAdapter.inspect(SimpleNamespace(controller=controller, brakes=brakes))  # type: ignore[arg-type]
    assert planned(reported[-1], 0.2) == [1, 0, 1, 1]
