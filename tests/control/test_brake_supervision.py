"""A swerve robot's controller looks after its brakes. Truth: faults put into the encoders by hand."""

from __future__ import annotations

import numpy as np
import pytest
from swerve_messages import HURRIED, PERIOD, SWERVE, constant_policy, message, swerve_input

from toys import robot
from wbmpc.bases.swerve.brake_monitor import CREEP, BrakeFault, BrakeMonitor
from wbmpc.bases.swerve.brake_supervision import POLL_PERIOD, SupervisionSettings
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.tracking import TrackingSettings
from wbmpc.errors import InputError
from wbmpc.mpc.policy_queue import PolicyQueue


def test_every_controller_of_hinged_legs_watches_their_brakes() -> None:
    """A closed leg moves by 3 mrad each 10 ms; reported to whoever listens, and kept as a message. Fixed legs have no brakes."""
    reported: list[object] = []
    controller, plans = (
        SwerveController(SWERVE, np.zeros(3), PERIOD, supervision=SupervisionSettings(report=reported.append)),
        PolicyQueue(),
    )
    plans.add(0.0, constant_policy(np.zeros(SWERVE.input.size)))
    for k in range(10):
        controller.measure(message(0.01 * k, leg=np.array([0.0, 0.0, 3e-3 * k, 0.0])))
        controller.command(0.01 * k, plans)
    name = SWERVE.state.groups["leg"][2]
    assert len(reported) == len(controller.faults) == 1 and str(controller.faults[0]).startswith(
        f"brake of {name} does not hold"
    )
    fixed = robot("swerve-fixed-ur10")
    assert SwerveController(fixed, np.zeros(3), PERIOD).supervision.monitor is None


def test_brakes_that_a_stop_closes_are_watched_as_closed() -> None:
    """Open ones would be said not to open after a plan has run out: the legs stand and nothing moves them."""
    controller, plans = SwerveController(SWERVE, np.zeros(3), PERIOD, brakes=lambda t: np.ones(4)), PolicyQueue()
    u = np.zeros(SWERVE.input.size)
    u[SWERVE.input["leg"]] = 0.4
    plans.add(0.0, constant_policy(u))
    controller.measure(message())
    controller.command(0.0, plans)
    controller.command(11.0, plans)
    assert controller.supervision.monitor is not None and not controller.supervision.monitor._open.any()  # type: ignore[union-attr]
    controller.command(2.0, plans)


def test_brakes_are_looked_at_every_10_ms(monkeypatch: pytest.MonkeyPatch) -> None:
    """A closed leg moves by 0.1 rad/s: reported when it has gone by 10 mrad more than creeps, and at most a look later."""
    controller, plans, looks = SwerveController(SWERVE, np.zeros(3), PERIOD), PolicyQueue(), []
    plans.add(0.0, constant_policy(np.zeros(SWERVE.input.size)))
    assert controller.supervision.monitor is not None
    update = controller.supervision.monitor.update
    monkeypatch.setattr(controller.supervision.monitor, "update", lambda seen: looks.append(seen.time) or update(seen))
    for k in range(60):
        controller.measure(message(k * PERIOD, leg=np.array([0.0, 0.0, 0.1 * k * PERIOD, 0.0])))
        controller.command(k * PERIOD, plans)
    assert looks == pytest.approx(0.01 * np.arange(15))
    (fault,) = controller.supervision.monitor.faults
    assert 0.0 <= fault.time - 0.01 / (0.1 - CREEP) < 0.01 + PERIOD


def test_brakes_are_judged_when_a_new_run_begins_at_0() -> None:
    """A leg slips 0.1 s after the clock has gone back from 1000 s: reported as in the first run."""
    controller = SwerveController(SWERVE, np.zeros(3), PERIOD)
    still = np.zeros(4)
    for start in (1000.0, 0.0):
        for k in range(80):
            controller.estimator.measured = message(start + k * PERIOD, leg=np.array([0.02 * (k > 40), 0.0, 0.0, 0.0]))
            controller.watch(start + k * PERIOD, still, still)
    assert controller.supervision.monitor is not None
    assert [f.time for f in controller.supervision.monitor.faults] == pytest.approx([1000.11, 0.11], abs=0.01)


