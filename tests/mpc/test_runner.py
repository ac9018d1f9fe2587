"""The real-time runner. Truth: the exact motion of a double integrator, timetables written by hand."""

from __future__ import annotations

import logging
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from realtime_toys import (
    PERIOD,
    FaultyMPC,
    Force,
    Measured,
    ToyController,
    ToyRobot,
    make_mpc,
    virtual,
)
from wbmpc.errors import InputError
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.runtime.clock import VirtualClock, WallClock
from wbmpc.runtime.runner import RealTimeRunner
from wbmpc.runtime.safety import Latency, RealTimeSettings, not_finite
from wbmpc.runtime.statistics import Punctuality, Report, Spread

#: MPC ticks follow the controller's by this [s].
OFFSET = 0.2 * PERIOD


@pytest.fixture(autouse=True)
def quiet(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL + 1, "wbmpc")


# ---------------------------------------------------------------------- what it is for
def test_the_robot_gets_to_its_goal_and_all_is_counted() -> None:
    runner = virtual(computing=0.004)
    report = runner.run(4.0)
    assert np.abs(runner.robot.x).max() < 0.01
    assert report.state == "shut down after 4.0 s"
    assert (report.ticks, report.misses, report.mpc_misses, report.failures) == (1601, 0, 0, 0)
    assert report.updates == 200 and report.repeated == 0 and report.clamped == 0
    # from the tick at 0: read by the MPC an offset later, 4 ms of computing, in force at the tick after that
    assert report.ready.median == pytest.approx(OFFSET + 0.004)
    assert report.latency.median == pytest.approx(0.005) == report.latency.p99
    assert report.policies == 200 and report.late == 1  # the first: nothing had been measured before it


def test_the_same_run_twice_is_the_same() -> None:
    one, two = (virtual(computing=0.0031) for _ in range(2))
    reports = [replace(r.run(1.0), solve=Spread.of(np.zeros(0))) for r in (one, two)]  # solve times are the machine's
    assert str(reports[0]) == str(reports[1])
    np.testing.assert_array_equal(one.robot.x, two.robot.x)


@pytest.mark.parametrize("computing", [0.001, 0.0071, 0.0162])
def test_latency_is_compensated(computing: float) -> None:
    """Every policy begins at the state that the robot has when it comes into force."""
    runner = virtual(computing)
    runner.run(2.0)
    was = {round(t / PERIOD): x for t, x in runner.robot.history}
    latest = [p for p in runner.controller.predictions if 0.3 < p.t < 1.9]
    used = [p for p in latest if round(p.t / PERIOD) in was]
    ahead = np.ceil((computing + OFFSET + runner.settings.margin) / PERIOD)
    assert runner.latency.ticks == ahead
    assert runner.own["late"] == (ahead > 1)  # the first one: nothing had been measured before it
    period = round(0.02 / PERIOD)
    # predictions that the MPC read: those of the ticks at its own rate; the plans they used did not change meanwhile
    error = [np.abs(p.x - was[round(p.t / PERIOD)]).max() for p in used if (round(p.t / PERIOD) - ahead) % period == 0]
    assert len(error) > 70
    assert max(error) < 1e-9


def test_the_compensation_has_a_limit() -> None:
    runner = virtual(0.0162, max_latency=0.006)
    report = runner.run(2.0)
    assert runner.latency.ticks == 3  # 6 ms in whole ticks
    assert report.late == report.policies > 90
    assert report.latency.median == pytest.approx(7 * PERIOD)


def test_latency_follows_the_percentile() -> None:
    latency = Latency(RealTimeSettings(window=100, percentile=95.0, margin=0.0))
    delays = np.random.default_rng(0).uniform(0.0, 0.02, 400)
    for delay in delays:
        latency.add(float(delay))
    assert latency.ticks == np.ceil(np.sort(delays[-100:])[94] / PERIOD)
    for _ in range(200):
        latency.add(0.001)
    assert latency.ticks == 1


