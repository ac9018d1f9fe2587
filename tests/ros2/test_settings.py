"""The bus's YAML. Truth: what the files say; messages that name file, key and valid choices."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from wbmpc.bases import base_type
from wbmpc.bases.base import BaseType
from wbmpc.bases.planar.plugin import MobileBaseType
from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
from wbmpc.cli import main
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.ros2.settings import load_settings

ROBOT = load_robot("swerve-ur10")
DOCS = Path(__file__).parents[2] / "docs" / "how-to" / "ros2.md"


def write(folder: Path, text: str) -> Path:
    path = folder / "bus.yaml"
    path.write_text(text)
    return path


def test_everything_has_a_default() -> None:
    settings = load_settings(None, ROBOT)
    topics = {name: c.topic for name, c in settings.command_topics(ROBOT).items()}
    assert topics["wheel_controller"] == "/wheel_controller/commands" and len(topics) == 4
    assert settings.safety.watchdog == 0.1 and settings.bus_name("wheel_LF") == "wheel_LF"


def test_a_robot_with_fixed_legs_has_no_brakes() -> None:
    assert "brake_controller" not in SwerveRosSettings().command_topics(load_robot("swerve-fixed-ur10"))


def test_controllers_and_joints_as_the_robot_has_them(tmp_path: Path) -> None:
    arm = ", ".join(ROBOT.input.groups["arm"])
    text = f"""
joints: {{wheel_LF: fl_wheel}}
controllers:
  base: {{topic: /base/commands, joints: [wheel_LF, steer_LF, wheel_RF, steer_RF, wheel_LB, steer_LB, wheel_RB, steer_RB]}}
  arm: {{topic: /arm/commands, joints: [{arm}]}}
