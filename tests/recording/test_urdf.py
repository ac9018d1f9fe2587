"""Robots as URDF. Truth: Pinocchio, which reads the text by code of its own, against MuJoCo's kinematics and masses."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio
import pytest

from frame_tree import of_urdf, root
from wbmpc.robots import available_robots, load_description, load_spec
from wbmpc.robots.description import RobotDescription
from wbmpc.robots.frames import frame_names
from wbmpc.robots.urdf import to_urdf


def compare(description: RobotDescription, seed: int) -> None:
    spec = load_spec(description)
    model, rng = spec.compile(), np.random.default_rng(seed)
    data = mujoco.MjData(model)
    theirs = pinocchio.buildModelFromXML(to_urdf(description))
    memory, q = theirs.createData(), pinocchio.neutral(theirs)
    for j in range(model.njnt):
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_BALL:
            continue
        angle, joint = rng.uniform(-1.0, 1.0), theirs.joints[theirs.getJointId(model.joint(j).name)]
        data.qpos[model.jnt_qposadr[j]] = angle
        # a continuous joint is a point on the circle there
        q[joint.idx_q : joint.idx_q + joint.nq] = [angle] if joint.nq == 1 else [np.cos(angle), np.sin(angle)]
    mujoco.mj_kinematics(model, data)
    pinocchio.framesForwardKinematics(theirs, memory, q)
    base = model.body(description.base.body).id
    turn, origin = data.xmat[base].reshape(3, 3), data.xpos[base]
    bodies = [model.body(i).name for i in range(1, model.nbody)]
    names = frame_names(description.base.body, bodies)
    frames = [(names[body], data.xpos[i], data.xmat[i]) for i, body in enumerate(bodies, 1)]
    frames += [(model.site(i).name, data.site_xpos[i], data.site_xmat[i]) for i in range(model.nsite)]
    for name, position, rotation in frames:
        placed = memory.oMf[theirs.getFrameId(name, pinocchio.FrameType.BODY)]
        np.testing.assert_allclose(placed.translation, turn.T @ (position - origin), atol=1e-8, err_msg=name)
        np.testing.assert_allclose(placed.rotation, turn.T @ rotation.reshape(3, 3), atol=1e-8, err_msg=name)
    mass = pinocchio.computeTotalMass(theirs) + theirs.inertias[0].mass
    assert mass == pytest.approx(model.body_mass[1:].sum(), rel=1e-8)
    center = pinocchio.centerOfMass(theirs, memory, q) * pinocchio.computeTotalMass(theirs)
    center = (center + theirs.inertias[0].mass * theirs.inertias[0].lever) / mass
    mujoco.mj_comPos(model, data)
    np.testing.assert_allclose(center, turn.T @ (data.subtree_com[base] - origin), atol=1e-8)


@pytest.mark.parametrize("name", available_robots())
@pytest.mark.parametrize("seed", range(3))
def test_frames_and_masses(name: str, seed: int) -> None:
    compare(load_description(name), seed)


ODD = """
<mujoco model="odd"><compiler angle="radian"/><worldbody><body name="trunk" pos="0 0 1">
  <inertial pos="0 0 0.1" mass="2" diaginertia="1 1 1"/>
  <body name="two" pos="0.1 0.2 0.3" euler="0.3 -0.4 0.5">
    <inertial pos="0.05 0 0" quat="0.8 0.6 0 0" mass="1" diaginertia="0.1 0.2 0.25"/>
    <joint name="slide" type="slide" axis="1 0 0" range="-1 1"/>
    <joint name="turn" type="hinge" axis="0 0 1" pos="0.02 0.03 0.04" range="-2 2"/>
    <geom type="capsule" size="0.02 0.1" mass="0"/><geom type="ellipsoid" size="0.1 0.2 0.3" mass="0"/>
    <body name="hand" pos="0 0 0.2"><inertial pos="0 0 0" mass="0.5" diaginertia="0.1 0.1 0.1"/></body>
  </body></body></worldbody></mujoco>
