"""Models as others publish them: bad inertias, missing meshes, macros, limits in the model. Truth: the numbers written here."""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml

from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.obstacles.geometry import robot_geometry
from wbmpc.robots import load_spec, xacro_file
from wbmpc.robots.xacro_file import find_package

INERTIA = '<inertial><origin xyz="0 0 0.1"/><mass value="{}"/><inertia ixx="{}" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>'
GOOD = INERTIA.format(2, 0.01)
URDF = """<robot name="lift" {names}>
 {macros}
 <link name="stand">{stand}</link>
 <link name="slide">{slide}{mesh}</link>
 <link name="tip">{tip}</link>
 <joint name="rise" type="prismatic"><parent link="stand"/><child link="slide"/><axis xyz="0 0 1"/>
  <limit lower="0" upper="{height}" velocity="0.2" effort="300"/></joint>
 <joint name="swing" type="revolute"><parent link="slide"/><child link="tip"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1" velocity="0" effort="20"/></joint>
</robot>"""
MESH = '<visual><geometry><mesh filename="package://parts/{}.stl"/></geometry></visual>'
MJCF = """<mujoco><compiler angle="radian"/><asset>{mesh}</asset><worldbody><body name="stand"><geom size="0.1"/>
 <body name="slide"><joint name="rise" type="slide" axis="0 0 1" range="0 0.8" actuatorfrcrange="-250 250"/>
  <inertial pos="0 0 0" mass="2" diaginertia="0.01 0.01 {third}"/>{shape}
  <body name="tip"><joint name="swing" axis="0 1 0" range="-1 1"/>{tip}</body></body></body></worldbody>
 <actuator><velocity joint="rise" kv="100" ctrlrange="-0.3 0.3"/><motor joint="swing" gear="5" ctrlrange="-4 4"/></actuator></mujoco>"""


def robot_file(folder: Path, model: str, text: str, **keys: Any) -> Path:
    (folder / model).write_text(text)
    data = {
        "name": "lift",
        "model": model,
        "base": {"type": "fixed", "body": "stand"},
        "arm": {"joints": ["rise", "swing"], "tool": "tip"},
    }
    path = folder / "lift.yaml"
    path.write_text(yaml.safe_dump({**data, **keys}))
    return path


def urdf(**parts: str) -> str:
    given = {"names": "", "macros": "", "stand": GOOD, "slide": GOOD, "tip": GOOD, "mesh": "", "height": "0.8"}
    return URDF.format(**{**given, **parts})


def mjcf(**parts: str) -> str:
    return MJCF.format(**{"mesh": "", "third": "0.01", "shape": "", "tip": '<geom size="0.1"/>', **parts})


def test_limits_of_the_model_hold_where_the_yaml_has_none(tmp_path: Path) -> None:
    """A speed of 0 is none at all; a motor's 4 N m are 20 behind its gear."""
    limits = load_robot(robot_file(tmp_path, "a.urdf", urdf())).limits
    np.testing.assert_array_equal(limits.input_upper, [0.2, np.inf])
    np.testing.assert_array_equal(limits.state_upper, [0.8, 1.0])
    robot = load_robot(
        robot_file(tmp_path, "a.xml", mjcf(), limits={"velocity": {"swing": 2.0}, "effort": {"rise": 9.0}})
    )
    np.testing.assert_allclose(robot.limits.input_upper, [0.3, 2.0])
    assert robot.description.limits.effort == {"rise": 9.0, "swing": 20.0}


