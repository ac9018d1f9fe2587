"""The clearance of a plan, as views, replays and diagnostics say it. Truth: MuJoCo's distances of the robot's file."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

import wbmpc as wb
from clearing import TrueDistance
from wbmpc.default_problem import default_mpc
from wbmpc.ros2 import publishers
from wbmpc.view.core import solved
from wbmpc.view.panel import plotted
from wbmpc.view.replay import Film
from wbmpc.view.snapshot import NUMBERS, status_text
from wbmpc.view.user_commands import Controls


def test_how_clear_a_plan_is_is_shown() -> None:
    robot, world = wb.load_robot("differential-ur10"), wb.Obstacles()
    place = np.array([0.532, 0.0, 0.3])  # nearer, by the margins, than any two parts of the robot
    world.set("post", wb.shapes.Cylinder((0, 0, -0.3), (0, 0, 0.3), 0.1), position=place)
    true = TrueDistance(robot, [(mujoco.mjtGeom.mjGEOM_CYLINDER, [0.1, 0.3])])(robot.home, [place])
    mpc = default_mpc(robot, obstacles=world)
    mpc.update(wb.Observation(0.0, robot.home))  # it stays
    values = solved(mpc)
    assert abs(values["clearance"] - true) < 1e-3 and set(values) < set(NUMBERS)
    said = status_text({"error": np.nan, "margin": np.nan, "triangle_margin": np.nan, **values})
    assert said == f"  \nleast clearance of the plan {1e3 * true:.0f} mm"
    node: Any = SimpleNamespace(adapter=SimpleNamespace(mpc=mpc))
    found = publishers.plan_clearance(node)
    assert found["clearance of the plan"].startswith(f"{1e3 * true:.0f} mm between 'chassis' and 'post'")
    assert found["plans that stop at obstacles"] == 0
    world.clear()
    mpc.update(wb.Observation(0.02, robot.home))
    assert "post" not in publishers.plan_clearance(node)["clearance of the plan"]


def test_without_obstacles_nothing_is_said_of_them() -> None:
    mpc = default_mpc(wb.load_robot("differential-ur10"))
    node: Any = SimpleNamespace(adapter=SimpleNamespace(mpc=mpc))
    assert publishers.plan_clearance(node) == {}
    assert np.isnan(list(solved(None).values())).all()
    title = "Least clearance of the plan [mm]"
    assert title in plotted(Controls("x", (), False, False, obstacle=True)) and title not in plotted(
        Controls("x", (), False, False)
    )


def test_replays_know_it_where_something_was_near() -> None:
    """Solves at three times, the middle one with something near."""
    film: Any = Film.__new__(Film)
    table = SimpleNamespace(times=np.array([0.02]), columns={"data": np.array([0.05])})
    film.recording = SimpleNamespace(topics=("/mpc/clearance",), table=lambda topic: table)
    times, values = film._clearance(np.array([0.0, 0.02, 0.04]))["clearance"]
    np.testing.assert_array_equal(times, [0.0, 0.02, 0.04])
    np.testing.assert_array_equal(values, [np.nan, 0.05, np.nan])
