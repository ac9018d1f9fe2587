"""Robot files: what is read, and what is said about a bad one. Truth: the files written here."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml

from wbmpc.bases.ball.model import BallBase
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.robots import available_robots, load_description
from wbmpc.robots.description import DATA

URDF = """<robot name="r"><link name="world"/><link name="base_link"><inertial><mass value="2"/>
 <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
 <visual><geometry><mesh filename="package://nowhere/base.dae"/></geometry></visual>
 <collision><geometry><mesh filename="package://nowhere/base.stl"/></geometry></collision></link>
 <joint name="fix" type="fixed"><parent link="world"/><child link="base_link"/><origin xyz="0 0 0.3" rpy="0 0 0.5"/></joint>
 <link name="upper"><inertial><origin xyz="0 0 0.2" rpy="0.1 0.2 0.3"/><mass value="1.5"/>
 <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="0" iyz="0"/></inertial></link>
 <joint name="one" type="revolute"><parent link="base_link"/><child link="upper"/><origin xyz="0.1 0 0.2" rpy="0.3 -0.2 1"/>
 <axis xyz="0 1 0"/><limit lower="-1.5" upper="2" velocity="1" effort="10"/></joint>
 <link name="lower"><inertial><mass value="1"/>
 <inertia ixx="0.02" iyy="0.03" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
 <joint name="two" type="prismatic"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.4"/>
 <axis xyz="0 0 1"/><limit lower="0" upper="0.5" velocity="1" effort="10"/></joint>
 <link name="hand"/>
 <joint name="flange" type="fixed"><parent link="lower"/><child link="hand"/><origin xyz="0 0.1 0.2" rpy="1 0 0"/></joint>
</robot>"""
ARM = {
    "name": "arm",
    "model": "arm.urdf",
    "base": {"type": "fixed", "body": "base_link"},
    "arm": {"joints": ["one", "two"], "tool": "hand"},
    "home": {"one": 0.5},
    "limits": {"velocity": {"one": 1.5}},
}


def write(folder: Path, **changes: object) -> Path:
    """The arm's YAML with some keys replaced; a value None leaves the key out."""
    (folder / "arm.urdf").write_text(URDF)
    data = {k: v for k, v in {**ARM, **changes}.items() if v is not None}
    path = folder / "arm.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def test_the_built_in_robots() -> None:
    assert {"rezero", "swerve-ur10", "swerve-fixed-ur10"} <= set(available_robots())
    for name in available_robots():
        robot = load_robot(name)
        assert robot.description.name == name
        assert robot.description.arm.tool in robot.frames
        assert np.all(np.isfinite(robot.home))
        assert np.all(robot.limits.input_lower < robot.limits.input_upper)


def test_a_urdf_without_its_meshes_equals_pinocchio(tmp_path: Path) -> None:
    robot = load_robot(write(tmp_path))
    model = pin.buildModelFromXML(URDF)
    data = model.createData()
    q = np.array([0.7, 0.2])
    pin.framesForwardKinematics(model, data, q)
    truth = data.oMf[model.getFrameId("hand")]
    p, quaternion = robot.pose(q)
    np.testing.assert_allclose(p, truth.translation, atol=1e-9)
    coefficients = np.roll(pin.Quaternion(truth.rotation).coeffs(), 1)
    np.testing.assert_allclose(np.abs(quaternion @ coefficients), 1.0, atol=1e-12)
    np.testing.assert_allclose(robot.limits.state_lower, [-1.5, 0.0])
    np.testing.assert_allclose(robot.limits.state_upper, [2.0, 0.5])
    np.testing.assert_allclose(robot.limits.input_upper, [1.5, 1.0])  # the YAML's before the file's
    np.testing.assert_allclose(robot.home, [0.5, 0.0])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"model": "amr.urdf"}, ("'model'", "amr.urdf")),
        ({"name": ""}, ("key 'name'", "letters, digits, - and _", "got ''")),
        ({"name": "../amr"}, ("key 'name'", "letters, digits, - and _", "got '../amr'")),
        ({"name": "-amr"}, ("key 'name'", "begins with a letter or digit")),
        ({"name": "a" * 65}, ("key 'name'", "at most 64 characters")),
        ({"arm": {"joints": ["one", "tow"], "tool": "hand"}}, ("'tow'", "did you mean 'two'", "arm.joints")),
        ({"arm": {"joints": ["one", "two"], "tool": "hnad"}}, ("'hnad'", "did you mean 'hand'", "arm.tool")),
        ({"arm": {"joint": ["one"], "tool": "hand"}}, ("'arm.",)),
        ({"home": {"on": 1.0}}, ("'on'", "did you mean 'one'", "home")),
        ({"home": {"one": 3.0}}, ("'home.one'", "3", "2")),
        ({"fixed_joints": {"too": 1.0}}, ("'too'", "did you mean 'two'", "fixed_joints")),
        ({"limits": {"velocities": {"one": 1.0}}}, ("'limits.velocities'", "did you mean 'limits.velocity'")),
        ({"limits": {"velocity": {"three": 1.0}}}, ("'three'", "limits.velocity")),
        ({"limits": {"velocity": {"one": 2.0}, "actuator_velocity": {"one": 1.0}}}, ("'one'", "no less than that")),
        ({"limits": {"wheel_effort": 2.0}}, ("'limits.wheel_effort'", "type fixed", "valid: velocity")),
        (
            {"limits": {"velocity": {"one": 1.0}, "actuator_velocity": {"one": 2.0}}},
            ("steering joint", "limits.actuator_velocity"),
        ),
        ({"hom": {}}, ("'hom'", "did you mean 'home'")),
        ({"base": {"type": "flying", "body": "base_link"}}, ("base", "fixed", "swerve", "ball")),
        ({"base": {"type": "fixed", "body": "base_lnk"}}, ("'base_lnk'", "did you mean 'base_link'")),
        ({"base": {"type": "fixed", "body": "base_link", "wheel_radius": 1}}, ("'base.wheel_radius'",)),
        ({"base": {"type": "fixed", "bod": "base_link"}}, ("'base.bod'", "did you mean 'base.body'", "1 more")),
        ({"base": {"type": "fixed", "body": "base_link", "contact": "wrench"}}, ("base.contact", "no effect", "ball")),
        ({"base": None}, ("'base'",)),
        ({"home": {"one": "far"}}, ("'home.one'", "'far'")),
        ({"home": {"one": float("nan")}}, ("'home.one'",)),
        ({"arm": 5}, ("'arm'",)),
    ],
)
def test_a_bad_file_is_explained_in_one_message(
    tmp_path: Path, changes: dict[str, object], words: tuple[str, ...]
) -> None:
    path = write(tmp_path, **changes)
    with pytest.raises(InputError) as error:
        load_robot(path)
    text = str(error.value)
    assert all(w in text for w in words), text
    assert "arm.yaml" in text
    assert "\n" not in text and "http" not in text and "pydantic" not in text


