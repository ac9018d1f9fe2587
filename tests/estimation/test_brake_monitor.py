"""Brakes that do not answer. Truth: leg motions written by formula, with an encoder's steps."""

from __future__ import annotations

import numpy as np
import pytest

from toys import made
from wbmpc.bases.swerve.brake_monitor import BrakeMonitor, SwerveReadings
from wbmpc.errors import InputError

NAMES = ["a", "b", "c", "d"]
COUNT = 2.0 * np.pi / 2**14


def watch(leg, brake, rate, end: float = 6.0, period: float = 0.0025, **settings: float) -> BrakeMonitor:  # type: ignore[no-untyped-def]
    """A monitor after legs leg(t), brakes brake(t), rates rate(t) (4 each), at 400 Hz unless ``rate`` is set."""
    monitor = BrakeMonitor(NAMES, **settings)
    for t in np.arange(0.0, end, period):
        monitor.update(SwerveReadings(t, np.round(np.asarray(leg(t)) / COUNT) * COUNT, brake(t), rate(t)))
    return monitor


OPEN, CLOSED, STILL = np.ones(4), np.zeros(4), np.zeros(4)
SINE = lambda t: 0.3 * np.sin(t) * np.array([1.0, -1.0, 1.0, -1.0])
RATE = lambda t: 0.3 * np.cos(t) * np.array([1.0, -1.0, 1.0, -1.0])


def test_legs_that_do_what_they_should_are_not_reported() -> None:
    assert watch(SINE, lambda t: OPEN, RATE).faults == []
    assert watch(lambda t: STILL, lambda t: CLOSED, RATE).faults == []
    # less than planned, but they move
    assert watch(lambda t: 0.1 * SINE(t), lambda t: OPEN, RATE).faults == []


def test_a_closed_leg_that_moves() -> None:
    slips = lambda t: np.array([0.0, 0.0, -0.02 * max(0.0, t - 3.0), 0.0])
    (fault,) = watch(slips, lambda t: CLOSED, lambda t: STILL).faults
    assert (fault.leg, fault.kind) == (2, "does not hold")
    assert fault.time == pytest.approx(3.0 + 10.0 / 19.5, abs=0.03)  # 10 mrad at 20 mrad/s less 0.5 of creep
    assert "brake of c does not hold" in str(fault)


def test_an_open_leg_that_does_not_move() -> None:
    ramp = np.array([0.4, -0.4, 0.4, -0.4])
    stuck = lambda t: ramp * t * [1.0, 1.0, 1.0, 0.0]
    (fault,) = watch(stuck, lambda t: OPEN, lambda t: ramp, patience=0.1).faults
    assert (fault.leg, fault.kind) == (3, "does not open")
    # 0.32 rad/s of 0.4 count and reach 0.2 rad, a little later for what is forgotten
    assert 0.2 / 0.32 < fault.time < 0.2 / 0.32 + 0.1
    (fault,) = watch(stuck, lambda t: OPEN, lambda t: ramp).faults
    assert fault.time == pytest.approx(1.3, abs=0.01)


def test_a_leg_that_stands_for_a_second_is_no_fault() -> None:
    """As on a bump, where two wheels carry the robot and it turns in place of its legs; the plan asks for 0.4 rad/s."""
    stands = lambda t: 0.2 * np.array([min(t, 2.0) + max(t - 3.2, 0.0), 1.0 + t, t, t])
    assert watch(stands, lambda t: OPEN, lambda t: 0.4 + STILL).faults == []


def test_a_leg_that_is_held_by_small_rates_is_no_fault() -> None:
    """Encoder offsets make the plan turn a leg all the time that in fact stands: 5 mrad/s for two minutes."""
    assert watch(lambda t: STILL, lambda t: OPEN, lambda t: 0.005 + STILL, end=120.0, period=0.05).faults == []
    # and 0.06 rad/s, as the plan asks for to hold a leg against wheels that slip a little sideways, of slow legs too
    for limit in (0.4, 0.1):
        held = watch(lambda t: STILL, lambda t: OPEN, lambda t: 0.06 + STILL, end=120.0, period=0.05, limit=limit)
        assert held.faults == []