"""
    settings = load_settings(write(tmp_path, text), ROBOT)
    assert settings.command_topics(ROBOT)["base"].joints[1] == "steer_LF"
    assert settings.bus_name("wheel_LF") == "fl_wheel"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("topics: {joint_state: /x}", "unknown key 'topics.joint_state' (did you mean 'topics.joint_states'?)"),
        ("rate: 3", "unknown key 'rate'"),
        ("topics: {joint_states: ''}", "cannot be switched off"),
        ("speeds: {base: 1e300}", "speeds.base=1e+300"),
        ("speeds: {base: yes}", "true or false"),
        ("cmd_vel: {base: 1e9}", "cmd_vel.base=1000000000.0"),
        ("rates: {control: 1e-300}", "rates.control=1e-300"),
        ("mpc: {horizon: 1e9}", "mpc.horizon=1000000000.0"),
        ("mpc: {rate: yes}", "true or false"),
        (
            "topics: {goal_pose: /cmd_vel}",
            "key 'topics.cmd_vel': '/cmd_vel' is the topic of 'topics.goal_pose' already",
        ),
        ("topics: {plan: wheel_controller/commands}", "is the topic of 'topics.plan' already"),
        ("topics: {odom: /tf}", "key 'topics.odom': '/tf' always carries tf2_msgs/msg/TFMessage"),
        (
            "topics: {joint_states: /clock}",
            "key 'topics.joint_states': '/clock' always carries rosgraph_msgs/msg/Clock",
        ),
        (
            "topics: {end_effector_pose: tf_static}",
            "key 'topics.end_effector_pose': 'tf_static' always carries tf2_msgs/msg/TFMessage",
        ),
        ("topics: {odom: /robot_description}", "'/robot_description' always carries std_msgs/msg/String"),
        ("topics: {plan: /rosout}", "key 'topics.plan': '/rosout' always carries"),
        ("ignore: [gripper, wheel_LF]", "key 'ignore': 'wheel_LF' is a joint of this robot, which is needed"),
        ("{joints: {wheel_LF: fl}, ignore: [fl]}", "key 'ignore': 'fl' is our joint 'wheel_LF', which is needed"),
        ("node: a\nnode: b", "line 2, key 'node': appears twice"),
        ("topics: {odom: /a, imu: /b, odom: /c}", "line 1, key 'topics.odom': appears twice"),
        (f"node: {201 * 'a'}", "a node's name has at most 200 characters"),
        ("frames: {world: ''}", "frames.world='': a name is needed"),
        ("frames: {world: /odom}", "frames.world='/odom': a frame's name begins with no /, has no spaces and at most"),
        (f"frames: {{base: {201 * 'a'}}}", "a frame's name begins with no /, has no spaces and at most 200 characters"),
        ("frames: {base: map}", "key 'frames.base': a frame above it is called 'map' too"),
        ("speeds: {base: .inf}", "speeds.base=inf"),
        ("topics: {odom: /a__b}", "topics.odom='/a__b': a topic's name has no two _ in a row"),
        ("joints: {wheel_LF: ''}", "key 'joints': 'wheel_LF' has no name on the bus"),
        ("frames: {world: base_link}", "key 'frames.base': a frame above it is called 'base_link' too"),
        ("controllers: {w: {topic: '', joints: [wheel_LF]}}", "controllers.w.topic='': a name is needed"),
        ("goals: {base: 0}", "goals.base=0"),
        ("safety: {watchdog: 0}", "safety.watchdog=0"),
        ("safety: {watchdog: 1e-300}", "safety.watchdog=1e-300: input should be greater than or equal to 0.001"),
        ("safety: {policy: 1e-9}", "safety.policy=1e-09: input should be greater than or equal to 0.001"),
        ("safety: {jump: 1e-300}", "safety.jump=1e-300: input should be greater than or equal to 0.001"),
        (
            "cost: {end_effector: {weight: 1e300}}",
            "cost.end_effector.weight=1e+300: input should be less than or equal to",
        ),
        ("joints: {wheel_XX: a}", "unknown joint (key 'joints') 'wheel_XX'"),
        ("joints: {wheel_LF: wheel_RF}", "two joints are called 'wheel_RF' on the bus"),
        ("controllers: {w: {topic: /w, joints: [wheel_LF, wheel_LF]}}", "joint 'wheel_LF' is commanded by 'w' too"),
        ("controllers: {w: {topic: /w, joints: [wheel_LF]}}", "no controller commands joint 'wheel_RF'"),
        ("controllers: {w: {topic: /w, joints: [leg_LF]}}", "unknown joint 'leg_LF'"),
        ("[1, 2]", "a mapping of keys is needed"),
        ("a: [", "not valid YAML"),
        ("joints: {wheel_lf: a}", "unknown joint (key 'joints') 'wheel_lf' (did you mean 'wheel_LF'?)"),
        ("ignore: gripper", "ignore='gripper': several names in brackets are needed"),
        ("node: my robot", "node='my robot': a name of letters, digits and _ is needed"),
        ("topics: {goal_pose: /goal pose}", "topics.goal_pose='/goal pose': a topic's name is made of letters"),
        ("controllers: {w: {topic: /4/w, joints: [wheel_LF]}}", "controllers.w.topic='/4/w': a topic's name is"),
    ],
)
def test_faults_are_one_message_with_the_file(tmp_path: Path, text: str, says: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(InputError, match=f"{re.escape(str(path))}: .*{re.escape(says)}"):
        load_settings(path, ROBOT)


def test_the_speed_at_which_learned_forces_end_a_run_needs_some_that_are_learned(tmp_path: Path) -> None:
    path, ball = write(tmp_path, "{disturbance: {kind: none, max_pushed_speed: 1}}"), load_robot("rezero")
    with pytest.raises(InputError, match=r"disturbance\.max_pushed_speed"):
        load_settings(path, ball)
    settings = load_settings(write(tmp_path, "{disturbance: {max_pushed_speed: 1}}"), ball)
    assert settings.disturbance.max_pushed_speed == 1.0  # type: ignore[attr-defined]


def test_a_file_without_a_key_is_the_defaults(tmp_path: Path) -> None:
    assert load_settings(write(tmp_path, "# nothing yet"), ROBOT) == SwerveRosSettings()


def test_the_documentations_settings_are_valid(tmp_path: Path) -> None:
    """The first YAML block of docs/how-to/ros2.md that has the key 'topics'."""
    blocks = re.findall(r"```yaml\n(.*?)```", DOCS.read_text(), re.S)
    block = next(b for b in blocks if "topics:" in b)
    settings = load_settings(write(tmp_path, block), ROBOT)
    assert settings.bus_name("wheel_LF") == "front_left_wheel_joint"


def test_the_documentations_controllers_are_the_robots() -> None:
    """controllers.yaml of docs/how-to/ros2.md against the robot's own drives, and against the parameters and interfaces that
    ros2_controllers' definitions have; every controller finds its interface in the URDF's tags."""
    text = DOCS.read_text()
    block = next(b for b in re.findall(r"```yaml\n(.*?)```", text, re.S) if "controller_manager:" in b)
    file = yaml.safe_load(block)
    types = {n: v["type"] for n, v in file["controller_manager"]["ros__parameters"].items() if isinstance(v, dict)}
    parameters = {
        "velocity_controllers/JointGroupVelocityController": {"joints"},
        "forward_command_controller/ForwardCommandController": {"joints", "interface_name"},
        "imu_sensor_broadcaster/IMUSensorBroadcaster": {"sensor_name", "frame_id"},
        "joint_state_broadcaster/JointStateBroadcaster": set(),
    }
    assert {n: set(file.get(n, {"ros__parameters": {}})["ros__parameters"]) for n in types} == {
        n: parameters[t] for n, t in types.items()
    }
    for name, controller in SwerveRosSettings().command_topics(ROBOT).items():
        assert tuple(file[name]["ros__parameters"]["joints"]) == tuple(
            j.removeprefix("brake/") for j in controller.joints
        )
        assert controller.topic == f"/{name}/commands"
    tags = ElementTree.fromstring(next(b for b in re.findall(r"```xml\n(.*?)```", text, re.S)))
    given = {j.get("name"): {c.get("name") for c in j.findall("command_interface")} for j in tags.findall("joint")}
    assert given == {"wheel_LF": {"velocity"}, "steer_LF": {"velocity"}, "leg_LF": {"brake"}}
    assert all([s.get("name") for s in j.findall("state_interface")] == ["position"] for j in tags.findall("joint"))
    sensor = tags.find("sensor")
    assert sensor is not None and sensor.get("name") == file["imu_broadcaster"]["ros__parameters"]["sensor_name"]
    assert len(sensor.findall("state_interface")) == 10  # orientation, angular velocity, linear acceleration


@pytest.fixture
def planar_without_a_bus(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A base type without a part for ROS 2, as one in somebody's package may be."""
    monkeypatch.setattr(MobileBaseType, "ros_settings", BaseType.ros_settings)
    base_type.cache_clear()
    yield
    monkeypatch.undo()
    base_type.cache_clear()


