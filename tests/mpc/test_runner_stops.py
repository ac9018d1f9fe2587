"""Safe stops of the real-time runner. Truth: faults put in on purpose, the times at which they must be seen worked out by hand."""

from __future__ import annotations

import logging
import re
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from realtime_toys import (
    PERIOD,
    FaultyMPC,
    Force,
    Measured,
    ToyRobot,
    at,
    freeze,
    lose,
    raises,
    virtual,
)
from wbmpc.errors import NotFinite, RunAborted
from wbmpc.runtime.clock import VirtualClock, follow
from wbmpc.runtime.runner import RealTimeRunner
from wbmpc.types import Observation


@pytest.fixture(autouse=True)
def quiet(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL + 1, "wbmpc")


def late_write(runner: RealTimeRunner, action: Callable[..., Any]) -> None:
    """From 0.5 s on."""
    write = runner.robot.write
    runner.robot.write = lambda c: action() if runner.clock.now() >= 0.5 else write(c)  # type: ignore[method-assign]


def late_command(runner: RealTimeRunner, action: Callable[..., Any]) -> None:
    command = runner.controller.command
    runner.controller.command = (  # type: ignore[method-assign]
        lambda t, p: action() if t >= 0.5 else command(t, p)
    )


def foresee(robot: ToyRobot) -> None:
    robot.frozen = Measured(robot.clock.now() + 3.0, robot.x)


def predict_nothing(runner: RealTimeRunner) -> None:
    """From 0.5 s on."""
    predict = runner.controller.predict
    runner.controller.predict = (  # type: ignore[method-assign]
        lambda t, until, plans: Observation(until, np.full(2, np.nan)) if t >= 0.5 else predict(t, until, plans)
    )


FAULTS: dict[str, tuple[Callable[[RealTimeRunner], None], str, bool]] = {
    "read raises": (
        lambda r: setattr(r.robot, "fault", at(201, raises("no bus"))),
        "0.500 s: the controller raised RuntimeError: no bus",
        True,
    ),
    "frozen": (
        lambda r: setattr(r.robot, "fault", at(201, freeze)),
        r"0.552 s: the measurement is 0.05[23] s old, the limit is 0.05 s",
        False,
    ),
    "not a number": (
        lambda r: setattr(r.robot, "fault", at(201, lose)),
        "0.500 s: measurement.x is not finite",
        False,
    ),
    "from the future": (
        lambda r: setattr(r.robot, "fault", at(201, foresee)),
        "0.500 s: the measurement is from 3.000 s ahead: its time is not the runner's",
        False,
    ),
    "prediction not finite": (
        predict_nothing,
        "0.500 s: the predicted state is not finite",
        False,
    ),
    "parameters not finite": (
        lambda r: setattr(r, "parameters", lambda: np.full(1, np.nan if r.clock.now() >= 0.5 else 0.0)),
        "0.500 s: the vector of model parameters is not finite",
        False,
    ),
    "write raises": (
        lambda r: late_write(r, raises("drive off")),
        "0.500 s: the controller raised RuntimeError: drive off",
        True,
    ),
    "the robot gives up": (lambda r: late_write(r, raises("it fell", RunAborted)), "0.500 s: it fell", False),
    "command raises": (
        lambda r: late_command(r, raises("lost")),
        "0.500 s: the controller raised RuntimeError: lost",
        True,
    ),
    "no number in the controller": (
        lambda r: late_command(r, raises("the estimate is not finite", NotFinite)),
        "0.500 s: the estimate is not finite",
        False,
    ),
    "command not finite": (
        lambda r: late_command(r, lambda: Force(np.array([np.inf]))),
        "0.500 s: command.u is not finite",
        False,
    ),
    "command NaN": (
        lambda r: late_command(r, lambda: Force(np.array([np.nan]))),
        "0.500 s: command.u is not finite",
        False,
    ),
    "command of another size": (
        lambda r: late_command(r, lambda: Force(np.zeros(2))),
        r"0.500 s: command.u has shape \(2,\), the first one had \(1,\)",
        False,
    ),
    "no numbers at all": (
        lambda r: late_command(r, lambda: Force(np.zeros(0))),
        r"0.500 s: command.u has shape \(0,\), the first one had \(1,\)",
        False,
    ),
    "no command": (
        lambda r: late_command(r, lambda: None),
        "0.500 s: the controller gave no command",
        False,
    ),
    "no numbers": (
        lambda r: late_command(r, lambda: Force("fast")),  # type: ignore[arg-type]
        "0.500 s: command.u is not made of numbers, got 'fast'",
        False,
    ),
    "the controller ends the interpreter": (
        lambda r: late_command(r, sys.exit),
        "0.500 s: the controller raised SystemExit: ",
        False,
    ),
    "another kind of command": (
        lambda r: late_command(r, lambda: np.zeros(1)),
        "0.500 s: command is of type ndarray, the first one was a Force",
        False,
    ),
}