@pytest.mark.parametrize("limit", [0.1, 0.12, 0.2, 0.4])
def test_a_stuck_leg_is_reported_within_two_seconds_at_any_limit(limit: float) -> None:
    """Three legs move at 95 % of their limit, the fourth stands."""
    rate = 0.95 * limit * np.array([1.0, -1.0, 1.0, -1.0])
    (fault,) = watch(lambda t: rate * t * [1, 1, 1, 0], lambda t: OPEN, lambda t: rate, 3.0, limit=limit).faults
    assert (fault.leg, fault.kind) == (3, "does not open") and fault.time < 2.0


def test_creep_of_a_closed_leg_is_no_fault() -> None:
    """0.1 mrad/s for five minutes, 30 mrad in all; ten times faster is a fault."""
    creeps = lambda rate: watch(lambda t: rate * t + STILL, lambda t: CLOSED, lambda t: STILL, 300.0, 0.05).faults
    assert creeps(1e-4) == []
    assert len(creeps(1e-3)) == 4


def test_a_brake_that_slipped_once_holds_again() -> None:
    """Knocked by 0.1 rad within 0.05 s, then the leg stands; from when that is reported the plan moves it at 0.4 rad/s."""
    slip = lambda t: np.array([0.1 * np.clip((t - 2.0) / 0.05, 0.0, 1.0), 0.0, 0.0, 0.0])
    rate = lambda t: np.array([-0.4 * (t > 2.01), 0.0, 0.0, 0.0])
    monitor = watch(slip, lambda t: CLOSED, rate)
    (fault,), (back,) = monitor.faults, monitor.withdrawn
    assert (fault.leg, fault.kind, back.leg, back.kind) == (0, "does not hold", 0, "holds after all")
    assert 2.0 < fault.time < 2.02 and back.time == pytest.approx(2.05 + 1.3, abs=0.02)
    assert "holds after all: the leg was to move by -" in str(back)
    # one that really is free and goes as the plan says is not taken back
    free = lambda t: np.array([0.1 * min(max(t - 2.0, 0.0), 3.0), 0.0, 0.0, 0.0])
    monitor = watch(free, lambda t: CLOSED, lambda t: np.array([0.1, 0.0, 0.0, 0.0]), 5.0)
    assert len(monitor.faults) == 1 and monitor.withdrawn == []


def test_several_stuck_legs() -> None:
    """Legs that stand together are reported together; another is judged again once the plan holds those that were reported."""
    plan = lambda t: np.array([0.4, 0.4, 0.4, -0.4])
    monitor = watch(lambda t: STILL, lambda t: OPEN, plan)
    assert [(f.leg, f.time) for f in monitor.faults] == [(k, monitor.faults[0].time) for k in range(4)]
    # leg 1 moves for a second, then stands as well; leg 0 is held in the plan from 1.5 s on, or never
    stands = lambda t: np.array([0.0, 0.4 * min(t, 1.0), 0.4 * t, -0.4 * t])
    held = lambda t: np.array([0.4 * (t < 1.5), 0.4, 0.4, -0.4])
    monitor = watch(stands, lambda t: OPEN, held)
    assert [f.leg for f in monitor.faults] == [0, 1]
    assert monitor.faults[1].time == pytest.approx(1.5 + 0.25 + 1.3, abs=0.01)
    assert [f.leg for f in watch(stands, lambda t: OPEN, plan).faults] == [0]


def test_a_leg_that_moves_after_all_is_taken_back_and_judged_again() -> None:
    """A leg stands while its wheel hangs in the air, from 0 to 2 s and from 4 s on, and moves in between."""
    rate = lambda t: np.array([0.4, 0.0, 0.0, 0.0])
    leg = lambda t: np.array([0.2 * np.clip(t - 2.0, 0.0, 2.0), 0.0, 0.0, 0.0])
    monitor = watch(leg, lambda t: OPEN, rate)
    assert [f.kind for f in monitor.faults] == ["does not open"] * 2
    (back,) = monitor.withdrawn
    assert back.kind == "opens after all" and "opens after all: the leg moved by 0.010 rad" in str(back)
    assert monitor.faults[0].time < 2.0 < back.time < 2.1 and monitor.faults[1].time > 4.0


def test_brakes_take_their_time() -> None:
    """Legs coast for 0.2 s after the command to close, and start 0.2 s after the one to open."""
    coasting = lambda t: 0.2 * np.clip(t - 2.0, 0.0, 0.2) + STILL
    assert watch(coasting, lambda t: OPEN if t < 2.0 else CLOSED, lambda t: STILL).faults == []
    late = lambda t: 0.5 * max(0.0, t - 2.2) + STILL
    assert watch(late, lambda t: CLOSED if t < 2.0 else OPEN, lambda t: 0.5 + STILL, end=4.0).faults == []


