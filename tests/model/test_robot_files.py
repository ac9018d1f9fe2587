"""Robot files of which planner and simulator would mean two different machines. Truth: the files written here, MuJoCo's own."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from own_bases import write_base
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.cli import main
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.robots import load_description, load_spec
from wbmpc.robots.description import DATA

BALL, BALL_JOINT = '<body name="ball">', '<joint name="ball" type="ball"/>'
COM, INERTIA = '<inertial pos="0 0 0" mass="2.65"', 'diaginertia="0.0166 0.0166 0.0166"'
MASS = '<inertial pos="0 0 0" mass="0.2" diaginertia="1e-3 1e-3 1e-3"/>'


def ball_robot(folder: Path, *replace: tuple[str, str], **keys: object) -> Path:
    """Rezero with pieces of its MJCF and keys of its YAML replaced."""
    xml, data = (DATA / "rezero.xml").read_text(), yaml.safe_load((DATA / "rezero.yaml").read_text())
    for old, new in replace:
        assert old in xml
        xml = xml.replace(old, new)
    (folder / "mine.xml").write_text(xml)
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump({**data, "model": "mine.xml", **keys}))
    return path


def rejection(path: Path) -> str:
    with pytest.raises(InputError) as error:
        load_robot(path)
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (BALL, '<body name="ball" pos="0 0 -0.1">', ("the ball's center, which is at (0, 0, -0.1) m", "'base'")),
        (BALL, '<body name="ball" pos="0.05 0 0">', ("(0.05, 0, 0) m",)),
        (BALL, '<body name="ball" euler="0 0 0.3">', ("same axes as 'base'",)),
        (BALL_JOINT, '<joint name="ball" type="ball" pos="0 0 0.02"/>', ("(0, 0, 0.02) m",)),
        (BALL_JOINT, "", ("one joint of type ball", "it has none")),
        (BALL_JOINT, '<joint name="ball" axis="0 1 0"/>', ("one joint of type ball", "it has hinge")),
        (COM, '<inertial pos="0 0 0.03" mass="2.65"', ("center of mass is at (0, 0, 0.03) m",)),
        (INERTIA, 'diaginertia="0.0166 0.0166 0.03"', ("0.03 kg m²", "more than 1 %")),
        (BALL_JOINT, BALL_JOINT + f'<body name="core">{MASS}</body>', ("bodies with mass hang on it",)),
        (
            BALL,
            f'<body name="bearing">{MASS}</body><body name="outer">{MASS}<body name="ball">',
            ("on the base's body",),
        ),
    ],
)
def test_a_ball_that_the_equations_do_not_describe(tmp_path: Path, old: str, new: str, words: tuple[str, ...]) -> None:
    replace = [(old, new)]
    if "outer" in new:
        replace.append(('<geom type="cylinder" size="0.1252 0.008" rgba="0.8 0.15 0.1 1"/>', "</body>"))
    text = rejection(ball_robot(tmp_path, *replace))
    assert all(w in text for w in (*words, "mine.xml", "body 'ball'")), text


def test_a_ball_within_the_tolerance_of_drawings(tmp_path: Path) -> None:
    """A tenth of a millimeter and half a percent."""
    near = ball_robot(
        tmp_path, (BALL, '<body name="ball" pos="0 0 1e-4">'), (INERTIA, 'diaginertia="0.0166 0.0166 0.01668"')
    )
    assert load_robot(near).base.nq == 8


def test_the_command_line_says_it_in_a_message(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = ball_robot(tmp_path, (BALL_JOINT, ""))
    assert main(["run", "rezero-steps", "--set", f"robot={path}", "--out", str(tmp_path / "out")]) == 2
    assert "one joint of type ball" in capsys.readouterr().err


# ---------------------------------------------------------------------- joints in no list
ONE = {"joints": ["arm_yaw", "arm_shoulder"], "tool": "tool"}
LIMITS = {"wheel_effort": 4.0}


def test_a_forgotten_joint_of_a_ball_robot(tmp_path: Path) -> None:
    text = rejection(ball_robot(tmp_path, arm=ONE, home={}, limits=LIMITS))
    assert all(
        w in text for w in ("mine.yaml", "mine.xml", "'arm_elbow'", "arm.joints", "fixed_joints: {arm_elbow: 0}")
    ), text
    held = load_robot(ball_robot(tmp_path, arm=ONE, home={}, limits=LIMITS, fixed_joints={"arm_elbow": 0.3}))
    plant = BallPlant(held.description)
    assert plant.model.nv == 6 + 3 + 2  # the base, the ball, two joints of the arm


def test_forgotten_wrist_joints_of_a_swerve_robot(tmp_path: Path) -> None:
    data = yaml.safe_load((DATA / "swerve-ur10.yaml").read_text())
    data["arm"]["joints"] = data["arm"]["joints"][:4]
    path = tmp_path / "mine.yaml"
    for key in (data["home"], *(v for v in data["limits"].values() if isinstance(v, dict))):
        for name in ("wrist_2_joint", "wrist_3_joint"):
            key.pop(name, None)
    path.write_text(yaml.safe_dump({**data, "model": str(DATA / data["model"])}))
    text = rejection(path)
    assert "'wrist_2_joint', 'wrist_3_joint'" in text and "arm.joints or base.modules" in text
    assert "fixed_joints: {wrist_2_joint: 0, wrist_3_joint: 0}" in text


GRIPPER = """<robot name="r"><link name="base">{mass}</link><link name="arm">{mass}</link>
 <link name="left">{mass}</link><link name="right">{mass}</link>
 <joint name="one" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/></joint>
 <joint name="finger" type="prismatic"><parent link="arm"/><child link="left"/><origin xyz="0 0.1 0.2"/><axis xyz="0 1 0"/>
 <limit lower="0" upper="0.04" effort="1" velocity="1"/></joint>
 <joint name="other" type="prismatic"><parent link="arm"/><child link="right"/><origin xyz="0 -0.1 0.2"/><axis xyz="0 1 0"/>
 <limit lower="-0.04" upper="0" effort="1" velocity="1"/><mimic joint="finger" multiplier="-1"/></joint></robot>""".format(
    mass='<inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
)
FIXED = {"name": "r", "base": {"type": "fixed", "body": "base"}, "arm": {"joints": ["one"], "tool": "right"}}


def fixed_robot(folder: Path, name: str, text: str, **keys: object) -> Path:
    (folder / name).write_text(text)
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump({**FIXED, "model": name, **keys}))
    return path


def test_the_fingers_of_a_urdf_are_held_with_their_coupling(tmp_path: Path) -> None:
    """A finger that mimics the other one, held: the end effector is where MuJoCo has it with both at these values."""
    text = rejection(fixed_robot(tmp_path, "r.urdf", GRIPPER))
    assert "'finger', 'other'" in text and "fixed_joints: {finger: 0, other: 0}" in text
    robot = load_robot(fixed_robot(tmp_path, "r.urdf", GRIPPER, fixed_joints={"finger": 0.03, "other": -0.03}))
    model = mujoco.MjModel.from_xml_string(
        GRIPPER.replace("<link", '<mujoco><compiler fusestatic="false"/></mujoco><link', 1)
    )
    data = mujoco.MjData(model)
    for name, value in {"one": 0.7, "finger": 0.03, "other": -0.03}.items():
        data.qpos[model.joint(name).qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(robot.pose([0.7])[0], data.body("right").xpos, atol=1e-12)


def test_what_an_mjcf_has_beside_its_mechanics_is_in_nobodys_way(tmp_path: Path) -> None:
    """Fingers on a tendon with a drive, a sensor and a keyframe, as grippers come; locked, nothing of it is left."""
    xml = """<mujoco><worldbody><body name="base"><freejoint/><geom size="0.1"/><body name="a">
      <joint name="one" axis="0 1 0"/><geom size="0.1"/><body name="left"><joint name="f" type="slide"/><geom size="0.1"/></body>
      <body name="right" pos="0 0 0.2"><joint name="g" type="slide" axis="1 0 0"/><geom size="0.1"/></body></body></body>
      </worldbody>
      <tendon><fixed name="t"><joint joint="f" coef="1"/><joint joint="g" coef="1"/></fixed></tendon>
      <equality><joint joint1="f" joint2="g"/><tendon tendon1="t"/></equality><sensor><jointpos joint="f"/></sensor>
      <actuator><position name="one" joint="one"/><position tendon="t"/></actuator>
      <keyframe><key qpos="0 0 0 1 0 0 0 0 0 0"/></keyframe></mujoco>"""
    path = fixed_robot(tmp_path, "r.xml", xml, fixed_joints={"f": 0.01, "g": 0.02})
    model = load_spec(load_description(path)).compile()
    assert (model.nv, model.neq, model.nu, model.ntendon, model.nsensor, model.nkey) == (1, 0, 0, 0, 0, 0)
    np.testing.assert_allclose(load_robot(path).pose([0.0])[0], [0.02, 0.0, 0.2], atol=1e-12)


def test_joints_without_a_name_and_files_that_do_not_compile(tmp_path: Path) -> None:
    body = '<body name="base"><geom size="0.1"/><body name="a"><joint name="one"/>{}<geom size="0.1"/><site name="right"/></body>'
    write = lambda extra: fixed_robot(
        tmp_path, "r.xml", f"<mujoco><worldbody>{body.format(extra)}</body></worldbody></mujoco>"
    )
    assert "body 'a' has a joint without a name" in rejection(write('<joint axis="1 0 0"/>'))
    assert "r.xml: cannot be compiled" in rejection(write('<body name="b"><geom size="0"/></body>'))


def test_a_base_that_floats_in_its_own_file(tmp_path: Path) -> None:
    """The simulator gives the base its free joint; the file's is taken for it."""
    path = write_base(tmp_path, 3, False)
    file = tmp_path / "base.xml"
    file.write_text(
        file.read_text().replace('<geom type="cylinder" size="0.35', '<freejoint/><geom type="cylinder" size="0.35')
    )
    robot = load_robot(path)
    assert SwervePlant(robot.description).model.nv == 6 + 3 * 2 + 2


