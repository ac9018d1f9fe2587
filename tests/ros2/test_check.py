"""A look at a bus. Truth: what was put on the bus on purpose."""

from __future__ import annotations

import json
import re
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds, private, wait_until

from wbmpc.cli import main
from wbmpc.model.robot import load_robot
from wbmpc.ros2.bus import DEFAULT, LATCHED, SENSOR, Qos
from wbmpc.ros2.network import Network
from wbmpc.ros2.opening import open_node

pytestmark = needs_dds
if not MISSING:
    from wbmpc.bases.ball.ros_settings import BallRosSettings
    from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
    from wbmpc.ros2.check import check
    from wbmpc.ros2.control import ControlNode
    from wbmpc.ros2.convert import header
    from wbmpc.ros2.sim import SimNode

ROBOT = load_robot("swerve-ur10")
NETWORK = Network.of({**private(), "ROS_DOMAIN_ID": "46"})
COMMANDS = "std_msgs/msg/Float64MultiArray"
GROUPS = ("wheel", "steer", "arm", "brake")


@pytest.fixture
def robot() -> Iterator[Any]:
    node = open_node("robot", "dds", NETWORK)
    yield node
    node.close()


@pytest.fixture
def looker() -> Iterator[Any]:
    node = open_node("looker", "dds", NETWORK)
    yield node
    node.close()


def listen(node: Any, groups: tuple[str, ...] = GROUPS, kind: str = COMMANDS) -> None:
    """Controllers that are active."""
    for group in groups:
        node.subscribe(f"/{group}_controller/commands", kind, lambda message: None, DEFAULT)


class States:
    """Joint states that a thread publishes until :meth:`set`."""

    def __init__(self, node: Any, rate: float, names: list[str] | None = None, age: float = 0.0) -> None:
        publisher = node.publisher("/joint_states", "sensor_msgs/msg/JointState", SENSOR)
        names = names or [n for g in ("leg", "steer", "wheel", "arm") for n in ROBOT.state.groups[g]]
        self._end = threading.Event()

        def run() -> None:
            while not self._end.wait(1.0 / rate):
                publisher.publish(
                    {"header": header(time.time() - age, ""), "name": names, "position": np.zeros(len(names))}
                )

        self._thread = threading.Thread(target=run, daemon=True)
        self._thread.start()

    def set(self) -> None:
        """End it, before its node is closed."""
        self._end.set()
        self._thread.join()


def known(node: Any, publishers: tuple[str, ...] = (), subscribers: tuple[str, ...] = ()) -> None:
    """Wait until a node sees these topics: a busy machine takes its time."""
    there = lambda: all(map(node.publishers, publishers)) and all(map(node.subscribers, subscribers))
    assert wait_until(there)


def commands(*groups: str) -> tuple[str, ...]:
    """Topics of controllers."""
    return tuple(f"/{g}_controller/commands" for g in groups)


def found(node: Any, listen_for: float = 1.0) -> dict[str, tuple[str, str]]:
    """Findings by topic."""
    return {f.topic: (f.level, f.text) for f in check(node, ROBOT, SwerveRosSettings(), listen_for)}


def test_an_empty_bus(looker: Any) -> None:
    f = found(looker)
    assert f["/joint_states"] == ("error", "no publisher")
    assert f["/imu"][0] == "warning" and f["/brake_controller/commands"][0] == "warning"
    assert f["/wheel_controller/commands"] == ("error", "no subscriber: is the controller active?")


def test_a_good_robot(robot: Any, looker: Any) -> None:
    listen(robot)
    end = States(robot, 300.0)
    known(looker, ("/joint_states",), commands(*GROUPS))
    f = found(looker)
    end.set()
    assert f["/joint_states"][0] in ("ok", "warning"), f["/joint_states"]  # a busy machine may be irregular
    assert "missing" not in f["/joint_states"][1]
    assert all(f[f"/{g}_controller/commands"] == ("ok", "1 listening") for g in GROUPS)