def brake_faults(leg: float, is_open: bool, end: float, how: str = "") -> list[BrakeFault]:
    """What a controller reports until ``end`` [s] of a leg that is planned to turn by 0.2 rad/s and turns by ``leg`` [rad] within 50 ms:
    at once one that is closed, just before the end one that is open. ``how`` the run ends then: with "no plan" or a "stop".
    """
    monitor = BrakeMonitor(SWERVE.state.groups["leg"], expected=0.02, patience=0.1)
    reported: list[BrakeFault] = []
    brakes = lambda t: np.full(4, float(is_open))
    controller = SwerveController(
        SWERVE,
        np.zeros(3),
        PERIOD,
        brakes,
        tracking=TrackingSettings(planned_steering=False),
        supervision=SupervisionSettings(monitor=monitor, report=reported.append),
    )
    u, plans = np.zeros(SWERVE.input.size), PolicyQueue()
    u[SWERVE.input["leg"].start] = 0.2
    plans.add(0.0, constant_policy(u, start=end - 10.001 if how == "no plan" else 0.0))
    last = round(end / PERIOD)
    for k in range(last + 1):
        share = np.clip((k * PERIOD - (end - 0.05 if is_open else 0.0)) / 0.05, 0.0, 1.0)
        controller.measure(message(k * PERIOD, leg=np.array([leg * share, 0.0, 0.0, 0.0])))
        if k == last and how == "stop":
            controller.stop()
        else:
            controller.command(k * PERIOD, plans)
    return reported


@pytest.mark.parametrize("how", ["no plan", "stop"])
def test_a_brake_is_taken_back_although_a_stop_comes_first(how: str) -> None:
    """In the tick in which the message would come. Truth: the same run without the stop, and 0.02 rad at 0.2 - 0.08 rad/s."""
    slips, holds = brake_faults(0.1, False, 0.3)
    assert (slips.kind, holds.kind) == ("does not hold", "holds after all")
    assert holds.time == pytest.approx(0.05 + 0.02 / 0.12, abs=0.02)  # two looks
    assert [f.kind for f in brake_faults(0.1, False, holds.time, how)] == ["does not hold", "holds after all"]
    # the stop closes an open brake, but the leg has moved under the command before: 10.1 mrad at the last tick
    assert [f.kind for f in brake_faults(0.0101, True, 0.2525, how)] == ["does not open", "opens after all"]


def test_a_stop_that_lasts_costs_no_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    controller, plans, looks = SwerveController(SWERVE, np.zeros(3), PERIOD), PolicyQueue(), []
    plans.add(0.0, constant_policy(np.zeros(SWERVE.input.size), start=-10.1))
    assert controller.supervision.monitor is not None
    monkeypatch.setattr(controller.supervision.monitor, "update", lambda seen: looks.append(seen.time) or [])
    for k in range(40):
        controller.measure(message(k * PERIOD))
        controller.command(k * PERIOD, plans)
    assert len(looks) == 10


@pytest.mark.parametrize("leg", [np.full(4, np.nan), np.zeros(3)])
def test_a_stop_for_a_message_that_says_nothing_is_a_stop(leg: np.ndarray) -> None:
    """The loop stops the controller after its odometry has rejected the message."""
    controller, plans = SwerveController(HURRIED, np.zeros(3), PERIOD, lambda t: np.ones(4)), PolicyQueue()
    plans.add(0.0, constant_policy(swerve_input(3)))
    plans.activate(0.0)
    controller.measure(message())
    controller.command(0.0, plans)
    with pytest.raises(InputError, match="leg"):
        controller.measure(message(PERIOD, leg=leg))
    assert not controller.stop().brake.any() and controller.faults == []


def test_a_plan_that_is_not_finite_does_not_end_in_the_monitor() -> None:
    """What is commanded is rejected by who commands it; the stop after it still looks at the legs."""
    controller = SwerveController(HURRIED, np.zeros(3), PERIOD)
    controller.measure(message())
    controller.watch(0.0, np.zeros(4), np.full(4, 0.1))
    controller.watch(POLL_PERIOD, np.zeros(4), np.full(4, np.nan))
    controller.measure(message(2.0 * POLL_PERIOD, leg=np.array([0.02, 0.0, 0.0, 0.0])))
    controller.stop()
    (fault,) = map(str, controller.faults)
    assert "does not hold" in fault
