"""A controller by a simulated time that has stood still for longer than its watchdog allows. Truth: by hand, on a wall clock that is set."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from wbmpc.ros2.clock import BusClock
from wbmpc.ros2.control import ControlNode
from wbmpc.ros2.settings import RosSettings


@pytest.mark.parametrize("balances", [False, True])
@pytest.mark.parametrize(
    ("speed", "silence", "stops"), [(1.0, 0.2, False), (1.0, 0.4, True), (0.3, 0.8, False), (0.3, 2.0, True)]
)
def test_time_that_goes_on_step_by_step_after_a_hold_up_moves_no_robot(
    speed: float, silence: float, stops: bool, balances: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process that was held up reads the messages of that time one after the other, in no time, and looks at the clock then only: every
    tick seems to be in time. The watchdog waits for 0.3 s of the bus's time, and never longer than 1 s. What balances goes on."""
    wall, clock, stopped = [10.0], BusClock(), []
    monkeypatch.setattr("time.monotonic", lambda: wall[0])
    settings = RosSettings(use_sim_time=True, safety={"watchdog": 0.3})
    control = SimpleNamespace(
        clock=clock, settings=settings, running=True, adapter=SimpleNamespace(must_keep_running=balances),
        node=SimpleNamespace(publishers=lambda *given: [1]), _stop_runner=stopped.append,
    )  # fmt: skip
    control._clock_lost = lambda: ControlNode._clock_lost(control)  # type: ignore[arg-type]
    check = lambda: ControlNode._check_clock(control)  # type: ignore[arg-type]
    time_of_bus = 1.0
    for k in range(1000):
        wall[0] += 0.005
        time_of_bus += 0.005 * speed
        clock.set(time_of_bus)
        if k == 800:
            clock.restart()
        if k > 800:
            check()
    assert not stopped
    wall[0] += silence
    for _ in range(round(silence / 0.005)):
        wall[0] += 1e-5
        time_of_bus += 0.005 * speed
        clock.set(time_of_bus)
    check()
    assert bool(stopped) is (stops and not balances)
    clock.restart()
    stopped.clear()
    check()
    assert not stopped
