"""How the real-time runner ends. Truth: what a real SIGINT leaves of a process and its robot; a solve that never ends by itself."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import pytest

from realtime_toys import FaultyMPC, ToyController, ToyRobot, make_mpc, wait_for
from wbmpc.errors import InputError
from wbmpc.runtime.clock import VirtualClock, WallClock
from wbmpc.runtime.runner import RealTimeRunner
from wbmpc.runtime.safety import RealTimeSettings

PERIOD = 1.0 / 400.0
PATIENT = RealTimeSettings(max_observation_age=30.0, watchdog=30.0, patience=60.0, max_policy_age=30.0)

RUN = """
import signal
from realtime_toys import ToyController, ToyRobot, make_mpc
from wbmpc import RealTimeRunner, RealTimeSettings, WallClock

class Reporting(ToyRobot):
    def write(self, command):
        super().write(command)
        if len(self.writes) == 10:
            print("drives", flush=True)

signal.signal(signal.SIGINT, signal.default_int_handler)  # also where whoever started this ignores it
clock = WallClock()
robot = Reporting(clock)
settings = RealTimeSettings(max_observation_age=60.0, watchdog=60.0, max_policy_age=60.0, patience=60.0)
try:
    RealTimeRunner(robot, ToyController(1 / 400), make_mpc(), settings, clock).run(120.0)
except KeyboardInterrupt:
    print("interrupted", robot.u, robot.stops > 0)
"""


def test_ctrl_c_stops_the_robot(tmp_path: Path) -> None:
    script = tmp_path / "run.py"
    script.write_text(RUN)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])}
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, env=environment, text=True) as run:
        assert run.stdout is not None and run.stdout.readline() == "drives\n"
        run.send_signal(signal.SIGINT)
        assert run.communicate(timeout=60.0)[0] == "interrupted 0.0 True\n"


def test_the_robot_is_stopped_before_the_mpc_has_ended() -> None:
    """A solve hangs until somebody waits for its end: the robot has been stopped by then."""
    hangs, release = threading.Event(), threading.Event()

    def hang(number: int) -> None:
        if number == 10:
            hangs.set()
            release.wait(60.0)

    clock = WallClock()
    robot = ToyRobot(clock)
    runner = RealTimeRunner(robot, ToyController(PERIOD), FaultyMPC(hang), PATIENT, clock)
    runner.start()
    assert hangs.wait(60.0) and wait_for(lambda: robot.u != 0.0)
    thread, inputs = runner._threads[1], []
    join = thread.join

    def wait_for_it(timeout: float | None = None) -> None:
        inputs.append(robot.u)
        release.set()
        join(timeout)

    thread.join = wait_for_it  # type: ignore[method-assign]
    runner.shutdown()
    assert inputs == [0.0] == [robot.u]
    assert not any(thread.is_alive() for thread in runner._threads)


def test_a_priority_that_is_not_to_be_had(monkeypatch: pytest.MonkeyPatch) -> None:
    def reject(thread: int, *ignored: object) -> None:
        assert thread == runner._threads[0].native_id
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", reject)
    clock = WallClock()
    runner = RealTimeRunner(ToyRobot(clock), ToyController(PERIOD), make_mpc(), replace(PATIENT, priority=50), clock)
    with pytest.raises(InputError, match=r"priority 50 is not to be had \(Operation not permitted\)"):
        runner.start()
    assert not any(thread.is_alive() for thread in runner._threads) and runner.robot.stops > 0


def test_a_runner_runs_once_in_virtual_time_too() -> None:
    clock = VirtualClock()
    runner = RealTimeRunner(ToyRobot(clock), ToyController(PERIOD), make_mpc(), PATIENT, clock)
    assert runner.run(0.1).ticks == 41
    with pytest.raises(InputError, match=r"can be started once; it is: shut down after 0\.1 s"):
        runner.run(0.1)
