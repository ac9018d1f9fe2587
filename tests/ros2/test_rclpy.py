"""The rclpy back end on a stand-in for rclpy (fake_ros.py), and on rclpy itself where ROS 2 is sourced.

Truth: typed fields as rosidl makes them. Without ROS nothing here says that ROS agrees."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds, wait_until

from wbmpc.errors import InputError
from wbmpc.ros2.bus import LATCHED, SENSOR
from wbmpc.ros2.opening import open_node
from wbmpc.ros2.sources import AMBIGUOUS

if not MISSING:
    from fake_ros import FakeNode, install, message_class


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Any:
    nodes = install(monkeypatch)
    yield nodes
    sys.modules.pop("wbmpc.ros2.ros", None)


@needs_dds
def test_rclpy_is_taken_where_it_is(made: list[Any]) -> None:
    node = open_node("wbmpc")
    assert node.backend == "rclpy" and [n.name for n in made] == ["wbmpc"]
    node.close()


@pytest.mark.skipif(find_spec("rclpy") is not None, reason="rclpy is there")
def test_asked_for_but_not_there() -> None:
    with pytest.raises(InputError, match="rclpy cannot be imported: source ROS 2"):
        open_node("wbmpc", "rclpy")


@needs_dds
def test_types_are_found_where_rclpy_is_alone(made: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """An installation of rclpy and messages need not have rosidl_runtime_py. Truth: a class of Python's own, by its path."""
    monkeypatch.setitem(sys.modules, "rosidl_runtime_py.utilities", None)
    monkeypatch.delitem(sys.modules, "wbmpc.ros2.ros", raising=False)
    from collections.abc import Mapping

    from wbmpc.ros2.ros import get_message

    assert get_message("collections/abc/Mapping") is Mapping


@needs_dds
def test_every_kind_of_field_is_written_with_its_type(made: list[Any]) -> None:
    from wbmpc.ros2.ros import fill

    diagnostics = fill(message_class("diagnostic_msgs/msg/DiagnosticArray")(), {
        "header": {"stamp": {"sec": 3, "nanosec": np.int64(5)}, "frame_id": "f"},
        "status": [{"level": 2, "name": "n", "values": [{"key": "k", "value": "v"}]}],
    })  # fmt: skip
    assert (diagnostics.header.stamp.sec, diagnostics.header.stamp.nanosec) == (3, 5)
    assert (diagnostics.status[0].level, diagnostics.status[0].values[0].key) == (b"\2", "k")
    joints = fill(message_class("sensor_msgs/msg/JointState")(), {"name": ["a", "b"], "position": np.array([1.0, 2.0])})
    assert joints.name == ["a", "b"] and list(joints.position) == [1.0, 2.0]
    odometry = fill(message_class("nav_msgs/msg/Odometry")(), {"pose": {"covariance": np.arange(36.0)}})
    assert odometry.pose.covariance[35] == 35.0
    imu = fill(message_class("sensor_msgs/msg/Imu")(), {"orientation_covariance": [-1.0] + [0.0] * 8})
    assert imu.orientation_covariance[0] == -1.0


@needs_dds
def test_topics_services_graph_and_mismatches(made: list[Any]) -> None:
    node = open_node("wbmpc")
    got: list[Any] = []
    node.subscribe("joint_states", "sensor_msgs/msg/JointState", lambda m: got.append(list(m.position)), SENSOR)
    node.publisher("/joint_states", "sensor_msgs/msg/JointState", LATCHED).publish({"position": [0.5]})
    assert got == [[0.5]] and FakeNode.bus[0][0] == "/joint_states"
    profile = made[0].profiles[0]
    assert (profile.reliability.name, profile.durability.name, profile.depth) == ("RELIABLE", "TRANSIENT_LOCAL", 1)
    sensors = made[0].topics[0]
    assert sensors[:2] == ("subscription", "/joint_states") and sensors[3].reliability.name == "BEST_EFFORT"
    node.publisher("x", "std_msgs/msg/String", SENSOR)
    # the same name twice: two controllers of one robot
    made[0].topics += [("publisher", "/x", name, made[0].profiles[-1]) for name in ("wbmpc", "somebody")]
    assert [(e.own, e.type, e.qos) for e in node.publishers("x")] == [
        (own, "std_msgs/msg/String", SENSOR) for own in (True, False, False)
    ]
    assert [node.owner(e) for e in node.publishers("x")] == ["wbmpc", "wbmpc", "somebody"]
    assert node.subscribers("x") == []
    event = type("Event", (), {"last_policy_kind": 1 << 4})()
    made[0].events.incompatible_qos(event)
    made[0].events.incompatible_qos(event)
    assert node.faults == [
        "/x: a subscription asks for more than is offered (reliability); no message will come through"
    ]
    node.serve("/brakes", "std_srvs/srv/SetBool", lambda asked: {"success": True, "message": "open"})
    answered = message_class("std_srvs/srv/SetBool_Response")()
    assert made[0].services["/brakes"](None, answered).message == "open"
    node.close()
    assert made[0].destroyed and not made[0].context.ok() and not node._thread.is_alive()


@needs_dds
def test_whose_a_message_is_is_known_while_there_is_one_publisher(made: list[Any]) -> None:
    """Of one type: who publishes another one is not heard. Truth: the stand-in's identities, names as bytes."""
    node, other = open_node("wbmpc"), open_node("robot")
    from wbmpc.ros2.ros import RosWriter

    got: list[Any] = []
    node.subscribe("/x", "std_msgs/msg/String", lambda m, source: got.append(source), sourced=True)
    publisher = other.publisher("/x", "std_msgs/msg/String")
    made[0].topics += made[1].topics  # the graph
    publisher.publish({})
    made[0].topics.append(("publisher", "/x", "somebody", made[1].profiles[0]))
    publisher.publish({})
    made[0].topics.pop()
    publisher.publish({})
    assert got == [RosWriter(b"robot"), AMBIGUOUS, RosWriter(b"robot")]
    node.close()
    other.close()


