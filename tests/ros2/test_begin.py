"""Nodes at their beginning and end. Truth: a bus that says something at every subscription, before it returns; a robot without torques,
which falls."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
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
    from wbmpc.ros2.plants import ActiveTrajectory
    from wbmpc.ros2.robot import BusRobot
    from wbmpc.ros2.sim import SimNode
    from wbmpc.ros2.trajectory_client import places_of


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


@pytest.mark.parametrize(
    ("control", "trajectory"),
    [(37.0, 20.0), (100.0, 20.0), (300.0, 2.0), (400.0, 100.0), (700.0, 20.0), (2000.0, 20.0)],
)
def test_in_lockstep_every_state_has_commands_to_wait_for(control: float, trajectory: float) -> None:
    """Truth: a controller that sends at its rates by the time of the bus is never waited for in vain. Three of four states were
    that it did not answer at 100 Hz."""
    robot = load_robot("swerve-ur10")
    arm = {"topic": "/arm", "joints": list(robot.input.groups["arm"]), "takes": "trajectory"}
    others = {n: c.model_dump() for n, c in settings_of(robot)().command_topics(robot).items() if n != "arm_controller"}
    given = {"controllers": {**others, "arm_controller": arm}, "rates": {"control": control, "trajectory": trajectory}}
    node = open_node("lockstep", "dds", Network.of(private()))
    try:
        sim: Any = SimNode(node, robot, settings_of(robot).model_validate({"lockstep": True, **given}))
        sim.patience, missed = 0.0, list[float]()
        rates = {n: trajectory if c.takes == "trajectory" else control for n, c in sim._controllers.items()}
        sent, places = dict.fromkeys(rates, 0), [("arm", k) for k in range(6)]
        still = robot.home[robot.state["arm"]][None]
        sim.side.led["arm_controller"] = ActiveTrajectory(places, np.zeros(1), still, np.zeros((1, 6)))

        def published(message: Mapping[str, Any]) -> None:
            if sim._lost:
                missed.append(sim.time)
            with sim._changed:
                for name, rate in rates.items():
                    before, sent[name] = sent[name], 1 + int(sim.time * rate + 1e-6)
                    if sent[name] > before:
                        sim._answered(name)

        sim._clock = SimpleNamespace(publish=published)
        assert sim.spin(lambda: False, 0.6) == "0.6 s are over"
    finally:
        node.close()
    assert not missed and sent["wheel_controller"] == pytest.approx(0.6 * control, abs=control * sim.period + 1.0)


def test_a_robot_that_is_held_is_let_go_by_commands_of_every_kind() -> None:
    """A base type of another package may fall without them, and take speeds or trajectories: zeros and a trajectory of one point at rest are those
    of a stop. Truth: whether its physics goes on."""
    robot = load_robot("pr2")
    kind = settings_of(robot)
    arm = {"topic": "/arm", "joints": list(robot.input.groups["arm"]), "takes": "trajectory"}
    others = {n: c.model_dump() for n, c in kind().command_topics(robot).items() if n != "arm_controller"}
    given = {"controllers": {**others, "arm_controller": arm}}
    joints = robot.home[robot.state["arm"]]
    header = SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0))

    def speed(vx: float) -> Any:
        vector = lambda x: SimpleNamespace(x=x, y=0.0, z=0.0)
        return SimpleNamespace(header=header, twist=SimpleNamespace(linear=vector(vx), angular=vector(0.0)))

    def led(points: int) -> Any:
        point = lambda k: SimpleNamespace(
            positions=joints, velocities=(), accelerations=(), effort=(),
            time_from_start=SimpleNamespace(sec=k, nanosec=0),
        )  # fmt: skip
        return SimpleNamespace(header=header, joint_names=arm["joints"], points=[point(k + 1) for k in range(points)])

    node = open_node("held", "dds", Network.of(private()))
    try:
        for takes, stops, goes in (("twist", speed(0.0), speed(0.1)), ("trajectory", led(1), led(2))):
            sim = SimNode(node, robot, kind.model_validate(given))
            sim.side.held = True
            name = next(n for n, c in sim._controllers.items() if c.takes == takes)
            places = [places_of(robot)[j] for j in sim._controllers[name].joints]
            for message, moves in ((stops, False), (goes, True)):
                sim._follow(name, places, message)
                sim._advance()
                assert (sim.plant.time > 0.0) is moves, (takes, moves)
    finally:
        node.close()


def test_who_falls_says_what_counts_as_the_fall_and_why_it_came_to_it() -> None:
    robot = load_robot("rezero")
    node = open_node("falls", "dds", Network.of(private()))
    try:
        sim = SimNode(node, robot, settings_of(robot).model_validate({"use_sim_time": True}), factor=1e3)
        for name, controller in sim._controllers.items():  # the first command, and the last
            targets = [places_of(robot)[j] for j in controller.joints]
            sim._take(name, targets, SimpleNamespace(data=np.full(len(targets), 1e-6)))
        why = sim.spin(lambda: False, 20.0)
    finally:
        node.close()
    assert sim.failed and "s because its base leaned by " in why and " the limit is " in why, why
    assert "; no commands came on /wheel_controller/commands after 0.00 s" in why, why