def test_a_fault_is_reported_once_for_each_command() -> None:
    drift = lambda t: np.array([0.05 * t, 0.0, 0.0, 0.0])
    assert len(watch(drift, lambda t: CLOSED, lambda t: STILL).faults) == 1
    twice = watch(drift, lambda t: OPEN if 2.0 < t < 3.0 else CLOSED, lambda t: STILL).faults
    assert [f.leg for f in twice] == [0, 0] and twice[1].time > 3.25


def test_senseless_thresholds_are_rejected() -> None:
    for name, value in ((n, v) for n in ("expected", "patience") for v in (np.nan, np.inf)):
        with pytest.raises(InputError, match=f"'{name}' must be finite"):
            BrakeMonitor(NAMES, **{name: value})
    for limit in ([0.4, 0.4, 0.0, 0.4], [0.4, 0.4, np.nan, 0.4], [0.4, 0.4], "fast"):
        with pytest.raises(InputError, match=r"limit: one positive rate .* or 4 are needed"):
            BrakeMonitor(NAMES, limit=limit)  # type: ignore[arg-type]


def test_what_was_wrong_about_a_leg_is_not_real() -> None:
    """A leg that stood and then moved was sound; one that stands to the end is not; one that slipped and holds again did slip."""
    rate = lambda t: np.array([0.4, 0.0, 0.0, 0.0])
    leg = lambda t: np.array([0.2 * np.clip(t - 2.0, 0.0, 2.0), 0.0, 0.0, 0.0])
    monitor = watch(leg, lambda t: OPEN, rate)
    assert monitor.real == monitor.faults[1:] and len(monitor.faults) == 2
    slip = lambda t: np.array([0.1 * np.clip((t - 2.0) / 0.05, 0.0, 1.0), 0.0, 0.0, 0.0])
    monitor = watch(slip, lambda t: CLOSED, lambda t: np.array([-0.4 * (t > 2.01), 0.0, 0.0, 0.0]))
    assert len(monitor.withdrawn) == 1 and monitor.real == monitor.faults and len(monitor.real) == 1


def test_a_leg_that_drifts_slowly_is_reported() -> None:
    """2 mrad/s, as a hinge that no brake holds drifted under a base that drove on: 10 mrad and what creeps meanwhile."""
    (fault,) = watch(lambda t: np.array([2e-3 * t, 0.0, 0.0, 0.0]), lambda t: CLOSED, lambda t: STILL, 8.0).faults
    assert fault.leg == 0 and fault.time == pytest.approx(10.0 / 1.8, abs=0.3)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ((1.0, [np.nan, 0.0, 0.0, 0.0], CLOSED, STILL), "'leg' needs 4 finite"),
        ((1.0, np.zeros(3), CLOSED, STILL), "'leg' needs 4 finite"),
        ((1.0, STILL, np.full(4, np.nan), STILL), "'brake' needs 4 finite"),
        ((1.0, STILL, CLOSED, [0.0, np.inf, 0.0, 0.0]), "'rate' needs 4 finite"),
        ((np.nan, STILL, CLOSED, STILL), "'time' must be finite"),
        ((-0.01, STILL, CLOSED, STILL), "time must not go back, got -0.01 s after 0 s"),
    ],
)
def test_a_message_that_says_nothing_does_not_blind_the_monitor(wrong: tuple, words: str) -> None:
    """The leg slips by 20 mrad after it: as without the message, 10 mrad are reported."""
    monitor = BrakeMonitor(NAMES)
    monitor.update(SwerveReadings(0.0, STILL, CLOSED, STILL))
    with pytest.raises(InputError, match=words):
        monitor.update(SwerveReadings(*wrong))
    (fault,) = monitor.update(SwerveReadings(1.01, [0.02, 0.0, 0.0, 0.0], CLOSED, STILL))
    assert (fault.leg, fault.kind) == (0, "does not hold")


def test_the_first_message_may_be_bad() -> None:
    monitor = BrakeMonitor(NAMES)
    with pytest.raises(InputError, match="'leg'"):
        monitor.update(SwerveReadings(0.0, np.full(4, np.nan), CLOSED, STILL))
    assert monitor.update(SwerveReadings(0.0, STILL, CLOSED, STILL)) == []