@pytest.mark.parametrize(
    ("model", "text", "link"),
    [
        ("a.urdf", urdf(slide=INERTIA.format(2, -0.01)), "slide"),
        ("a.urdf", urdf(tip=""), "tip"),
        ("a.xml", mjcf(tip=""), "tip"),
    ],
)
def test_inertias_that_a_kinematic_planner_does_not_need(
    model: str, text: str, link: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Replaced with a warning that names the link; kinematics are those of the sound file."""
    with caplog.at_level(logging.WARNING):
        robot = load_robot(robot_file(tmp_path, model, text))
    assert [r for r in caplog.messages if f"link '{link}'" in r and model in r]
    sound = load_robot(robot_file(tmp_path, model, urdf() if model == "a.urdf" else mjcf()))
    np.testing.assert_allclose(robot.pose([0.3, 0.4])[0], sound.pose([0.3, 0.4])[0])
    compiled = load_spec(robot.description).compile()
    assert np.all(np.linalg.eigvalsh(np.diag(compiled.body(link).inertia)) > 0.0)


def test_moments_that_no_body_has_in_an_mjcf(tmp_path: Path) -> None:
    assert load_robot(robot_file(tmp_path, "a.xml", mjcf(third="1.0"))).state.size == 2


def test_missing_meshes_are_no_error(tmp_path: Path) -> None:
    load_robot(robot_file(tmp_path, "a.urdf", urdf(mesh=MESH.format("none"))))
    mesh = (
        '<mesh name="m" file="none.stl"/><texture name="t" type="2d" file="none.png"/><material name="x" texture="t"/>'
    )
    shape = '<geom type="mesh" mesh="m" material="x"/>'
    robot = load_robot(robot_file(tmp_path, "a.xml", mjcf(mesh=mesh, shape=shape)))
    assert robot.state.size == 2


@pytest.mark.parametrize("folder", ["elsewhere", "parts"])
def test_meshes_of_a_package_are_shown(folder: str, tmp_path: Path) -> None:
    """A folder that ``packages`` names, or one beside the model that is called like the package."""
    home = tmp_path / folder
    home.mkdir()
    corners = ["0 0 0", "1 0 0", "0 1 0", "0 0 1"]
    (home / "part.obj").write_text("".join(f"v {c}\n" for c in corners) + "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")
    packages = {"parts": folder} if folder == "elsewhere" else {}
    text = urdf(mesh=MESH.format("part").replace(".stl", ".obj"))
    robot = load_robot(robot_file(tmp_path, "a.urdf", text, packages=packages))
    assert load_spec(robot.description).compile().nmesh == 0
    shown = load_spec(robot.description, meshes=True).compile()
    assert shown.nmesh == 1 and shown.body("slide").mass[0] == 2.0


def test_what_collides_is_the_mesh_for_it_and_what_is_drawn_is_the_other(tmp_path: Path) -> None:
    """Truth: the sizes of the two boxes. They were both what is drawn."""
    for name, length in (("looks", 0.4), ("solid", 0.1)):
        trimesh.creation.box((0.1, 0.1, length)).export(tmp_path / f"{name}.stl")
    kinds = {"visual": "looks", "collision": "solid"}
    mesh = "".join(f'<{k}><geometry><mesh filename="{n}.stl"/></geometry></{k}>' for k, n in kinds.items())
    robot = load_robot(robot_file(tmp_path, "a.urdf", urdf(mesh=mesh)))
    model = load_spec(robot.description, meshes=True).compile()
    of = lambda geoms: {
        model.mesh(model.geom_dataid[g]).name for g in np.flatnonzero(geoms) if model.geom_dataid[g] >= 0
    }
    assert of(model.geom_conaffinity != 0) == {"solid"} and of(model.geom_group <= 2) == {"looks"}
    (solid,) = [s.solid for s in robot_geometry(robot).shapes if s.frame == "slide"]
    up = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]) @ solid.rotation
    assert np.ptp((solid.support(up) @ solid.rotation.T)[:, 2]) == pytest.approx(0.1)


MACROS = urdf(
    names='xmlns:xacro="http://www.ros.org/wiki/xacro"',
    macros='<xacro:arg name="top" default="0.8"/>',
    height="$(arg top)",
)


def test_macros_need_a_package_which_the_message_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xacro_file, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"a\.urdf\.xacro: .*pip install 'wbmpc\[xacro\]'"):
        load_robot(robot_file(tmp_path, "a.urdf.xacro", MACROS))


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("while True: pass", "a.xacro: its macros are not expanded within 0.5 s"),
        ("return [0] * 10**9", "a.xacro: its macros cannot be expanded: MemoryError"),
        ("import os; os._exit(3)", "a.xacro: its macros cannot be expanded: exit status 3"),
        ("raise KeyError('x')", "a.xacro: its macros cannot be expanded: KeyError: 'x'"),
    ],
)
def test_macros_that_do_not_end_well(body: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Expressions of a file are a program's: whatever it does, it ends. (The package is a stand-in that does it.)"""
    (tmp_path / "xacro.py").write_text(f"def process_file(path, mappings):\n    {body}\n")
    packages = "reset = walk_up_from = update_package_cache = staticmethod(lambda *a: None)"
    (tmp_path / "xacrodoc.py").write_text(f"class packages:\n    {packages}\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(xacro_file, "find_spec", lambda name: name)
    monkeypatch.setattr(xacro_file, "SECONDS", 0.5 if "while" in body else 60.0)
    with pytest.raises(InputError, match=re.escape(message)):
        load_robot(robot_file(tmp_path, "a.xacro", MACROS))


def test_macros_that_fail_at_a_default_name_the_arguments(tmp_path: Path) -> None:
    """A file that is called by an argument which is empty unless it is given, as descriptions of a family of robots do."""
    pytest.importorskip("xacrodoc")
    family = '<xacro:arg name="arm" default=""/><xacro:include filename="arms/$(arg arm).xacro"/>'
    text = urdf(
        names='xmlns:xacro="http://www.ros.org/wiki/xacro"', macros='<xacro:arg name="top" default="1"/>' + family
    )
    path = robot_file(tmp_path, "a.urdf.xacro", text, xacro_arguments={"top": "1.2"})
    with pytest.raises(InputError, match=r"arms/\.xacro.*; its arguments, which --argument NAME:=VALUE gives: arm$"):
        load_robot(path)


def test_macros_are_expanded(tmp_path: Path) -> None:
    pytest.importorskip("xacrodoc")
    path = robot_file(tmp_path, "a.urdf.xacro", MACROS, xacro_arguments={"top": "1.2"})
    assert load_robot(path).limits.state_upper[0] == 1.2
    plugin = "<gazebo><parameters>$(find nowhere)/a.yaml</parameters></gazebo></robot>"
    text = MACROS.replace("</robot>", plugin)
    assert (
        load_robot(robot_file(tmp_path, "d.urdf.xacro", text)).limits.state_upper[0] == 0.8
    )  # only a simulator needs it
    beside = tmp_path / "my_parts"
    beside.mkdir()
    (beside / "package.xml").write_text("<package><name>my_parts</name></package>")
    (beside / "top.xacro").write_text('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"/>')
    text = MACROS.replace("</robot>", '<xacro:include filename="$(find my_parts)/top.xacro"/></robot>')
    load_robot(robot_file(tmp_path, "e.urdf.xacro", text))
    with pytest.raises(InputError, match=r"needs? the argument 'side'; .* --argument side:=VALUE"):
        load_robot(
            robot_file(tmp_path, "f.urdf.xacro", MACROS.replace("</robot>", '<link name="$(arg side)"/></robot>'))
        )
    with pytest.raises(InputError, match=r"ROS package 'nowhere' is not found; .* --package nowhere=FOLDER"):
        load_robot(robot_file(tmp_path, "b.xacro", text.replace("my_parts", "nowhere")))


def test_a_folder_is_a_package_of_its_own_name_whatever_its_manifest_says(tmp_path: Path) -> None:
    """As example-robot-data has it: its models call the folder, which its manifest calls otherwise. One that a manifest names comes first."""
    folder = tmp_path / "robots-data" / "robots" / "one"
    folder.mkdir(parents=True)
    (tmp_path / "robots-data" / "package.xml").write_text("<package><name>robot_descriptions</name></package>")
    assert find_package("robots-data", folder, {}) == tmp_path / "robots-data"
    named = tmp_path / "elsewhere"
    (named / "robots-data").mkdir(parents=True)
    (named / "package.xml").write_text("<package><name>robots-data</name></package>")
    (named / "robots-data" / "package.xml").write_text("<package><name>other</name></package>")
    assert find_package("robots-data", named / "robots-data", {}) == named
    assert find_package("nowhere", folder, {}) is None


def test_a_joint_with_an_empty_range_cannot_be_used(tmp_path: Path) -> None:
    """MuJoCo would take it for one without limits."""
    with pytest.raises(InputError, match=r"joint 'rise': its range is empty.*fixed_joints: \{rise: 0\}"):
        load_robot(robot_file(tmp_path, "a.urdf", urdf(height="0")))
    load_robot(robot_file(tmp_path, "a.urdf", urdf(height="0"), limits={"position": {"rise": [0.0, 0.5]}}))


@pytest.mark.parametrize("encoding", ["zlib", "idna", "nowhere", "utf-7"])
def test_an_encoding_that_is_none_of_a_text_is_an_error(tmp_path: Path, encoding: str) -> None:
    text = f'<?xml version="1.0" encoding="{encoding}"?>{urdf()}'
    with pytest.raises(InputError, match=r"a\.urdf: cannot be read"):
        load_robot(robot_file(tmp_path, "a.urdf", text))


def test_macros_without_their_prefix_are_named(tmp_path: Path) -> None:
    """As the description of youBot has them: a property that nothing defines."""
    pytest.importorskip("xacrodoc")
    (tmp_path / "a.xacro").write_text(
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><property name="M_PI" value="3.14"/>'
        '<xacro:macro name="m"><link name="${M_PI}"/></xacro:macro><xacro:m/></robot>'
    )
    with pytest.raises(InputError, match=r"'M_PI' is not defined.*old files leave out the prefix.*<xacro:property"):
        xacro_file.expand(tmp_path / "a.xacro", {}, {})
