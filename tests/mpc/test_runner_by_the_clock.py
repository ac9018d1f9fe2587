"""The real-time runner by the wall clock, in threads and in two processes. Truth: what must not happen any more after a fault; the
kernel's list of processes and threads."""

from __future__ import annotations

import logging
import os
import re
import signal
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from effort import thorough
from realtime_toys import (
    FaultyMPC,
    ToyController,
    ToyRobot,
    at,
    freeze,
    lose,
    make_faulty,
    make_killed,
    make_mpc,
    make_nothing,
    problem,
    raises,
    wait_for,
)
from wbmpc.errors import InputError
from wbmpc.mpc.mpc import MPC
from wbmpc.runtime.clock import WallClock
from wbmpc.runtime.runner import RealTimeRunner
from wbmpc.runtime.safety import RealTimeSettings
from wbmpc.runtime.shared_memory import Sizes

PERIOD = 1.0 / 400.0


@pytest.fixture(autouse=True)
def quiet(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL + 1, "wbmpc")


def real(mpc: Any = None, fault: Callable[[ToyRobot], None] = lambda robot: None, **settings: Any) -> RealTimeRunner:
    """Generous limits: the machine may be busy."""
    clock = WallClock()
    given = {"max_observation_age": 30.0, "watchdog": 30.0, "patience": 60.0, "max_policy_age": 30.0, **settings}
    return RealTimeRunner(
        ToyRobot(clock, fault),
        ToyController(PERIOD),
        mpc or make_mpc(),
        RealTimeSettings(**given),
        clock,
        sizes=Sizes.of(problem()),
    )


def test_threads() -> None:
    runner, others = real(), threading.active_count()
    with runner:
        assert wait_for(lambda: runner.own["policies"] > 20)
        assert runner.state == "running"
        with pytest.raises(InputError, match="can be started once"):
            runner.start()
    assert runner.state.startswith("shut down after")
    report = runner.report()
    assert report.ticks > 20 and report.updates > 20 and report.solve.count > 20
    assert 0.0 < report.ready.median <= report.latency.median
    assert runner.robot.u == 0.0 and threading.active_count() == others


def test_an_exception_in_the_mpc_thread() -> None:
    runner = real(FaultyMPC(lambda n: raises("bad table")() if n == 5 else None))
    with runner:
        assert wait_for(lambda: runner.stopped)
    assert "the MPC raised RuntimeError: bad table" in runner.state
    assert runner.robot.stops > 0


def test_a_tick_that_hangs_is_stopped_from_outside() -> None:
    release = threading.Event()
    runner = real(fault=at(20, lambda robot: release.wait(120.0) and None), watchdog=1.0)
    with runner:
        assert wait_for(lambda: runner.stopped)
        previous = runner.robot.stops
        assert wait_for(lambda: runner.robot.stops > previous + 3)
        writes = len(runner.robot.writes)
        release.set()
    assert re.search(r"a tick of the controller has not ended for \d+\.\d+ s, the limit is 1 s", runner.state)
    assert len(runner.robot.writes) == writes


def test_mpc_in_a_process_and_its_sudden_end() -> None:
    runner = real(partial(make_mpc, 100.0))
    with runner:
        assert wait_for(lambda: runner.own["policies"] > 20)
        assert runner.state == "running" and runner.process_id != os.getpid()
        os.kill(runner.process_id, signal.SIGKILL)
        assert wait_for(lambda: runner.stopped)
    assert runner.state.endswith("the MPC's process has ended with exit code -9")
    assert runner.report().failures == 0


def test_a_process_that_cannot_make_its_mpc(capfd: pytest.CaptureFixture[str]) -> None:
    runner = real(make_nothing)
    with pytest.raises(InputError, match="did not come up: ValueError: no robot of that name"):
        runner.start()
    assert "no robot of that name" in capfd.readouterr().err  # with its traceback


def test_a_process_that_is_killed_before_it_is_ready() -> None:
    with pytest.raises(InputError, match="did not come up: it ended with exit code -9"):
        real(make_killed).start()


# ---------------------------------------------------------------------- the same faults in threads and in two processes
STOPPED = r"stopped at (\d+\.\d+) s: "
#: Limits [s] wide enough for a busy machine.
AGE = 1.0


def faulty(mode: str, fault: str) -> MPC | Callable[[], MPC]:
    return make_faulty(fault) if mode == "thread" else partial(make_faulty, fault)


def healthy(mode: str) -> MPC | Callable[[], MPC]:
    return make_mpc() if mode == "thread" else make_mpc


def check_safe(runner: RealTimeRunner, message: str) -> float:
    """It has stopped with that reason; nothing is written any more, and stop() comes at every tick. Returns when."""
    assert wait_for(lambda: runner.stopped)
    found = re.fullmatch(STOPPED + message, runner.state)
    assert found, runner.state
    writes, stops = len(runner.robot.writes), runner.robot.stops
    assert wait_for(lambda: runner.robot.stops > stops + 3)
    assert len(runner.robot.writes) == writes and runner.robot.u == 0.0
    return float(found[1])


@pytest.mark.parametrize("mode", ["thread", pytest.param("process", marks=thorough)])
def test_solves_that_fail_leave_the_policy_its_horizon(mode: str) -> None:
    with real(faulty(mode, "fails"), max_policy_age=None) as runner:
        assert wait_for(lambda: runner.report().failures > 3)
        last = runner.plans.current
        assert runner.state == "running" and last is not None
        when = check_safe(runner, r"the policy is \d+\.\d+ s old, the limit is 1 s \(\d+ solves failed\)")
    assert when - last.valid_from > 1.0  # type: ignore[attr-defined]
    assert runner.robot.writes[-1] - last.valid_from > 0.7  # type: ignore[attr-defined]


@pytest.mark.parametrize("mode", ["thread", "process"])
def test_a_late_solve_does_not_stop_and_one_that_hangs_does(mode: str) -> None:
    with real(faulty(mode, "late")) as runner:
        assert wait_for(lambda: runner.own["policies"] > 40)
        assert runner.state == "running"
    assert runner.report().mpc_skipped >= 5  # 0.25 s at 50 Hz
    with real(faulty(mode, "hangs"), max_policy_age=AGE) as runner:
        check_safe(runner, r"the policy is \d+\.\d+ s old, the limit is 1 s \(0 solves failed\)")
        if mode == "process":
            os.kill(runner.process_id, signal.SIGKILL)  # do not wait for it


@pytest.mark.parametrize("mode", ["thread", pytest.param("process", marks=thorough)])
@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (freeze, r"the measurement is \d+\.\d+ s old, the limit is 1 s"),
        (lose, r"measurement\.x is not finite"),
    ],
    ids=["stale", "nan"],
)
def test_observations_that_are_stale_or_no_numbers_stop(
    mode: str, fault: Callable[[ToyRobot], None], message: str
) -> None:
    runner = real(
        healthy(mode), fault=lambda r: fault(r) if runner.state == "running" else None, max_observation_age=AGE
    )
    with runner:
        check_safe(runner, message)
    assert runner.robot.writes  # it had been moving


def test_a_process_that_is_suspended() -> None:
    """What a debugger or a full machine does: the process is there, and says nothing."""
    with real(make_mpc, max_policy_age=AGE) as runner:
        assert wait_for(lambda: runner.state == "running")
        os.kill(runner.process_id, signal.SIGSTOP)
        check_safe(runner, r"the policy is \d+\.\d+ s old, the limit is 1 s \(0 solves failed\)")
        os.kill(runner.process_id, signal.SIGKILL)
