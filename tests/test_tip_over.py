"""The parts of `tip-over`. Truth: hand-made series of loads and positions; the robot's kinematics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import wbmpc as wb
from toys import robot
from wbmpc.configuration import configure
from wbmpc.errors import InputError
from wbmpc.log import Log
from wbmpc.model.robot import load_robot
from wbmpc.registry import load
from wbmpc.stability import StanceOf
from wbmpc.tasks.tip_over import TipOverSettings, check_stands, longest, reaching, stopping


def test_the_longest_time_in_the_air_is_of_one_wheel_without_a_break() -> None:
    times, lifted = 0.1 * np.arange(10), np.zeros((10, 2), bool)
    assert longest(times, lifted) == 0.0
    lifted[2:4, 0] = lifted[4:7, 1] = lifted[8, 1] = True
    assert longest(times, lifted) == pytest.approx(0.3)


def test_a_stop_is_measured_from_its_order_to_rest() -> None:
    log = Log()
    for t in np.arange(0.0, 3.0, 0.01):  # 1 m/s, from 1 s on slowed down by 2 m/s²
        since = np.clip(t - 1.0, 0.0, 0.5)
        log.add("base", t, np.array([min(t, 1.0) + since - since**2, 0.0, 0.0]))
    found = stopping(log, 1.0)
    assert found["stopping_distance"].value == pytest.approx(0.25, abs=0.005)
    assert found["stopping_time"].value == pytest.approx(0.5, abs=0.02)
    assert stopping(log, 0.0)["stopping_time"].value == pytest.approx(1.5, abs=0.02)
    assert np.isnan(stopping(log, 2.9)["stopping_time"].value)  # what comes after is not known


def test_the_robot_reaches_as_far_as_it_can_and_its_wheels_roll_that_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wbmpc.tasks.tip_over.POSTURES", 3000)
    model = reaching(robot("swerve-ur10"), np.pi / 2, "H")
    tip = model.pose(model.home)[0]
    assert tip[1] > 1.1 and abs(tip[0]) < 0.4  # a UR10 reaches 1.3 m
    geometry = model.base.geometry
    heading = geometry.wheel_heading + model.home[model.state["leg"]] + model.home[model.state["steer"]]
    assert np.abs(np.sin(heading)) == pytest.approx(np.ones(4))
    assert not model.home[model.state["leg"]].any()
    assert wb.load_robot("swerve-ur10").home[model.state["leg"]].all()  # the robot itself is as it was


def test_settings_that_nothing_reads_are_errors() -> None:
    with pytest.raises(InputError, match=r"tip-over: --set plant\.kind='kinematic'"):
        configure(TipOverSettings, ["plant=kinematic"], "tip-over")
    with pytest.raises(InputError, match=r"stability.*payload.*nothing uses it without"):
        configure(load("hold").config_type, ["stability.payload=3"], "hold")


@pytest.mark.parametrize("direction", [0.0, np.pi / 2, np.pi])
@pytest.mark.parametrize("kept", [0.0, 0.03])
def test_a_robot_that_a_load_tips_over_at_rest_is_an_error(direction: float, kept: float) -> None:
    """Truth: where the common center of mass of robot and load is, and SciPy's hull of the feet."""
    robot = reaching(load_robot("differential-ur10"), direction, "home")
    stance, end = StanceOf(robot)(robot.home), robot.pose(robot.home)[0][:2]
    faces = ConvexHull(stance.feet).equations
    loads = np.linspace(0.0, 60.0, 601)
    centers = (stance.mass * stance.com[:2] + loads[:, None] * end) / (stance.mass + loads)[:, None]
    inside = -(centers @ faces[:, :2].T + faces[:, 2]).max(axis=1)
    bears = loads[np.flatnonzero(inside > kept)[-1]]
    check_stands(robot, bears - 0.1, kept)
    with pytest.raises(InputError, match=r"'differential-ur10' does not stand with .* valid: a smaller plant.payload"):
        check_stands(robot, bears + 0.2, kept)