@pytest.mark.parametrize(
    ("urdf", "names", "says"),
    [
        (None, None, ("ok", "the robot on the bus has the joints of 'swerve-ur10'")),
        ("<robot name='swerve-ur10'/>", None, ("ok", "the robot on the bus is 'swerve-ur10'")),
        ('<?xml version="1.0"?><robot name="rezero">', ["wheel_0"],
         ("error", "the robot on the bus is called 'rezero', not 'swerve-ur10'; its joints do not fit either")),
        ("<robot name='mine'/>", None,
         ("warning", "the robot on the bus is called 'mine', not 'swerve-ur10'; its joints fit all the same")),
    ],
)  # fmt: skip
def test_the_robot_that_is_there_is_named(
    robot: Any, looker: Any, urdf: str | None, names: list[str] | None, says: tuple[str, str]
) -> None:
    if urdf is not None:
        robot.publisher("/robot_description", "std_msgs/msg/String", LATCHED).publish({"data": urdf})
    end = States(robot, 100.0, names)
    known(looker, ("/joint_states", "/robot_description") if urdf is not None else ("/joint_states",))
    f = found(looker)
    end.set()
    assert f["robot"] == says


def test_types_names_rates_and_stamps_that_are_wrong(robot: Any, looker: Any) -> None:
    robot.publisher("/imu", "std_msgs/msg/String")
    robot.publisher("/cmd_vel", "geometry_msgs/msg/Pose")
    listen(robot, ("wheel",), "std_msgs/msg/Float64")
    end = States(robot, 10.0, ["hip"], age=100.0)
    known(looker, ("/imu", "/cmd_vel", "/joint_states"), commands("wheel"))
    found_all = [(f.topic, f.text) for f in check(looker, ROBOT, SwerveRosSettings(), 1.5)]
    end.set()
    assert ("/imu", "its type is std_msgs/msg/String, sensor_msgs/msg/Imu is needed") in found_all
    assert ("/wheel_controller/commands", f"its type is std_msgs/msg/Float64, {COMMANDS} is needed") in found_all
    assert any(t == "/cmd_vel" and "geometry_msgs/msg/Twist or " in text for t, text in found_all)
    said = [text for t, text in found_all if t == "/joint_states"]
    assert any("too slow:" in s for s in said) and any("joint 'leg_LF' is missing" in s for s in said)
    off = [re.search(r"stamps are ([\d.]+) s off this machine's clock", s) for s in said]
    assert any(m and float(m[1]) == pytest.approx(100.0, abs=5.0) for m in off)


def test_a_simulation_that_is_paused_is_said(robot: Any, looker: Any) -> None:
    """In lockstep without a controller: the same state and the same time again and again; then also asked by simulated time."""
    listen(robot)
    clock, joints = (
        robot.publisher("/clock", "rosgraph_msgs/msg/Clock"),
        robot.publisher("/joint_states", "sensor_msgs/msg/JointState", SENSOR),
    )
    names, end = [n for g in ("leg", "steer", "wheel", "arm") for n in ROBOT.state.groups[g]], threading.Event()

    def run() -> None:
        while not end.wait(0.02):
            clock.publish({"clock": {"sec": 7}})
            joints.publish({"header": header(7.0, ""), "name": names, "position": np.zeros(len(names))})

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    known(looker, ("/clock", "/joint_states"), commands(*GROUPS))
    by_wall = {(f.level, f.topic, f.text) for f in check(looker, ROBOT, SwerveRosSettings(), 1.0)}
    by_clock = {(f.level, f.topic, f.text) for f in check(looker, ROBOT, SwerveRosSettings(use_sim_time=True), 1.0)}
    end.set()
    thread.join()
    stands = "it stands still at 7.000 s: the simulation is paused, or in lockstep waits for a controller"
    assert ("error", "/clock", stands) in by_clock and ("warning", "/clock", stands) in by_wall
    assert ("warning", "/clock", "it is published, but the node runs on wall time: use --use-sim-time") in by_wall
    states = [(level, text) for level, topic, text in by_wall | by_clock if topic == "/joint_states"]
    assert any(level == "error" and "its stamps stand still at 7.000 s" in text for level, text in states)
    assert any(re.search(r"its stamps are [\d.]+ s off this machine's clock, at \d+ Hz", text) for _, text in states)
    assert not any(topic == "/clock" and "wall's" in text for _, topic, text in by_clock)