def check_stopped(runner: RealTimeRunner, message: str, seconds: float = 1.0) -> None:
    report = runner.run(seconds)
    assert re.fullmatch(f"stopped at {message}", report.state)
    assert runner.stopped
    # stop() at every tick from then on, no command any more, the robot without drive
    when = float(report.state.split()[2])
    robot = runner.robot
    assert robot.stops >= round((seconds - when) / PERIOD)
    assert not robot.writes or max(robot.writes) <= when
    assert robot.u == 0.0


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_of_robot_or_controller_is_a_safe_stop(name: str) -> None:
    inject, message, raised = FAULTS[name]
    runner = virtual()
    inject(runner)
    check_stopped(runner, message)
    assert isinstance(runner.error, RuntimeError) == raised


def test_an_exception_of_the_mpc_is_a_safe_stop() -> None:
    runner = virtual(mpc=FaultyMPC(lambda n: raises("bad table")() if n == 10 else None))
    check_stopped(runner, r"0.182 s: the MPC raised RuntimeError: bad table")  # the tick after 9 · 0.02 + the offset
    assert isinstance(runner.error, RuntimeError)


def test_an_mpc_that_ends_the_interpreter_is_a_safe_stop() -> None:
    runner = virtual(mpc=FaultyMPC(lambda n: sys.exit(3) if n == 10 else None))
    check_stopped(runner, r"0.182 s: the MPC raised SystemExit: 3")


def test_threads_that_die_are_reported() -> None:
    """Whatever is raised outside a tick or a solve, here by the clock."""

    class Broken(VirtualClock):
        def wait(self, until: float) -> None:
            raise KeyboardInterrupt("no time")

    runner = virtual()
    control, worker = runner._begin()
    runner._mpc_thread(Broken(), worker)
    assert runner.board["failed"] and runner.board.text == "KeyboardInterrupt: no time"
    runner._control_thread(partial(follow, Broken(), control))
    assert runner.state == "stopped at 0.000 s: the controller raised KeyboardInterrupt: no time"
    assert runner.robot.stops == 1


def test_the_watchdog_waits_for_the_next_tick_only_from_when_it_is_due() -> None:
    """By hand: period 0.2 s, limit 0.09 s; the tick due at 0.2 s never begins, which the 17th look, one every 0.018 s, sees."""
    runner = virtual(control_rate=5.0, watchdog=0.09)
    control = runner._begin()[0]
    next(control)
    next(control)
    looks: list[bool] = []

    def look(after: float) -> bool:
        runner.clock.wait(runner.clock.now() + after)
        looks.append(runner.stopped)
        return len(looks) > 17

    runner._ended.wait = look  # type: ignore[method-assign, assignment]
    runner._watch()
    assert looks == [False] * 17 + [True]
    assert re.fullmatch(r"stopped at 0\.306 s: a tick .* not ended for 0\.106 s, the limit is 0\.09 s", runner.state)


