"""What a robot's file says to the simulator alone is left out or rejected. Truth: the same base from a file without it; statics."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

from own_bases import write_base
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.robots import load_description, load_spec
from wbmpc.robots.description import DATA
from wbmpc.simulation.any_perturbation import AnyPerturbation
from wbmpc.studies.minniti2019.door_plant import Door, DoorPlant

START, END, ARM, LEG = "<worldbody>", "</worldbody>", '<joint name="lift"', '<joint name="m1_leg"'
TIRE, HULL = (
    '<geom type="ellipsoid" size="0.08 0.02 0.08" contype="0" conaffinity="0"/>',
    '<geom type="cylinder" size="0.35 0.08"',
)
COMPILER = 'autolimits="true"'


def ring(folder: Path, *replace: tuple[str, str], **keys: Any) -> Path:
    """A base of four modules on hinges with pieces of its MJCF replaced, and keys of its YAML."""
    path = write_base(folder, 4, True)
    xml = (folder / "base.xml").read_text()
    for old, new in replace:
        assert old in xml
        xml = xml.replace(old, new)
    (folder / "base.xml").write_text(xml)
    data = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump({**data, **keys}))
    return path


def model_of(path: Path) -> mujoco.MjModel:
    return SwervePlant(load_robot(path).description, None, AnyPerturbation(), 1, settle=0.0).model


def numbers(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """All that MuJoCo computes with; of shapes that touch nothing, nothing."""
    parts = {"": model, "opt.": model.opt, "stat.": model.stat}
    skip, touches = ("name", "path", "text", "sig", "body_margin"), model.geom_contype > 0
    found = {
        k + n: np.asarray(getattr(o, n)) for k, o in parts.items() for n in dir(o) if not n.startswith(("_", *skip))
    }
    found = {n: v for n, v in found.items() if v.dtype.kind in "fiub"}
    return {n: v[touches] if n.startswith("geom_") else v for n, v in found.items()}


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    return numbers(model_of(ring(tmp_path_factory.mktemp("clean"))))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (START, '<option gravity="0 0 -3" wind="9 0 0" density="1.2" viscosity="0.1" noslip_iterations="5"/>' + START),
        (START, '<option><flag contact="disable" frictionloss="disable" gravity="disable"/></option>' + START),
        (START, '<size memory="1K"/><statistic meaninertia="1e9"/>' + START),
        (START, '<default><joint damping="7" armature="3" frictionloss="9" margin="0.1"/></default>' + START),
        (START, '<default><geom margin="0.05" friction="0.01" priority="5" solimp="0.1 0.2 0.1"/></default>' + START),
        (START, '<default><motor gear="50" ctrlrange="-1 1"/><velocity kv="9"/><site pos="1 0 0"/></default>' + START),
        (ARM, ARM + ' damping="5" armature="50" frictionloss="50" actuatorfrcrange="-1 1" solreflimit="0.5 1"'),
        (LEG, LEG + ' damping="500" armature="5" frictionloss="500" margin="0.2"'),
        ('<body name="hull"', '<body name="hull" gravcomp="0.9"'),
        (END, END + '<contact><exclude body1="hull" body2="shoulder"/></contact>'),
        (END, END + '<equality><joint active="false" joint1="pan" joint2="lift"/><weld body1="hull"/></equality>'),
        (END, END + '<tendon><fixed name="t"><joint joint="pan" coef="1"/></fixed></tendon>'),
        (
            START,
            START + '<geom name="floor" type="plane" size="1 1 1"/><body name="goal" mocap="true"/><light pos="0 0 3"/>'
            '<body name="box" pos="1 0 1"><freejoint/><geom size="0.2"/></body><camera name="eye" mode="targetbody" target="box"/>',
        ),
        (COMPILER, COMPILER + ' fusestatic="true"'),
    ],
)  # fmt: skip
def test_what_only_the_simulator_would_see_is_left_out(
    old: str, new: str, clean: dict[str, np.ndarray], tmp_path: Path
) -> None:
    found = numbers(model_of(ring(tmp_path, (old, new))))
    assert found.keys() == clean.keys()
    assert [n for n, v in clean.items() if not np.array_equal(found[n], v, equal_nan=True)] == []


def test_what_looks_at_the_scene_goes_with_it(tmp_path: Path) -> None:
    eye = '<camera name="eye" mode="targetbody" target="box"/>'
    start = START + '<body name="box" pos="2 0 1"><geom size="0.2"/></body>'
    spec = load_spec(load_robot(ring(tmp_path, (START, start), (HULL, eye + HULL))).description)
    assert not spec.cameras and spec.body("box") is None


def test_a_robot_stands_on_the_tires_of_the_plant(tmp_path: Path) -> None:
    """Wheels as exporters write them, and a hull that reaches the floor: their shapes carry nothing."""
    path = ring(tmp_path, (TIRE, '<geom type="cylinder" size="0.08 0.02" euler="1.5708 0 0"/>'),
                (f'{HULL} contype="0" conaffinity="0"/>', '<geom type="cylinder" size="0.35 0.40"/>'))  # fmt: skip
    robot = load_robot(path)
    plant = SwervePlant(robot.description, None, AnyPerturbation.none(), 0, settle=0.3)
    assert plant.truth().wheel_force.sum() == pytest.approx(plant.weight, rel=0.02)
    assert plant.data.qpos[2] == pytest.approx(robot.base.body_height, abs=1e-3)


def test_a_urdf_has_its_limits_in_the_yaml_and_its_friction_in_the_plant(tmp_path: Path) -> None:
    model = load_spec(load_description(urdf(tmp_path, "", ["one", "two"]))).compile()
    assert not model.dof_damping.any() and not model.dof_frictionloss.any() and not model.jnt_actfrclimited.any()


def test_masses_from_shapes_are_the_planners_and_vary_in_the_simulator(tmp_path: Path) -> None:
    """The compiler would recompute them from the shapes, whatever the simulator drew."""
    path = ring(tmp_path, (COMPILER, COMPILER + ' inertiafromgeom="true" boundmass="0.5"'))
    hull = np.pi * 0.35**2 * 0.16 * 1000.0
    robot = load_robot(path)
    assert robot.tree.links[0].mass == pytest.approx(hull)
    plant = SwervePlant(robot.description, None, AnyPerturbation(mass=0.3), 1, settle=0.0)
    drawn = plant.draw.mass["hull"]
    assert abs(drawn - 1.0) > 0.01 and plant.model.body("hull").mass[0] == pytest.approx(drawn * hull)


def test_the_arm_may_go_where_the_yaml_says(tmp_path: Path) -> None:
    """The planner does: beyond the file's 3 rad, not beyond the 1 rad that is narrower than the file's 2."""
    limits = {"position": {"pan": [-5.0, 2.0], "lift": [-1.0, 1.0]}}
    degrees = {"-3 3": f"{np.rad2deg(-3)} {np.rad2deg(3)}", "-2 2": f"{np.rad2deg(-2)} {np.rad2deg(2)}"}
    for unit, replace in (("radian", []), ("degree", list(degrees.items()))):
        xml = f"""<mujoco><compiler angle="{unit}"/><worldbody><body name="base"><geom size="0.1"/><body name="a">
          <joint name="pan" range="-3 3" axis="0 0 1"/><geom size="0.1"/><body name="b"><joint name="lift" range="-2 2"/>
          <geom size="0.1"/></body></body></body></worldbody></mujoco>"""
        for old, new in replace:
            xml = xml.replace(old, new)
        (tmp_path / "r.xml").write_text(xml)
        description = {"name": "r", "model": "r.xml", "base": {"type": "fixed", "body": "base"}, "limits": limits}
        (tmp_path / "r.yaml").write_text(
            yaml.safe_dump({**description, "arm": {"joints": ["pan", "lift"], "tool": "b"}})
        )
        model = load_spec(load_description(tmp_path / "r.yaml")).compile()
        np.testing.assert_allclose(model.jnt_range, [[-5.0, 3.0], [-2.0, 2.0]])


def test_a_door_opens_as_wide_before_a_robot_drawn_in_degrees(tmp_path: Path) -> None:
    xml = (DATA / "rezero.xml").read_text().replace('angle="radian"', 'angle="degree"')
    (tmp_path / "r.xml").write_text(re.sub('range="-[0-9.]+ [0-9.]+"', 'range="-120 120"', xml))
    data = yaml.safe_load((DATA / "rezero.yaml").read_text())
    (tmp_path / "r.yaml").write_text(yaml.safe_dump({**data, "model": "r.xml"}))
    plant = DoorPlant(load_robot(tmp_path / "r.yaml").description, Door((1.0, 0.4)))
    np.testing.assert_allclose(plant.model.joint("door").range, [0.0, 2.2])


# ---------------------------------------------------------------------- rejected
def rejection(path: Path) -> str:
    with pytest.raises(InputError) as error:
        load_robot(path)
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (LEG, LEG + ' stiffness="200" springref="0.8"', ("joint 'm1_leg' has a spring",)),
        (ARM, ARM + ' springdamper="0.1 1"', ("joint 'lift' has a spring",)),
        (START, '<default><joint stiffness="7"/></default>' + START, ("has a spring",)),
        (END, END + '<tendon><fixed name="cord" stiffness="5"><joint joint="pan" coef="1"/></fixed></tendon>',
         ("tendon 'cord' acts on joint 'pan'",)),
        (END, END + '<tendon><fixed name="cord" range="-1 1"><joint joint="lift" coef="1"/></fixed></tendon>',
         ("tendon 'cord' acts on joint 'lift'",)),
        (END, '<site name="nail"/>' + END + '<tendon><spatial name="cord" stiffness="5"><site site="nail"/><site site="hand"/>'
         "</spatial></tendon>", ("tendon 'cord'", "'pan', 'lift'")),
        (END, END + '<equality><joint joint1="m0_leg" joint2="m1_leg"/></equality>', ("'joint'", "'m0_leg', 'm1_leg'")),
        (END, END + '<equality><connect body1="m0_arm" body2="m1_arm" anchor="0 0 0"/></equality>',
         ("'connect'", "'m0_leg', 'm1_leg'")),
        (END, END + '<equality><weld body1="upper"/></equality>', ("'weld'", "'pan', 'lift'")),
    ],
)  # fmt: skip
def test_springs_and_couplings_of_joints_that_are_used(
    old: str, new: str, words: tuple[str, ...], tmp_path: Path
) -> None:
    text = rejection(ring(tmp_path, (old, new)))
    assert all(w in text for w in ("base.xml", *words)), text


@pytest.mark.parametrize(
    ("more", "word"), [('stiffness="5"', "joint 'ball' has a spring"), ('range="0 1"', "would stop")]
)
def test_a_ball_that_does_not_turn_freely(more: str, word: str, tmp_path: Path) -> None:
    joint = '<joint name="ball" type="ball"'
    (tmp_path / "r.xml").write_text((DATA / "rezero.xml").read_text().replace(joint, f"{joint} {more}"))
    data = yaml.safe_load((DATA / "rezero.yaml").read_text())
    (tmp_path / "r.yaml").write_text(yaml.safe_dump({**data, "model": "r.xml"}))
    text = rejection(tmp_path / "r.yaml")
    assert word in text and "r.xml" in text, text


def urdf(folder: Path, coupling: str, used: list[str], **keys: Any) -> Path:
    """Two joints on a fixed base; the second has ``coupling``."""
    mass = '<inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
    more = (
        '<axis xyz="0 1 0"/><dynamics damping="3" friction="2"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
    )
    (folder / "r.urdf").write_text(f"""<robot name="r"><link name="base">{mass}</link><link name="a">{mass}</link>
      <link name="b">{mass}</link><joint name="one" type="revolute"><parent link="base"/><child link="a"/>{more}</joint>
      <joint name="two" type="revolute"><parent link="a"/><child link="b"/>{more}{coupling}</joint></robot>""")
    data = {
        "name": "r",
        "model": "r.urdf",
        "base": {"type": "fixed", "body": "base"},
        "arm": {"joints": used, "tool": "b"},
    }
    path = folder / "r.yaml"
    path.write_text(yaml.safe_dump({**data, **keys}))
    return path


def test_a_joint_of_a_urdf_that_mimics_another(tmp_path: Path) -> None:
    """One that is used cannot follow one that is held either: MuJoCo would hold it."""
    mimic = '<mimic joint="one"/>'
    text = rejection(urdf(tmp_path, mimic, ["one", "two"]))
    assert all(w in text for w in ("r.urdf", "'mimic'", "'one'", "'two'")), text
    assert "acts on joint 'one', of" in rejection(urdf(tmp_path, mimic, ["one"], fixed_joints={"two": 0.2}))


def test_a_gripper_with_springs_and_loops_that_is_held(tmp_path: Path) -> None:
    """As four-bar grippers come: none of it moves when all its joints are held."""
    body = '<body name="{0}"><joint name="{0}" stiffness="{1}"/><geom size="0.1"/><site name="{0}"/>{2}</body>'
    inner = body.format("f", 5, "") + body.format("g", 5, "")
    (
        tmp_path / "r.xml"
    ).write_text(f"""<mujoco><worldbody><body name="base"><geom size="0.1"/>{body.format("a", 0, inner)}
      </body></worldbody><tendon><fixed name="t" stiffness="9"><joint joint="f" coef="1"/><joint joint="g" coef="1"/></fixed>
      <spatial name="s" stiffness="9"><site site="f"/><site site="g"/></spatial></tendon>
      <equality><connect body1="f" body2="g" anchor="0 0 0"/><joint joint1="f" joint2="g"/><tendon tendon1="t"/>
      <connect site1="f" site2="g"/></equality></mujoco>""")
    data = {
        "name": "r",
        "model": "r.xml",
        "base": {"type": "fixed", "body": "base"},
        "arm": {"joints": ["a"], "tool": "g"},
    }
    (tmp_path / "r.yaml").write_text(yaml.safe_dump({**data, "fixed_joints": {"f": 0.1, "g": 0.2}}))
    model = load_spec(load_description(tmp_path / "r.yaml")).compile()
    assert (model.nv, model.neq, model.ntendon) == (1, 0, 0)