def test_commands_reject_other_robots_and_missing_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], planar_without_a_bus: None
) -> None:
    """One link, one hinge."""
    (tmp_path / "r.xml").write_text(
        '<mujoco><worldbody><body name="base"><geom size="0.1"/><body name="tip" pos="0 0 1"><joint name="turn" range="-1 1"/>'
        '<geom size="0.1"/></body></body></worldbody><compiler autolimits="true"/></mujoco>'
    )
    text = "name: r\nmodel: r.xml\nbase: {type: planar, body: base, drive: omni}\narm: {joints: [turn], tool: tip}\nlimits: {velocity: {turn: 1.0}}\n"
    (tmp_path / "r.yaml").write_text(text)
    assert main(["ros2", "control", str(tmp_path / "r.yaml")]) == 2
    assert capsys.readouterr().err == (
        "wbmpc: 'r' has a base of type 'planar', whose plug-in offers no controller for ROS 2 ('ros_settings'); valid: ball, "
        "differential, fixed, omnidirectional, swerve, wheels\n"
    )
    assert main(["ros2", "check", "swerve-ur10", "--config", "nowhere.yaml"]) == 2
    assert capsys.readouterr().err == "wbmpc: --config: there is no file 'nowhere.yaml'\n"
    assert main(["ros2", "check", "swerve-ur10", "--config", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"wbmpc: --config: '{tmp_path}' is a directory, a YAML file is needed\n"
    (tmp_path / "latin.yaml").write_bytes(b"node: gr\xfcn")
    assert main(["ros2", "check", "swerve-ur10", "--config", str(tmp_path / "latin.yaml")]) == 2
    assert "latin.yaml: not a text file in UTF-8 (invalid start byte at byte 8)" in capsys.readouterr().err
    assert main(["ros2"]) == 0


def test_a_ball_robots_settings_are_its_own(tmp_path: Path) -> None:
    ball = load_robot("rezero")
    settings = load_settings(write(tmp_path, "joints: {wheel_0: omni_front}\ncost: {end_effector: {roll: 1.0}}"), ball)
    assert settings.mpc.horizon == 1.3 and settings.bus_name("wheel_0") == "omni_front"
    assert set(settings.command_topics(ball)) == {"wheel_controller", "arm_controller"}
    with pytest.raises(InputError, match=r"unknown key 'cost.state'"):
        load_settings(write(tmp_path, "cost: {state: {leg: 1.0}}"), ball)


def test_only_an_arm_is_led_by_trajectories(tmp_path: Path) -> None:
    names = {g: ", ".join(ROBOT.input.groups[g]) for g in ("wheel", "steer", "arm")}
    controllers = "\n".join(
        f"  {g}: {{topic: /{g}, joints: [{n}], takes: {'trajectory' if g == 'arm' else 'numbers'}}}"
        for g, n in names.items()
    )
    settings = load_settings(write(tmp_path, f"controllers:\n{controllers}"), ROBOT)
    assert settings.command_topics(ROBOT)["arm"].type == "trajectory_msgs/msg/JointTrajectory"
    with pytest.raises(InputError, match=r"'wheel_LF' cannot be led by a trajectory; valid: shoulder_pan_joint"):
        load_settings(write(tmp_path, f"controllers:\n{controllers.replace('numbers', 'trajectory')}"), ROBOT)