def test_a_tick_that_begins_too_late_commands_nothing() -> None:
    """By hand: a process that is stopped as a whole while it waits for the tick at 0.2 s, and goes on at 0.3 s, limit 0.09 s."""
    runner = virtual(control_rate=5.0, watchdog=0.09)
    control = runner._begin()[0]
    next(control)
    next(control)
    runner.clock.wait(0.3)
    next(control)
    assert re.fullmatch(r"stopped at 0\.300 s: a tick .* began 0\.100 s late, the limit is 0\.09 s.*", runner.state)
    assert not runner.robot.writes


def test_a_tick_in_which_the_process_was_held_up_is_the_last() -> None:
    """By hand: the process is stopped as a whole in the middle of a tick, for 0.1 s, limit 0.09 s."""
    runner = virtual(control_rate=5.0, watchdog=0.09)
    control = runner._begin()[0]
    next(control)
    measure = runner.controller.measure

    def held_up(measurement: Any) -> None:
        measure(measurement)
        runner.clock.wait(runner.clock.now() + 0.1)

    runner.controller.measure = held_up  # type: ignore[method-assign]
    next(control)
    next(control)
    assert re.fullmatch(r"stopped at 0\.\d+ s: a tick .* took 0\.100 s, the limit is 0\.09 s.*", runner.state), (
        runner.state
    )


def test_the_command_of_a_tick_that_was_held_up_is_not_sent() -> None:
    """By hand: the process is stopped as a whole for 0.3 s while the tick at 0.5 s makes its command; the drives have stopped meanwhile."""
    runner = virtual()
    command = runner.controller.command

    def held_up(t: float, plans: Any) -> Any:
        if t >= 0.5:
            runner.clock.wait(t + 0.3)
        return command(t, plans)

    runner.controller.command = held_up  # type: ignore[method-assign]
    runner.run(1.0)
    assert 0.49 < runner.robot.writes[-1] < 0.5
    assert runner.robot.stops and re.fullmatch(r"stopped at 0\.800 s: a tick .* took 0\.300 s.*", runner.state)


def test_an_mpc_that_always_fails_leaves_its_policy_for_the_horizon() -> None:
    runner = virtual(mpc=FaultyMPC(lambda n: False if n > 10 else None))
    # the policy of the tick at 0.18 came into force at 0.1825 and was planned for 1 s
    check_stopped(runner, r"1.185 s: the policy is 1.00[23] s old, the limit is 1 s \(\d+ solves failed\)", 1.5)
    assert runner.report().failures > 40


def test_an_mpc_that_hangs_leaves_its_policy_for_its_greatest_age() -> None:
    durations = iter([0.0] * 10 + [100.0])
    runner = virtual(durations.__next__, max_policy_age=0.1)
    check_stopped(runner, r"0.285 s: the policy is 0.10[23] s old, the limit is 0.1 s \(0 solves failed\)")


def test_without_a_first_policy_the_robot_never_moves() -> None:
    runner = virtual(mpc=FaultyMPC(lambda n: False), patience=0.3)
    check_stopped(runner, r"0.302 s: no policy within 0.3 s \(16 solves failed\)")
    assert not runner.robot.writes


def test_a_stop_that_raises_is_reported_once_and_tried_again() -> None:
    runner, calls = virtual(), []

    def stop() -> None:
        calls.append(runner.clock.now())
        if runner.clock.now() > 0.4:
            raise OSError("no brake")

    runner.robot.stop = stop  # type: ignore[method-assign]
    runner.robot.fault = at(201, raises("no bus"))
    report = runner.run(1.0)
    assert report.state == (
        "stopped at 0.500 s: the controller raised RuntimeError: no bus; the robot's stop() raised OSError: no brake"
    )
    assert sum(t > 0.4 for t in calls) >= 200


def test_the_reason_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.ERROR, "wbmpc")
    runner = virtual()
    runner.robot.fault = at(201, raises("no bus"))
    runner.run(1.0)
    assert [r.getMessage() for r in caplog.records] == [runner.state]
    assert caplog.records[0].exc_info is not None