def test_a_fast_mpc_repeats_the_observation() -> None:
    report = virtual(mpc=make_mpc(1000.0)).run(1.0)
    assert report.updates == 1000 and report.repeated == 600  # 400 ticks before the last of them
    assert report.failures == 0
    # the controller sees one policy per tick, but only its first answer shows how long an observation takes
    assert report.ready.count == 400 and report.ready.max < 0.001 + 1e-9
    assert report.latency.max == pytest.approx(PERIOD)


def test_one_delay_for_each_observation() -> None:
    """At a controller's tick without a new observation nothing is learned about the latency."""
    runner = virtual(mpc=make_mpc(1000.0))
    observe = runner._observe
    runner._observe = lambda due: observe(due) if round(due / PERIOD) % 4 == 0 else None  # type: ignore[method-assign]
    report = runner.run(1.0)
    assert report.ready.count == 100 and report.ready.max == pytest.approx(OFFSET)


def test_a_policy_waits_for_its_time() -> None:
    """Solves of different length: all policies come into force when they were planned to."""
    durations = iter([0.0121, 0.001, 0.004] * 100)
    runner = virtual(durations.__next__)
    report = runner.run(2.0)
    assert runner.latency.ticks == 6
    np.testing.assert_allclose(runner.own.samples("latency")[6:], 6 * PERIOD)
    assert report.ready.median == pytest.approx(0.004 + OFFSET)


def test_parameters_travel_with_the_observation() -> None:
    clock, mpc = VirtualClock(), make_mpc()
    runner = RealTimeRunner(
        ToyRobot(clock),
        ToyController(PERIOD),
        mpc,
        RealTimeSettings(),
        clock,
        parameters=lambda: np.array([clock.now()]),
    )
    runner.run(1.0)
    assert mpc.solver.parameters == pytest.approx(0.98)


def test_clamped_ticks_are_counted() -> None:
    asked, controller = 0, ToyController.command

    def command(self: ToyController, t: float, plans: PolicyQueue) -> Force:
        nonlocal asked
        asked += int(abs(plans.current(t, self.measured.x)[0]) > 0.5)  # type: ignore[misc]
        return controller(self, t, plans)

    runner = virtual(limit=0.5)
    runner.controller.command = command.__get__(runner.controller)  # type: ignore[method-assign]
    assert 0 < runner.run(2.0).clamped == asked < 800


# ---------------------------------------------------------------------- deadlines
def test_a_slow_tick_is_counted_and_the_grid_stays() -> None:
    runner = virtual()

    def slow(robot: ToyRobot) -> None:
        if robot.reads == 40:
            robot.clock.wait(robot.clock.now() + 2.4 * PERIOD)

    runner.robot.fault = slow
    report = runner.run(1.0)
    assert (report.misses, report.skipped) == (1, 2) and report.ticks == 399
    assert report.tick.max == pytest.approx(2.4 * PERIOD)
    times = np.array([t for t, _ in runner.robot.history]) / PERIOD
    np.testing.assert_allclose(times, np.round(times), atol=1e-6)


def test_a_slow_solve_is_counted_and_survived() -> None:
    durations = iter([0.002] * 10 + [0.055] + [0.002] * 1000)
    runner = virtual(durations.__next__)
    report = runner.run(2.0)
    # begins at 0.2005, ends at 0.2555: the deadlines 0.2205 and 0.2405 pass, it goes on at 0.2605
    assert (report.mpc_misses, report.mpc_skipped) == (1, 2) and report.updates == 98
    assert report.state.startswith("shut down") and report.late == 2
    assert np.abs(runner.robot.x).max() < 0.1


def test_misses_are_never_more_than_what_could_miss() -> None:
    """Every tick lasts six periods, and every solve three: each of them misses one deadline, its own."""
    runner = virtual(lambda: 0.06, max_policy_age=None)
    runner.robot.fault = lambda robot: robot.clock.wait(robot.clock.now() + 5.5 * PERIOD)
    report = runner.run(1.0)
    assert 0 < report.misses <= report.ticks < report.skipped
    assert 0 < report.mpc_misses <= report.updates < report.mpc_skipped