@needs_dds
def test_the_controllers_node_runs_on_it(made: list[Any]) -> None:
    """Every message that it takes and sends, with the types of fields that rosidl checks: it moves, and says so. In lockstep: a
    busy machine changes nothing."""
    from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
    from wbmpc.model.robot import load_robot
    from wbmpc.ros2.control import ControlNode
    from wbmpc.ros2.convert import stamp
    from wbmpc.ros2.settings import joint_groups

    robot = load_robot("swerve-ur10")
    settings = SwerveRosSettings.model_validate(
        {"rates": {"control": 50}, "use_sim_time": True, "lockstep": True, "safety": {"clock": 60}}
    )
    node, other = open_node("wbmpc", "rclpy"), open_node("robot", "rclpy")
    control = ControlNode(node, robot, settings)
    names = [n for g in joint_groups(robot).values() for n in g]
    got: dict[str, list[Any]] = {}
    numbers = "std_msgs/msg/Float64MultiArray"
    for topic, kind in {
        "/wheel_controller/commands": numbers, "/brake_controller/commands": numbers, "/odom": "nav_msgs/msg/Odometry",
        "/tf": "tf2_msgs/msg/TFMessage", "/plan": "nav_msgs/msg/Path", "/end_effector_plan": "nav_msgs/msg/Path",
        "/end_effector_pose": "geometry_msgs/msg/PoseStamped", "/footprint": "visualization_msgs/msg/MarkerArray",
        "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    }.items():  # fmt: skip
        other.subscribe(topic, kind, got.setdefault(topic, []).append)
    joints = other.publisher("/joint_states", "sensor_msgs/msg/JointState")
    imu = other.publisher("/imu", "sensor_msgs/msg/Imu")
    goal = other.publisher("/goal_pose", "geometry_msgs/msg/PoseStamped")

    clock = other.publisher("/clock", "rosgraph_msgs/msg/Clock")
    made[0].topics += [t for t in made[1].topics if t[1] == "/clock"]  # the graph: however slow, somebody has the time
    sent, ticks = got["/wheel_controller/commands"], [50]

    def tick() -> None:
        """A period of a robot that does not get anywhere: its state, the time, and then the command."""
        now, previous = stamp(ticks[0] / 50.0), len(sent)
        ticks[0] += 1
        imu.publish({"header": {"stamp": now}})
        # encoders that never change are a fault
        joints.publish({"header": {"stamp": now}, "name": names, "position": robot.home[3:] + 1e-6 * (ticks[0] % 2)})
        clock.publish({"clock": now})
        assert wait_until(lambda: not control.running or len(sent) > previous)
        control.step()

    moves = lambda: tick() or (bool(sent) and max(map(abs, sent[-1].data)) > 0.1)
    try:
        assert wait_until(lambda: tick() or control.state == "waiting for a goal")
        goal.publish({"header": {"frame_id": "odom"}, "pose": {"position": {"x": 2.0}}})
        assert wait_until(moves), control.state
        assert wait_until(lambda: tick() or all(got.values())), [t for t, m in got.items() if not m]
        said = lambda: got["/diagnostics"][-1].status[0]
        assert wait_until(lambda: tick() or "running: base to a goal" in said().message), said().message
        assert (said().level, said().name) == (b"\0", "wbmpc: controller")
        assert list(made[0].services) == ["/set_legs"] and not node.faults
    finally:
        control.close()
        node.close()
        other.close()


@pytest.mark.skipif(find_spec("rclpy") is None, reason="needs a sourced ROS 2 (rclpy)")
def test_two_nodes_of_a_real_ros() -> None:
    one, other = open_node("wbmpc_one", "rclpy"), open_node("wbmpc_other", "rclpy")
    got: list[float] = []
    other.subscribe("/wbmpc_test", "std_msgs/msg/Float64MultiArray", lambda m: got.extend(m.data), LATCHED)
    one.publisher("/wbmpc_test", "std_msgs/msg/Float64MultiArray", LATCHED).publish({"data": [1.0, 2.0]})
    assert wait_until(lambda: got == [1.0, 2.0])
    one.close()
    other.close()


@needs_dds
def test_parameters_are_those_of_the_rclpy_node(made: list[Any]) -> None:
    from wbmpc.ros2.parameters import Parameter, Parameters

    node, new = open_node("wbmpc"), []
    given = [
        Parameter("rates.odom", 50.0),
        Parameter("cost.end_effector.weight", 1.0, read_only=False, range=(0.0, 9.0)),
    ]
    node.offer(Parameters([*given, Parameter("use_sim_time", False)], new.append))
    (fake,) = made
    assert {name: value for name, (value, _) in fake.parameters.items()} == {
        "rates.odom": 50.0,
        "cost.end_effector.weight": 1.0,
    }
    (rate, weight) = (fake.parameters[p.name][1] for p in given)
    assert (rate.read_only, weight.read_only, weight.floating_point_range[0].to_value) == (True, False, 9.0)
    change = lambda value: fake.on_set([SimpleNamespace(name="cost.end_effector.weight", value=value)])
    assert change(2.0).successful and new == [{"cost.end_effector.weight": 2.0}]
    bad = change(10.0)
    assert not bad.successful and "valid: 0 to 9" in bad.reason and len(new) == 1
    node.close()
