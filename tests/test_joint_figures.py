"""Plots of joints with their limits, in units that read well. Truth: the recorded inputs and the robot's limits."""

from __future__ import annotations

import numpy as np
import pytest

from wbmpc.model.robot import load_robot
from wbmpc.registry import load


def test_speeds_of_hinges_and_their_limits_are_in_degrees() -> None:
    """Positions are, and so are the metrics; speeds of a base that drives are in m/s."""
    hold, robot = load("hold"), load_robot("panda-omni")
    result = hold.run(hold.config_type(robot="panda-omni", plant="kinematic"), 3, None)
    plots = {(p.title, p.y_label): p for p in result.plots}
    arm, turn = plots["Planned inputs: arm", "speed [°/s]"], plots["Planned inputs: base", "speed [°/s]"]
    assert ("Planned inputs: base", "speed [m/s]") in plots
    rows, limits = result.log.array("input"), np.degrees(robot.limits.input_upper)
    base = robot.input["base"].start
    for plot, places in ((arm, range(robot.input.size)[robot.input["arm"]]), (turn, [base + 2])):  # after vx and vy
        for line, place in zip(plot.series, places, strict=True):
            np.testing.assert_allclose(line.y, np.degrees(rows[:, place]))
            assert line.limits is not None and line.limits[1] == pytest.approx(limits[place])