@pytest.mark.parametrize("joint", ["lift", "m0_steer", "m0_leg"])
def test_a_joint_that_does_not_count_from_its_drawing(joint: str, tmp_path: Path) -> None:
    """MuJoCo takes ``ref`` off every value: with the lift's 0.5 its end effector was 17 cm from the planner's."""
    text = rejection(ring(tmp_path, (f'name="{joint}"', f'name="{joint}" ref="0.5"')))
    assert all(w in text for w in (f"base.xml: joint '{joint}'", "'ref' of 0.5")), text


def test_a_held_joint_that_does_not_count_from_its_drawing(tmp_path: Path) -> None:
    path = ring(tmp_path, ('name="lift"', 'name="lift" ref="0.5"'))
    data = yaml.safe_load(path.read_text())
    data.update(arm={"joints": ["pan"], "tool": "hand"}, fixed_joints={"lift": 0.1})
    path.write_text(yaml.safe_dump(data))
    assert "joint 'lift' has a 'ref' of 0.5" in rejection(path)


# ---------------------------------------------------------------------- swerve bases
WHEEL = '<joint name="m0_wheel" axis="0 1 0"'


def ring(folder: Path, *replace: tuple[str, str], hinged: bool = True, **limits: object) -> Path:
    """A base of three modules with pieces of its MJCF replaced, and its limits."""
    path = write_base(folder, 3, hinged)
    xml = (folder / "base.xml").read_text()
    for old, new in replace:
        assert old in xml
        xml = xml.replace(old, new, 1)
    (folder / "base.xml").write_text(xml)
    data = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump({**data, "limits": {**data["limits"], **limits}}))
    return path