def test_a_clock_that_restarts() -> None:
    """After 3 s at t = 1000 s from 0 again. Truth: a second monitor that begins there."""
    monitor, twin = BrakeMonitor(NAMES), BrakeMonitor(NAMES)
    turned = np.array([0.35, 0.0, 0.0, 0.0])
    for t in np.arange(1000.0, 1003.0, 0.01):
        monitor.update(SwerveReadings(t, STILL, CLOSED, STILL))
    with pytest.raises(InputError, match="time must not go back"):
        monitor.update(SwerveReadings(0.0, turned, CLOSED, STILL))
    monitor.restart_clock()
    slips = lambda t: turned * (1.0 + min(t, 1.0))
    reported = [
        [m.update(SwerveReadings(t, slips(t), CLOSED, STILL)) for t in np.arange(0.0, 2.0, 0.01)]
        for m in (monitor, twin)
    ]
    assert reported[0] == reported[1] and len(monitor.faults) == 1


def test_brakes_at_rest_are_judged_like_all_others() -> None:
    """Truth: a planned rate far below what counts takes the way of all others, and must give the same faults."""
    rng, one, other = np.random.default_rng(0), BrakeMonitor(list("abcd")), BrakeMonitor(list("abcd"))
    leg, brake, found = np.zeros(4), np.zeros(4), 0
    for k in range(1500):
        if rng.random() < 0.02:
            brake = np.zeros(4) if rng.random() < 0.7 else (rng.random(4) < 0.3).astype(float)
        rate = np.where(brake > 0.5, 0.2 * rng.normal(size=4), 0.0)
        leg = leg + 0.01 * rate + (rng.random() < 0.01) * 0.012 * rng.normal(size=4)
        faults = one.update(SwerveReadings(0.01 * k, leg, brake, rate))
        assert faults == other.update(SwerveReadings(0.01 * k, leg, brake, rate + 1e-300))
        found += len(faults)
    assert found > 5


def test_both_back_ends_find_the_same() -> None:
    """Legs that are held, slip, stand and move after all, under brakes that open and close at random."""
    rng, kinds = np.random.default_rng(5), set()
    one, other = BrakeMonitor(NAMES), made("interpreted", BrakeMonitor, NAMES)
    leg, brake, stuck = np.zeros(4), CLOSED, np.zeros(4, bool)
    for k in range(1500):
        if k % 250 == 0:
            brake, stuck = (rng.random(4) < 0.6).astype(float), rng.random(4) < 0.5
        rate = 0.3 * brake
        leg = leg + 0.01 * rate * ~stuck + (rng.random(4) < 0.002) * 0.02
        found = one.update(SwerveReadings(0.01 * k, leg, brake, rate))
        assert found == other.update(SwerveReadings(0.01 * k, leg, brake, rate))
        kinds |= {fault.kind for fault in found}
    assert {"does not hold", "does not open"} <= kinds


def test_thresholds_of_legs_that_slide_are_those_of_feet_that_go_as_far() -> None:
    """Three legs of four: one slips by 6 mm, at the end of a leg of 0.4 m 15 mrad; one stands though it is planned to slide by 0.3 m; one
    moves by 5 mm/s, 12.5 mrad/s of such a leg. The fourth is a hinge that turns by 6 mrad, which is none."""
    monitor = BrakeMonitor(NAMES, limit=0.17, units=["m", "m", "m", "rad"])
    for t in np.arange(0.0, 4.0, 0.0025):
        leg = np.array([6e-3 * (t > 2.0), 0.0, 5e-3 * t, 6e-3 * (t > 2.0)])
        monitor.update(SwerveReadings(t, leg, [0.0, 1.0, 1.0, 0.0], [0.0, 0.12, 0.12, 0.0]))
    assert [(f.name, f.kind, f.unit) for f in monitor.faults] == [
        ("b", "does not open", "m"), ("a", "does not hold", "m"),
    ]  # fmt: skip
    assert monitor.faults[1].angle == pytest.approx(6e-3, abs=1e-5)  # [m], as a ruler says
    assert monitor.faults[0].time < 2.0 and monitor.faults[1].time == pytest.approx(2.0, abs=0.01)