"""


def test_joints_beside_their_bodies(tmp_path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "odd.xml").write_text(ODD)
    (tmp_path / "odd.yaml").write_text(
        "name: odd\nmodel: odd.xml\nbase: {type: fixed, body: trunk}\narm: {joints: [slide, turn], tool: hand}\n"
    )
    description = load_description(tmp_path / "odd.yaml")
    for seed in range(3):
        compare(description, seed)
    text = to_urdf(description)
    assert text.count("<sphere") == 2 and text.count("<cylinder") == 1 and 'upper="2"' in text


def test_a_robot_that_is_urdf_stays_as_it_is(tmp_path) -> None:  # type: ignore[no-untyped-def]
    source = load_description("ur5")
    text = to_urdf(source)
    (tmp_path / "own.urdf").write_text(text)
    joints = ", ".join(source.joints())
    (tmp_path / "own.yaml").write_text(
        f"name: own\nmodel: own.urdf\nbase: {{type: fixed, body: base_link}}\narm: {{joints: [{joints}], tool: tool0}}\n"
    )
    own = load_description(tmp_path / "own.yaml")
    assert to_urdf(own) == text
    links, parents = of_urdf(to_urdf(own, base="chassis", world="wrist_1_link"))
    assert root(parents, "tool0") == "chassis" and "base_link" not in links
    assert parents["wrist_2_link"] == "arm_wrist_1_link" and parents["shoulder_link"] == "chassis"


COLUMN = """
<robot name="column">
  <link name="foot">{mass}</link><link name="a">{mass}</link><link name="b">{mass}</link><link name="c">{mass}</link><link name="d">{mass}</link>
  <joint name="rise" type="prismatic"><parent link="foot"/><child link="a"/><origin xyz="0 0.1 0.3" rpy="0.4 0.2 -0.3"/>
    <axis xyz="0 0.6 0.8"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
  <joint name="turn" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.2 0 0.1" rpy="-0.5 0.1 0.7"/>
    <axis xyz="0 1 1"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
  <joint name="swing" type="revolute"><parent link="b"/><child link="c"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
  <joint name="wrist" type="revolute"><parent link="c"/><child link="d"/><origin xyz="0.2 0 0.1"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
  <transmission name="t"><joint name="wrist"/></transmission>
</robot>"""


def column(folder: Path, more: str) -> RobotDescription:
    mass = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    (folder / "own.urdf").write_text(COLUMN.format(mass=mass))
    (folder / "own.yaml").write_text(f"name: own\nmodel: own.urdf\nbase: {{type: fixed, body: foot}}\n{more}\n")
    return load_description(folder / "own.yaml")


def test_joints_that_are_held_are_fixed_where_they_are_held(tmp_path: Path) -> None:
    """No joint states have them: robot_state_publisher would send nothing of what hangs on them."""
    arm = "arm: {joints: [wrist], tool: d}\nfixed_joints: {rise: 0.2, turn: -0.7, swing: 0.4}"
    own = column(tmp_path, arm)
    for seed in range(3):
        compare(own, seed)
    _, parents = of_urdf(to_urdf(own), {"wrist"})
    assert root(parents, "d") == "base_link"


def test_joints_that_are_coupled_mimic(tmp_path: Path) -> None:
    """As a URDF says it: the follower's value is the multiplier times that of the other joint, and the offset."""
    arm = "arm: {joints: [rise, swing, wrist], tool: d}\ncouple: {turn: {joint: wrist, ratio: -0.5, offset: 0.1}}"
    text = to_urdf(column(tmp_path, arm), joints={"wrist": "hand"})
    _, parents = of_urdf(text, {"rise", "swing", "hand"})
    assert root(parents, "d") == "base_link" and text.count('"hand"') == 3 and '"wrist"' not in text
    mimic = ElementTree.fromstring(text).find("joint[@name='turn']/mimic")
    assert mimic is not None and mimic.attrib == {"joint": "hand", "multiplier": "-0.5", "offset": "0.1"}