@pytest.mark.parametrize(
    ("content", "words"),
    [("- 1", ("mapping",)), ("a: [1", ("YAML",)), ("", ("mapping",))],
)
def test_a_file_that_is_no_robot(tmp_path: Path, content: str, words: tuple[str, ...]) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(content)
    with pytest.raises(InputError) as error:
        load_description(path)
    assert all(w in str(error.value) for w in (*words, "bad.yaml")) and "\n" not in str(error.value)


@pytest.mark.parametrize("content", ["<robot", "<mujoco><worldbody><body/></worldbody></mujoco", "not xml"])
def test_a_broken_urdf_is_named(tmp_path: Path, content: str) -> None:
    path = write(tmp_path)
    (tmp_path / "arm.urdf").write_text(content)
    with pytest.raises(InputError, match=r"arm\.urdf"):
        load_description(path)


def test_unknown_robots_and_missing_files() -> None:
    with pytest.raises(InputError, match="did you mean 'swerve-ur10'"):
        load_robot("swerve-ur1")
    with pytest.raises(InputError, match="no such file"):
        load_robot("nowhere.yaml")


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"orientation": "euler"}, ("base.orientation", "yaw", "quaternion")),
        ({"orientatoin": "yaw"}, ("base.orientatoin", "did you mean 'base.orientation'")),
        ({"contact": "force"}, ("base.contact", "inputs of this base are speeds", "no effect on its motion")),
        ({"contact_frame": "tool0"}, ("base.contact_frame", "no effect")),
    ],
)
def test_bad_overrides_of_the_base(overrides: dict[str, str], words: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as error:
        load_robot("swerve-ur10", **overrides)
    assert all(w in str(error.value) for w in words), str(error.value)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"contact": "frce"}, ("base.contact", "'frce'", "wrench")),
        ({"contact": "wrench", "contact_frame": "tol"}, ("'tol'", "base.contact_frame", "did you mean 'tool'")),
        ({"contact": "wrench", "contact_frame": "ball"}, ("'ball'", "base.contact_frame", "tool")),
        ({"contact": "wrench", "contact_frame": ["tool", "tool"]}, ("contact_frame: every frame once",)),
        ({"contact_frame": "tool"}, ("contact_frame needs contact: force",)),
    ],
)
def test_bad_contacts(overrides: dict[str, str], words: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as error:
        load_robot("rezero", **overrides)
    assert all(w in str(error.value) for w in words), str(error.value)


def test_swerve_files_that_the_equations_do_not_describe(tmp_path: Path) -> None:
    source = load_description("swerve-ur10").model
    for file in source.parent.glob("*.xml"):
        (tmp_path / file.name).write_text(file.read_text())
    data = yaml.safe_load((source.parent / "swerve-ur10.yaml").read_text())
    path = tmp_path / "r.yaml"
    data["base"]["modules"][1].pop("hinge")
    data["home"], data["fixed_joints"] = {}, {"leg_RF": 0.0}
    data["limits"] = {}
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(InputError, match="all modules or none"):
        load_robot(path)
    modules, data["fixed_joints"] = data["base"]["modules"], {}
    modules[1]["hinge"], modules[0]["hinge"] = "leg_LF", "leg_RF"
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(InputError, match=r"key 'base\.modules': joint 'leg_RF' does not move 'steer_LF'"):
        load_robot(path)
    modules[1]["hinge"], modules[0]["hinge"] = "leg_RF", "leg_LF"
    path.write_text(yaml.safe_dump(data))
    for target, old, new in (
        ("under the axis", '<body name="wheel_LF" pos="0 0 -0.2746">', '<body name="wheel_LF" pos="0.03 0 -0.2746">'),
        (r"\+z axis", '<default class="steer"><joint axis="0 0 1"', '<default class="steer"><joint axis="0 0 -1"'),
        ("horizontal", '<default class="wheel"><joint axis="0 1 0"', '<default class="wheel"><joint axis="0 1 1"'),
        ("one level", '<body name="wheel_LF" pos="0 0 -0.2746">', '<body name="wheel_LF" pos="0 0 -0.2">'),
    ):
        (file,) = [f for f in (tmp_path / "swerve.xml", tmp_path / "swerve-legs.xml") if old in f.read_text()]
        text = file.read_text()
        file.write_text(text.replace(old, new))
        with pytest.raises(InputError, match=target):
            load_robot(path)
        file.write_text(text)


def test_importing_is_light() -> None:
    """The package loads no engine before it is asked for one."""
    code = "import sys, wbmpc; print([m for m in ('casadi', 'mujoco', 'llvmlite') if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


SWERVE = (Path(load_description("swerve-ur10").source)).read_text()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"name: \xff\xfe", "not a text file in UTF-8"),
        (b"1: 2\nname: r", "unknown key '1'; valid: name, model, base"),
    ],
)
def test_files_that_are_no_descriptions(tmp_path: Path, text: bytes, message: str) -> None:
    path = tmp_path / "r.yaml"
    path.write_bytes(text)
    with pytest.raises(InputError, match=message):
        load_description(path)