def test_a_failed_solve_keeps_the_last_policy() -> None:
    mpc = FaultyMPC(lambda n: False if 20 <= n < 25 else None)
    runner = virtual(mpc=mpc)
    report = runner.run(3.0)
    assert report.failures == 5 and report.policies == report.updates - 5
    assert report.state == "shut down after 3.0 s"
    assert np.abs(runner.robot.x).max() < 0.02


# ---------------------------------------------------------------------- who watches
def test_who_watches_sees_every_tick_and_may_fail() -> None:
    """The robot goes on as without a watcher that fails; it is called no more."""
    seen: list[float] = []

    def watch(t: float, late: float, plans: PolicyQueue) -> None:
        seen.append(t)
        assert late == 0.0 and plans.current is not None
        if len(seen) == 5:
            raise ValueError("nothing to see")

    runners = [virtual(), virtual()]
    runners[0].watch = watch
    reports = [runner.run(1.0) for runner in runners]
    np.testing.assert_allclose(np.diff(seen), PERIOD)
    assert len(seen) == 5 and len({(r.state, r.ticks, r.misses, r.updates, r.policies) for r in reports}) == 1
    np.testing.assert_array_equal(runners[0].robot.x, runners[1].robot.x)


# ---------------------------------------------------------------------- what is checked
def test_what_is_not_finite_is_named() -> None:
    assert not_finite("m", Measured(1.0, np.zeros(2))) is None
    assert not_finite("m", Measured(np.nan, np.zeros(2))) == "m.time"
    assert not_finite("m", Measured(1.0, np.array([1.0, np.inf]))) == "m.x"
    assert not_finite("c", [1.0, np.nan]) == "c"
    assert not_finite("c", 3) is None


def test_settings_are_checked() -> None:
    inf, nan = np.inf, np.nan
    senseless: dict[str, tuple[Any, ...]] = {
        "control_rate": (0.0, inf, nan, "a", None),
        "max_policy_age": (-1.0, nan, "b"),
        "max_observation_age": (0.0, nan),
        "patience": (0.0, inf),
        "watchdog": (inf, nan, -1.0, True),
        "percentile": (0.0, 101.0, nan),
        "window": (0, 2.5, nan, inf, True),
        "margin": (nan, -1.0, inf),
        "max_latency": (inf, nan, 0.0),
        "offset": (nan, 1e9, -1e-3, 10.0),
        "records": (0, 1.5, 1e9),
        "priority": (200, -1, 1.5, "high"),
        "keep_last_policy": ("no", 1),
    }
    assert set(senseless) == {f.name for f in fields(RealTimeSettings)}
    for name, values in senseless.items():
        for value in values:
            with pytest.raises(InputError, match=f"^real time: {name} must be .*, got {value!r}$"):
                RealTimeSettings(**{name: value})
    RealTimeSettings(control_rate=np.float64(5), window=np.int64(1), offset=0, margin=0, priority=99, records=1)
    with pytest.raises(InputError, match="needs 'sizes' and the wall clock"):
        RealTimeRunner(ToyRobot(WallClock()), ToyController(PERIOD), make_mpc)


def test_a_report_of_loops_that_go_on_misses_no_more_deadlines_than_there_were() -> None:
    """Another thread counts on between two reads: here a tick, or update, each of which misses its deadline."""

    class Counted(dict[str, float]):
        reads = 0
        note = ""

        def __getitem__(self, name: str) -> float:
            self.reads += 1
            return float(self.reads)

        def samples(self, name: str) -> np.ndarray:
            return np.zeros(1)

    report: Any = Report.of("running", 1.0, Counted(), Counted(), Punctuality())  # type: ignore[arg-type]
    assert report.misses <= report.ticks and report.mpc_misses <= report.updates and report.late <= report.policies
    assert report.failures <= report.updates