@pytest.mark.parametrize("own", [False, True])
def test_a_joint_may_be_called_like_one_without_states(own: bool, tmp_path: Path) -> None:
    """Like a held or a floating one, or the fixed one of a named point; others that are called like each other swap. URDF: names of joints
    are unique, and its reader rejects others."""
    held = "arm: {joints: [rise, swing, wrist], tool: d}\nfixed_joints: {turn: -0.7}"
    description = column(tmp_path, held) if own else load_description("rezero")
    called = (
        {"wrist": "turn", "rise": "swing", "swing": "rise"} if own else {"arm_elbow": "tool_fixed", "arm_yaw": "ball"}
    )
    before, after = (pinocchio.buildModelFromXML(to_urdf(description, joints=j)) for j in (None, called))
    assert [called.get(n, n) for n in before.names] == [n.removesuffix("_frame") for n in after.names]
    assert of_urdf(to_urdf(description))[1] == of_urdf(to_urdf(description, joints=called))[1]


def test_no_link_between_two_joints_of_a_body_is_called_like_another_frame(tmp_path: Path) -> None:
    """Nor are two points on links. URDF: names of links are unique."""
    body = '<body name="turn_link"><joint name="turn" axis="0 0 1"/><joint name="tilt" axis="0 1 0"/><geom size="0.1" mass="1"/>'
    sites = '<site name="tool" pos="0.1 0 0"/><site name="trunk"/><site name="trunk_frame"/>'
    (tmp_path / "odd.xml").write_text(
        f'<mujoco><worldbody><body name="trunk"><geom size="0.1" mass="1"/>{body}{sites}</body></body></worldbody></mujoco>'
    )
    (tmp_path / "odd.yaml").write_text(
        "name: odd\nmodel: odd.xml\nbase: {type: fixed, body: trunk}\narm: {joints: [turn, tilt], tool: tool}\n"
        "limits: {velocity: {turn: 1, tilt: 1}, position: {turn: [-1, 1], tilt: [-1, 1]}}\n"
    )
    description = load_description(tmp_path / "odd.yaml")
    compare(description, 0)
    assert root(of_urdf(to_urdf(description, base="trunk"))[1], "tool") == "trunk"


def test_what_is_above_the_base_of_an_own_urdf_is_left_out(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """A URDF for Gazebo hangs on its world; on the bus the base hangs on odom."""
    weight = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    joint = '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/><axis xyz="0 0 1"/>{}</joint>'
    limit = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
    (tmp_path / "own.urdf").write_text(
        f'<robot name="own"><link name="world"/><link name="trunk">{weight}</link><link name="base_link">{weight}</link>'
        + joint.format("fix", "fixed", "world", "trunk", "")
        + joint.format("turn", "revolute", "trunk", "base_link", limit)
        + "</robot>"
    )
    (tmp_path / "own.yaml").write_text(
        "name: own\nmodel: own.urdf\nbase: {type: fixed, body: trunk}\narm: {joints: [turn], tool: base_link}\n"
    )
    links, parents = of_urdf(to_urdf(load_description(tmp_path / "own.yaml")))
    assert links == {"base_link", "arm_base_link"} and parents == {"arm_base_link": "base_link"}


def test_a_ball_joint_of_an_own_urdf_floats_on_the_bus(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """The ball robot as a URDF, as MuJoCo reads it; ROS knows no such joint."""
    source = load_description("rezero")
    text = to_urdf(source, base=source.base.body, world="odom")
    assert text.count('"floating"') == 1
    (tmp_path / "own.urdf").write_text(text.replace('"floating"', '"spherical"'))
    own = source.model_copy(update={"model": tmp_path / "own.urdf"})
    assert to_urdf(own, base=source.base.body, world="odom").count('"floating"') == 1