def test_two_publishers_and_a_quality_that_does_not_match(robot: Any, looker: Any) -> None:
    robot.publisher("/joint_states", "sensor_msgs/msg/JointState")
    end = States(robot, 100.0)
    robot.subscribe("/arm_controller/commands", COMMANDS, lambda message: None, Qos(latched=True))
    robot.publisher("/steer_controller/commands", COMMANDS)
    robot.publisher("/goal_pose", "geometry_msgs/msg/PoseStamped", SENSOR)
    robot.publisher("/end_effector_goal", "geometry_msgs/msg/Pose")
    robot.publisher("/end_effector_path", "nav_msgs/msg/Path")
    assert wait_until(lambda: len(looker.publishers("/joint_states")) == 2)
    known(looker, (*commands("steer"), "/goal_pose", "/end_effector_goal", "/end_effector_path"), commands("arm"))
    f = {(x.topic, x.text) for x in check(looker, ROBOT, SwerveRosSettings(), 1.0)}
    end.set()
    assert ("/joint_states", "2 publishers: their messages mix") in f
    assert ("/goal_pose", "a publisher does not reach us: it offers best effort, reliable is asked for") in f
    assert any(
        t == "/end_effector_goal" and "its type is geometry_msgs/msg/Pose, geometry_msgs/msg/PoseS" in s for t, s in f
    )
    assert not any(t == "/end_effector_path" for t, _ in f)
    assert ("/arm_controller/commands", "it offers volatile, transient local is asked for") in f
    assert ("/steer_controller/commands", "another node publishes on it ('robot'): the controller will not start") in f


def test_ones_own_controller_is_no_conflict_but_two_of_them_are(robot: Any, looker: Any) -> None:
    listen(robot)
    end = States(robot, 300.0)
    with ExitStack() as stack:
        nodes = [open_node("wbmpc", "dds", NETWORK) for _ in range(2)]
        for node in nodes:
            stack.callback(node.close)
        stack.callback(end.set)
        stack.callback(ControlNode(nodes[0], ROBOT, SwerveRosSettings()).close)
        known(looker, commands(*GROUPS), commands(*GROUPS))
        f = found(looker)
        says = "1 listening; the controller 'wbmpc' is there"
        assert {g: f[t] for g, t in zip(GROUPS, commands(*GROUPS))} == dict.fromkeys(GROUPS, ("ok", says))
        nodes[1].publisher(commands("arm")[0], COMMANDS)
        assert wait_until(lambda: len(looker.publishers(commands("arm")[0])) == 2)
        two = "2 nodes called 'wbmpc' publish on it: they stop each other"
        assert found(looker)[commands("arm")[0]] == ("error", two)


def test_a_ball_robot_needs_its_inertial_unit_and_an_arm_may_want_trajectories(robot: Any, looker: Any) -> None:
    listen(robot, ("wheel",))
    arm = load_robot("rezero").input.groups["arm"]
    controllers = {
        "wheel": {"topic": "/wheel_controller/commands", "joints": ["wheel_0", "wheel_1", "wheel_2"]},
        "arm": {"topic": "/arm_controller/joint_trajectory", "joints": arm, "takes": "trajectory"},
    }
    robot.subscribe("/arm_controller/joint_trajectory", COMMANDS, lambda message: None)
    settings = BallRosSettings.model_validate({"controllers": controllers})
    known(looker, (), (*commands("wheel"), "/arm_controller/joint_trajectory"))
    f = {x.topic: (x.level, x.text) for x in check(looker, load_robot("rezero"), settings, 1.0)}
    assert f["/imu"][0] == "error" and f["/wheel_controller/commands"] == ("ok", "1 listening")
    wrong = f"its type is {COMMANDS}, trajectory_msgs/msg/JointTrajectory is needed"
    assert f["/arm_controller/joint_trajectory"] == ("error", wrong)