def test_a_joint_named_twice(tmp_path: Path) -> None:
    data = yaml.safe_load(SWERVE)
    data["arm"]["joints"][1] = data["arm"]["joints"][0]
    path = tmp_path / "r.yaml"
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(InputError, match="every joint once, got 'shoulder_pan_joint' twice"):
        load_description(path)
    data = yaml.safe_load(SWERVE)
    data["limits"] = {"effort": {"elbow_joint": -1.0}}
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(InputError, match=r"key 'limits.effort.elbow_joint': .* greater than or equal to .*, got -1"):
        load_description(path)
    with pytest.raises(InputError, match="a name or a path"):
        load_robot(None)  # type: ignore[arg-type]


IMU = '<site name="imu" pos="0 0 0.3"/>'


def ball_robot(folder: Path, **changes: object) -> Path:
    """Rezero with other keys and, in place of its inertial unit, ``imu``."""
    xml, data = (DATA / "rezero.xml").read_text(), yaml.safe_load((DATA / "rezero.yaml").read_text())
    assert IMU in xml
    (folder / "ball.xml").write_text(xml.replace(IMU, str(changes.pop("imu", IMU))))
    data["base"]["wheels"] |= changes.pop("wheels", {})
    path = folder / "ball.yaml"
    path.write_text(yaml.safe_dump(data | {"model": "ball.xml"} | changes))
    return path


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"limits": {"spin_effort": 2.0}}, ("ball.yaml", "'limits.wheel_effort'", "omni wheels")),
        ({"wheels": {"azimuths": [0.0, 0.0, 0.0]}}, ("ball.yaml", "'base.wheels.azimuths'", "three different")),
        ({"wheels": {"azimuths": [0.0, np.pi, 0.0, np.pi]}}, ("ball.yaml", "'base.wheels.azimuths'", "every axis")),
        ({"imu": '<site name="imu" euler="0 0 90"/>'}, ("ball.xml", "'imu'", "'base'", "same axes")),
        ({"imu": '<body name="imu"><joint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'}, ("'imu'",)),
    ],
)
def test_a_ball_robot_that_cannot_balance_is_rejected(
    tmp_path: Path, changes: dict[str, object], words: tuple[str, ...]
) -> None:
    with pytest.raises(InputError) as error:
        load_robot(ball_robot(tmp_path, **changes))
    text = str(error.value)
    assert all(w in text for w in words) and "\n" not in text, text


@pytest.mark.parametrize("imu", ['<site name="imu" pos="0.1 0.2 0.3"/>', '<body name="imu" pos="0.1 0.2 0.3"/>'])
def test_where_its_inertial_unit_is(tmp_path: Path, imu: str) -> None:
    """A site, or a link of its own as in URDF: planner and simulator agree."""
    robot = load_robot(ball_robot(tmp_path, imu=imu))
    assert isinstance(robot.base, BallBase)
    for mount in (robot.base.mount, BallPlant(robot.description).sensors.mount):
        np.testing.assert_allclose(mount, [0.1, 0.2, 0.3], atol=1e-12)
