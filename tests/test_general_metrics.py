"""Metrics that all general experiments share. Truth: states written by hand, by how much they are beyond the limits of the robot's file."""

from __future__ import annotations

import numpy as np
import pytest

import wbmpc as wb
from wbmpc.log import Log
from wbmpc.tasks.figures import general_metrics


@pytest.mark.parametrize(("name", "kinds"), [("telescope-ur10", 2), ("panda", 1)])
def test_joints_that_turn_and_joints_that_slide_are_beyond_their_limits_in_units_of_their_own(
    name: str, kinds: int
) -> None:
    robot, log = wb.load_robot(name), Log()
    units, upper = np.array(robot.state.units), robot.limits.state_upper
    state = robot.home.copy()
    beyond = {"limit_violation_max": ("rad", 0.03), "slide_limit_violation_max": ("m", 0.004)}
    expected = dict(list(beyond.items())[:kinds])
    for unit, by in expected.values():
        place = np.flatnonzero((units == unit) & np.isfinite(upper))[0]
        state[place] = upper[place] + by
    for t in (0.0, 0.1):
        for channel, value in (("state", state), ("base", np.zeros(3)), ("base_estimated", np.zeros(3))):
            log.add(channel, t, value)
    found = general_metrics(log, robot, 0.0, fell=False)
    assert {n: (m.unit, pytest.approx(m.value)) for n, m in found.items() if n in beyond} == expected