def test_a_wheel_that_stops_at_the_end_of_a_range(tmp_path: Path) -> None:
    """Beyond it, it would be dragged."""
    text = rejection(ring(tmp_path, (WHEEL, f'{WHEEL} range="-3 3"')))
    assert all(w in text for w in ("base.xml: joint 'm0_wheel'", "-3 to 3 rad", "type continuous")), text
    text = rejection(ring(tmp_path, position={"m0_wheel": [-3.0, 3.0]}))
    assert "ring.yaml: key 'limits.position.m0_wheel'" in text
    assert load_robot(ring(tmp_path, (WHEEL, f'{WHEEL} range="-3 3" limited="false"'))).base.geometry.modules == 3


@pytest.mark.parametrize(("joint", "axis"), [("wheel", "0 1 0"), ("steer", "0 0 1"), ("leg", "0 0 1")])
def test_a_module_of_sliding_joints(joint: str, axis: str, tmp_path: Path) -> None:
    turns = f'<joint name="m1_{joint}"'
    text = rejection(ring(tmp_path, (f'{turns} axis="{axis}"', f'{turns} type="slide" axis="{axis}"')))
    assert all(w in text for w in (f"base.xml: joint 'm1_{joint}' slides", "ring.yaml")), text


def test_wheels_of_different_heights(tmp_path: Path) -> None:
    """A robot of four wheels stands on two or three of them then."""
    disc = '<body name="m1_disc" pos="0 0 {:g}">'
    text = rejection(ring(tmp_path, (disc.format(-0.12), disc.format(-0.118))))
    assert all(w in text for w in ("ring.yaml", "'m1_wheel' is 2 mm too high")), text
    text = rejection(ring(tmp_path, (disc.format(-0.12), disc.format(-0.129))))
    assert "'m1_wheel' is 9 mm too low" in text
    load_robot(ring(tmp_path, (disc.format(-0.12), disc.format(-0.1195))))


@pytest.mark.parametrize("reach", [0.0, 0.004])
def test_a_hinge_on_the_steering_axis(reach: float, tmp_path: Path) -> None:
    fork = '<body name="m0_fork" pos="{:g} 0 -0.1">'
    text = rejection(ring(tmp_path, (fork.format(0.3), fork.format(reach))))
    assert all(w in text for w in ("ring.yaml", "'m0_steer'", "'m0_leg'", f"{1e3 * reach:.3g} mm")), text
    load_robot(ring(tmp_path, (fork.format(0.3), fork.format(0.01))))
    load_robot(ring(tmp_path, (fork.format(0.3), fork.format(0.0)), hinged=False))  # it swings nothing there


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('mass="40" diaginertia="2 2 3"', 'mass="0" diaginertia="2 2 3"', ("mass and inertia", "'hull'")),
        ('<geom type="cylinder"', '<geom name="floor" type="cylinder"', ("repeated name 'floor'",)),
    ],
)
def test_what_only_the_simulator_cannot_take_names_the_file(
    old: str, new: str, words: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A base without mass compiles as long as it does not float, a geom of the floor's name as long as there is no floor."""
    path = ring(tmp_path, (old, new))
    with pytest.raises(InputError) as error:
        SwervePlant(load_robot(path).description)
    assert all(w in str(error.value) for w in ("base.xml: cannot be", *words)), error.value
    arguments = ["run", "swerve-calibrate", "--set", f"robot={path}", "--out", str(tmp_path / "out")]
    assert main(arguments) == 2
    assert words[0] in capsys.readouterr().err
