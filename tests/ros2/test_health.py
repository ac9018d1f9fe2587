"""What the node says about being late and about a fall. Truth: clocks and counters that the test sets; MuJoCo's robot that fell."""

from __future__ import annotations

import logging
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds, private

from wbmpc.bases.ball.ros import fall
from wbmpc.model.robot import load_robot
from wbmpc.ros2 import health as module
from wbmpc.ros2.health import Health
from wbmpc.ros2.network import Network
from wbmpc.runtime.clock import WallClock

pytestmark = needs_dds
if not MISSING:
    from simulated import Simulated


def controller(**changes: Any) -> Any:
    """What Health looks at, as a test wants it."""
    runner = SimpleNamespace(
        plans=SimpleNamespace(current=object()), own={"ticks": 0, "skipped": 0}, kept="", stopped=False,
        punctuality=SimpleNamespace(late=0), state="running",
    )  # fmt: skip
    adapter = SimpleNamespace(must_keep_running=False, faults=[], snapshot=lambda: None, fall=fall)
    given = {"clock": WallClock(), "runner": runner, "running": True, "period": 0.0025, "adapter": adapter}
    return SimpleNamespace(**{**given, "robot_io": SimpleNamespace(fault=""), **changes})


def test_the_real_time_factor_and_late_ticks(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    """By hand: 800 ticks of 2.5 ms in 2 s are real time; 400 are half of it; 80 late ones of 800 are too many; 56 that ran, all late,
    beside 744 that were skipped are a factor of 0.07 and 800 of 800."""
    caplog.set_level(logging.WARNING, "wbmpc")
    now = [100.0]
    monkeypatch.setattr(module.time, "perf_counter", lambda: now[0])
    c = controller()
    h, own = Health(c), c.runner.own
    h.update()
    assert h.diagnostics() == {}

    def passes(ticks: int, skipped: int, late: int) -> dict[str, str]:
        now[0] += 2.0
        own["ticks"] += ticks
        own["skipped"] += skipped
        c.runner.punctuality.late += late
        h.update()
        return h.diagnostics()

    assert passes(800, 0, 3) == {"real-time factor": "1.000", "late ticks": "3"}
    slow = passes(400, 400, 0)
    assert (slow["real-time factor"], slow["late ticks"]) == ("0.500", "400")
    says = "the controller is late: real-time factor 0.50, 400 of 800 ticks were late in the last 2.0 s"
    assert slow["late"] == h.late == says and caplog.text.count(says) == 1
    assert "80 of 800 ticks were late" in passes(800, 0, 80)["late"]
    assert "late" not in passes(800, 0, 0)
    assert "real-time factor 0.07, 800 of 800 ticks were late" in passes(56, 744, 57)["late"]
    c.running = False
    h.update()
    assert not h.late


@pytest.mark.parametrize(
    ("changes", "because"),
    [
        (
            {"stopped": True, "state": "stopped at 3.000 s: no joint states"},
            "because stopped at 3.000 s: no joint states",
        ),
        ({"kept": "the MPC raised ValueError"}, "because the MPC raised ValueError; a wheel slips"),
        ({}, "because a wheel slips"),
        (
            {"stopped": True, "state": "stopped at 3.000 s: the robot fell, it leans by 41 degrees; motors off"},
            "because a wheel slips",
        ),
    ],
)
def test_the_cause_of_a_fall(changes: dict[str, Any], because: str) -> None:
    c = controller()
    vars(c.runner).update(changes)
    c.adapter.must_keep_running, c.adapter.faults = True, ["a wheel slips"]
    leans = [0.3]
    c.adapter.snapshot = lambda: (0.0, np.array([1.0, 2.0, 0.5, 0.0, leans[0]]))
    h = Health(c)
    h.update()
    assert not h.fell
    leans[0] = 0.8
    h.update()
    assert h.fell == f"the robot fell, it leans by 46 degrees, {because}"
    leans[0] = 0.1  # put up again
    h.update()
    assert not h.fell


def test_a_ball_robot_that_is_stopped_says_why_it_fell() -> None:
    """Its MuJoCo twin has fallen; the estimate goes on after the stop, and diagnostics name the cause."""
    s = Simulated(load_robot("rezero"), Network.of(private()))
    try:
        s.ready()
        s.end_effector()
        assert s.until(lambda: s.control.state.startswith("running:")), s.control.state
        s.run(0.2)
        s.control.runner.halt("the battery is empty")
        says = "degrees, because stopped at "
        assert s.until(lambda: s.control.health.fell and any(says in m for m in s.messages(2))), s.control.state
        assert "the battery is empty" in s.control.health.fell and s.truth().tilt > 0.6
        assert s.until(lambda: s.why)
        assert s.why.startswith("the robot fell at ")
    finally:
        s.close()
