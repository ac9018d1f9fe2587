"""Arms on a base that does not move, on a bus. Truth: the robot file's pose of the base, the simulated robot's own pose."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from needs import needs_dds

from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.ros2.goals import Planner
from wbmpc.ros2.settings import Speeds, joint_groups, settings_of


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return load_robot("ur5")


def test_its_drives_are_the_arms(robot: RobotModel) -> None:
    topics, groups = settings_of(robot)().command_topics(robot), joint_groups(robot)
    assert {n: c.joints for n, c in topics.items()} == {"arm_controller": robot.description.arm.joints}
    assert {g: names for g, names in groups.items() if names} == {"arm": robot.description.arm.joints}


def test_goals_are_within_reach_and_none_is_the_bases(robot: RobotModel) -> None:
    """Its base stands in the origin; its reach is that of the data sheet, 0.85 m, and what the tool adds."""
    planner, (position, turned) = Planner(robot, Speeds()), robot.pose(robot.home)
    task = planner.to_end_effector(robot.home, 1.0, position + [0.0, 0.1, 0.0], turned)
    assert not task.base.poses.any()
    np.testing.assert_allclose(task.end_effector.positions[-1], position + [0.0, 0.1, 0.0])
    with pytest.raises(InputError, match="out of reach"):
        planner.to_end_effector(robot.home, 0.0, position + [1.5, 0.0, 0.0], turned)
    for order in (
        lambda: planner.to_base(robot.home, 0.0, np.array([0.1, 0.0, 0.0])),
        lambda: planner.drive(robot.home, 0.0, np.array([0.1, 0.0, 0.0])),
    ):
        with pytest.raises(InputError, match="does not move"):
            order()


@needs_dds
def test_a_goal_over_the_bus(simulated: Any) -> None:
    s = simulated
    s.ready()
    start = s.truth()
    s.end_effector(dz=0.05)
    s.run(0.8)
    assert s.control.running, s.control.state
    assert s.truth().tool[2] - start.tool[2] == pytest.approx(0.05, abs=0.01)
    found = s.control.adapter.estimate()
    np.testing.assert_allclose(found.position, s.control.robot.base.position)
    assert not s.messages(2)