def test_the_command_says_so_with_its_status(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, value in {**private(), "ROS_DOMAIN_ID": "47"}.items():
        monkeypatch.setenv(name, value)
    check_command = ["ros2", "check", "swerve-ur10", "--seconds", "0.5", "--backend", "dds"]
    assert main(check_command) == 1
    assert "error   /joint_states" in capsys.readouterr().out
    assert main([*check_command, "--json", "--quiet"]) == 1
    said = capsys.readouterr()
    assert {"level": "error", "topic": "/joint_states", "text": "no publisher"} in json.loads(said.out)["findings"]
    assert said.err == ""
    assert main([*check_command, "--quiet", "--verbose"]) == 1
    assert capsys.readouterr().out == ""


def test_the_nodes_say_as_much_as_is_wanted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, value in {**private(), "ROS_DOMAIN_ID": "51"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(ControlNode, "spin", lambda self, ended: (self.step(), self.close()))
    sim = ["ros2", "sim", "swerve-ur10", "--backend", "dds", "--seconds", "0.1", "--use-sim-time", "--factor", "100"]
    for command, keys in (
        (sim, {"ended", "seconds", "behind", "seed"}),
        (["ros2", "control", *sim[2:5]], {"state", "figures"}),
    ):
        assert main([*command, "--json"]) == 0
        said = capsys.readouterr()
        assert json.loads(said.out).keys() == keys and said.err and "settings" not in said.err
        assert main([*command, "--quiet"]) == 0
        said = capsys.readouterr()
        assert (said.out, said.err) == ("", "")
        assert main([*command, "--verbose"]) == 0
        said = capsys.readouterr()
        assert said.out == "" and "by dds; settings: {" in said.err


@pytest.mark.parametrize("held", [True, False])
def test_a_simulated_robot_that_falls_is_status_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], held: bool
) -> None:
    """A ball robot without torques: MuJoCo's falls within a second, one that somebody holds stands until its time is over."""
    for name, value in private().items():
        monkeypatch.setenv(name, value)
    opens = SimNode._open
    monkeypatch.setattr(SimNode, "_open", lambda sim: (opens(sim), setattr(sim.side, "held", held)))
    sim = ["ros2", "sim", "rezero", "--backend", "dds", "--seconds", "0.1" if held else "3", "--json"]
    assert main(sim) == (0 if held else 1)
    assert json.loads(capsys.readouterr().out)["ended"].startswith("0.1 s are over" if held else "the robot fell at ")


def test_another_odometry_and_brakes_of_nobody(robot: Any, looker: Any) -> None:
    robot.publisher("/odom", "nav_msgs/msg/Odometry")
    drives = [n for g in ("steer", "wheel", "arm") for n in ROBOT.state.groups.get(g, ()) or ROBOT.input.groups[g]]
    settings = SwerveRosSettings.model_validate({"controllers": {"all": {"topic": "/all/commands", "joints": drives}}})
    known(looker, ("/odom",))
    f = {f.topic: (f.level, f.text) for f in check(looker, ROBOT, settings, 1.0)}
    assert f["/odom"] == ("warning", "'robot' publishes it too: two odometries mix")
    assert (
        f["controllers"][0] == "warning"
        and "no controller commands the brake of leg_LF ('brake/leg_LF')" in f["controllers"][1]
    )
    assert "controllers" not in found(looker)


def test_another_transform_of_the_base(robot: Any, looker: Any) -> None:
    """A diff_drive_controller publishes it by default; one of the controller itself, and those of links, are in order."""
    own = open_node("wbmpc", "dds", NETWORK)
    publishers = [n.publisher("/tf", "tf2_msgs/msg/TFMessage") for n in (own, robot)]
    end = threading.Event()
    children = ["base_link", "tool0"]

    def send() -> None:
        while not end.wait(0.02):
            for publisher, child in zip(publishers, children, strict=True):
                publisher.publish({"transforms": [{"header": header(1.0, "odom"), "child_frame_id": child}]})

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    try:
        known(looker, ("/tf",))
        assert "/tf" not in found(looker)
        children[1] = "base_link"
        level, text = found(looker)["/tf"]
        assert level == "warning" and "another node says where 'base_link' is in 'odom'" in text
    finally:
        end.set()
        thread.join()
        own.close()


def test_a_ball_robots_sensors_have_a_message_for_every_tick() -> None:
    from wbmpc.ros2.check import _balancing

    assert _balancing("/imu", 395.0, 400.0) == [] == _balancing("/imu", 0.0, 400.0)
    (finding,) = _balancing("/imu", 120.0, 400.0)
    assert finding.level == "warning" and "120 Hz, the controller of a robot that balances, at 400 Hz" in finding.text


def test_an_endpoint_whose_name_is_announced_late_has_one(
    robot: Any, looker: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a busy machine: an endpoint without a name would count as a stranger's. Truth: who made it."""
    announce = robot._announce
    monkeypatch.setattr(robot, "_announce", lambda: None)
    robot.publisher("/late", "std_msgs/msg/String")
    assert wait_until(lambda: looker.publishers("/late"))
    later = threading.Timer(2.0, announce)
    later.start()
    assert looker.owner(looker.publishers("/late")[0]) == "robot"
    later.join()


@pytest.mark.parametrize("seconds", ["inf", "1e10"])
def test_a_look_without_an_end_is_an_error(seconds: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ros2", "check", "swerve-ur10", "--seconds", seconds]) == 2
    assert "--seconds" in capsys.readouterr().err
