"""Nodes at their beginning and end. Truth: a bus that says something at every subscription, before it returns; a robot without torques,
which falls."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds, private

from wbmpc.bases import base_type
from wbmpc.model.robot import load_robot
from wbmpc.ros2.settings import joint_groups, settings_of
from wbmpc.runtime.clock import WallClock

pytestmark = needs_dds
if not MISSING:
    from wbmpc.ros2.messages import types
    from wbmpc.ros2.network import Network
    from wbmpc.ros2.opening import open_node
    from wbmpc.ros2.robot import BusRobot
    from wbmpc.ros2.sim import SimNode


class Eager:
    """A node on whose bus everybody speaks at once: ``values`` by type, else nothing of meaning. ``heard``: topics."""

    def __init__(self, node: Any, values: Mapping[str, Any] | None = None) -> None:
        self._node, self._values, self.heard = node, values or {}, list[str]()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._node, name)

    def subscribe(self, topic: str, kind: str, take: Any, *_: Any, sourced: bool = False, **__: Any) -> None:
        messages = types("jazzy")
        message = messages.decode(kind, messages.encode(kind, self._values.get(kind, {})))
        take(message, None) if sourced else take(message)
        self.heard.append(topic)


@pytest.mark.parametrize("name", ["swerve-ur10", "pr2", "rezero"])
def test_messages_may_come_as_soon_as_somebody_listens(name: str) -> None:
    robot = load_robot(name)
    settings = settings_of(robot)()
    names = [settings.bus_name(n) for group in joint_groups(robot).values() for n in group]
    joints = {"name": names, "position": np.zeros(len(names))}
    node = Eager(open_node("eager", "dds", Network.of(private())), {"sensor_msgs/msg/JointState": joints})
    try:
        adapter = base_type(robot.description.base.type).ros(robot, settings, 0.01)
        made = BusRobot(node, adapter, settings, WallClock())
        assert "/joint_states" in node.heard and not made.fault
    finally:
        node.close()


def test_a_trajectory_may_come_as_soon_as_the_simulated_robot_listens() -> None:
    robot = load_robot("swerve-ur10")
    kind, settings = settings_of(robot), settings_of(robot)()
    arm = {"topic": "/arm", "joints": list(robot.input.groups["arm"]), "takes": "trajectory"}
    others = {n: c.model_dump() for n, c in settings.command_topics(robot).items() if n != "arm_controller"}
    node = Eager(open_node("eager", "dds", Network.of(private())))
    try:
        SimNode(node, robot, kind.model_validate({"controllers": {**others, "arm_controller": arm}}))
        assert "/arm" in node.heard
    finally:
        node.close()


def test_who_falls_says_what_counts_as_the_fall_and_why_it_came_to_it() -> None:
    robot = load_robot("rezero")
    node = open_node("falls", "dds", Network.of(private()))
    try:
        sim = SimNode(node, robot, settings_of(robot).model_validate({"use_sim_time": True}), factor=1e3)
        with sim._changed:
            for name in sim._controllers:
                sim._answered(name)  # the first command, and the last
        why = sim.spin(lambda: False, 20.0)
    finally:
        node.close()
    assert sim.failed and "s because its base leaned by " in why and " the limit is " in why, why
    assert "; no commands came on /wheel_controller/commands after 0.00 s" in why, why
