"""Robots that nobody has described: what `wbmpc doctor` finds in their models and `wbmpc new` makes of them. Truth: the numbers of
the files written here."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import numpy as np
import pytest
from urdf_parts import (
    ARM,
    CASTER,
    DIFFERENTIAL,
    INERTIAL,
    MECANUM,
    OMNI,
    RADIUS,
    SWERVE,
    found,
    joint,
    link,
    model,
    new,
    steered,
    wheel,
)

from wbmpc.cli import main
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.robots import load_description
from wbmpc.robots.doctor import examine_robot
from wbmpc.robots.mechanism import read_mechanism
from wbmpc.robots.model_file import read_model
from wbmpc.robots.wheel_search import find_wheels


@pytest.mark.parametrize(
    ("wheels", "base", "count"),
    [
        (DIFFERENTIAL + CASTER, "differential", 2),
        (MECANUM, "omnidirectional", 4),
        (OMNI, "omnidirectional", 3),
        (SWERVE, "swerve", 3),
        ("", "fixed", 0),
    ],
)
def test_a_model_becomes_a_robot(wheels: str, base: str, count: int, tmp_path: Path) -> None:
    """Base type, wheels, arm, tool, held joints and a home that loads and keeps away from the ends of ranges."""
    path = new(model(tmp_path, wheels + ARM))
    robot = load_robot(path)
    d = robot.description
    assert (d.base.type, d.arm.joints, d.arm.tool) == (base, ("pan", "lift", "elbow"), "grasp_frame")
    assert len([n for n in d.base.joints() if n.endswith("_joint")]) == count
    assert {"finger_1_joint", "finger_2_joint", "head_pan"} <= d.fixed_joints.keys()
    assert ("caster_roll" in d.fixed_joints) == (CASTER in wheels)
    arm = robot.home[robot.state["arm"]]
    lower, upper = robot.limits.state_lower[robot.state["arm"]], robot.limits.state_upper[robot.state["arm"]]
    assert np.all(arm > lower + 0.1 * (upper - lower)) and np.all(arm < upper - 0.1 * (upper - lower))
    np.testing.assert_allclose(robot.limits.input_upper[robot.input["arm"]], [1.5, 1.5, 2.5])
    if wheels:
        geometry = robot.base.geometry
        assert getattr(geometry, "wheel_radius", getattr(geometry, "radius", 0.0)) == pytest.approx(RADIUS)
        assert abs(robot.pose(robot.home)[0][2] - 0.8) < 0.35  # the working height, among 2 000 postures
    result = examine_robot(str(path))
    faults = [f for f in result.findings if f.severity != "info" and f.check != "steadiness"]  # the hull weighs 1 kg
    assert not faults, faults


@pytest.mark.parametrize("name", ["pentapod-ur10", "telescope-ur10"])
def test_legs_that_turn_or_slide_are_found(name: str, tmp_path: Path) -> None:
    """Truth: the built-in robot file of the same model."""
    known = load_description(name)
    path = tmp_path / "own.yaml"
    assert main(["new", str(known.model), "--yes", "--out", str(path)]) == 0
    assert load_description(path).base.modules == known.base.modules


@pytest.mark.parametrize("powered", [False, True])
def test_rear_wheels_without_limits_are_no_casters(powered: bool, tmp_path: Path) -> None:
    """A URDF demands limits of a steering axis: they do not make casters of the tires on a fixed axle behind it."""
    free = '<limit velocity="10.0" effort="5"/>'
    fork = link("fork") + joint(
        "steer", "hull", "fork", (0.4, 0, 0.1), "0 0 1", 'lower="-1" upper="1" velocity="3" effort="5"'
    )
    front = wheel("front", (0, 0, 0), "fork")
    rear = "".join(wheel(n, (-0.3, y, 0.1)) for n, y in (("left", 0.3), ("right", -0.3))).replace(free, "")
    path = model(tmp_path, fork + (front if powered else front.replace(free, "")) + rear + ARM)
    found = {w.joint: w for w in find_wheels(read_mechanism(read_model(path)))}
    assert [found[f"{n}_joint"].passive for n in ("front", "left", "right")] == [False] * 3
    assert [found[f"{n}_joint"].driven for n in ("front", "left", "right")] == [True, not powered, not powered]
    base = load_robot(new(path)).description.base
    assert base.type == "wheels"
    assert base.wheel_joints() == (["front_joint"] if powered else ["front_joint", "left_joint", "right_joint"])


def test_a_home_is_better_than_most_postures(tmp_path: Path) -> None:
    """Manipulability by finite differences of the model's own pose, against random postures."""
    robot = load_robot(new(model(tmp_path, ARM)))

    def least(q: np.ndarray) -> float:
        steps = [(robot.pose(q + 1e-6 * e)[0] - robot.pose(q)[0]) / 1e-6 for e in np.eye(3)]
        return float(np.linalg.svd(np.array(steps).T * [1.5, 1.5, 2.0], compute_uv=False)[-1])

    postures = np.random.default_rng(1).uniform(robot.limits.state_lower, robot.limits.state_upper, (60, 3))
    assert least(robot.home) > np.quantile([least(q) for q in postures], 0.6)


def test_bodies_that_can_touch_are_listed(tmp_path: Path) -> None:
    """A long forearm reaches the hull, and the upper arm beside it does not; a model without shapes has no pairs."""
    box = lambda size, at: f'<collision><origin xyz="{at}"/><geometry><box size="{size}"/></geometry></collision>'
    shapes = {"hull": box("0.5 0.5 0.2", "0 0 0.1"), "fore": box("0.3 0.04 0.04", "0.15 0 0")}
    path = model(tmp_path, DIFFERENTIAL + ARM)
    assert load_robot(new(path)).description.collision.self.pairs is None
    text = path.read_text()
    for name, shape in shapes.items():
        text = text.replace(link(name), link(name, shape))
    path.write_text(text)
    out = new(path)
    assert load_robot(out).description.collision.self.pairs == (("hull", "fore"),)
    assert "# bodies that come near each other" in out.read_text()
    given = new(path, "--set", "collision.self.pairs=[[fore, hull]]")
    assert load_robot(given).description.collision.self.pairs == (("fore", "hull"),)
    given.write_text(given.read_text().replace("[fore, hull]", "[fore, fore]"))
    with pytest.raises(InputError, match=r"collision.self.pairs.*two bodies that differ, got 'fore' twice"):
        load_robot(given)


def test_options_instead_of_answers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = model(tmp_path, MECANUM + ARM)
    assert main(["new", str(path), "--yes", "--base", "differential", "--out", str(tmp_path / "a.yaml")]) == 2
    said = capsys.readouterr().err
    assert "unknown base type for this model 'differential'; valid: omnidirectional, planar, fixed" in said
    assert said.count("(driven)") == 4
    assert main(["new", str(path), "--tool", "head", "--out", str(tmp_path / "a.yaml"), "--yes"]) == 2
    assert "valid: grasp_frame, palm, fore" in capsys.readouterr().err
    out = new(
        path,
        "--tool",
        "palm",
        "--set",
        "base.rollers=[45, -45, -45, 45]",
        "--set",
        "limits.base_linear=0.5",
        "--height",
        "0.6",
    )
    d = load_robot(out).description
    assert d.arm.tool == "palm" and d.base.rollers == (45.0, -45.0, -45.0, 45.0) and d.limits.base_linear == 0.5  # type: ignore[attr-defined]
    before = out.read_text()
    assert main(["new", str(path), "--yes", "--out", str(out)]) == 2  # a file that is there stays
    assert main(["new", str(path), "--yes", "--out", str(out), "--force", "--set", "limits.base_lineal=1"]) == 2
    assert "did you mean 'limits.base_linear'" in capsys.readouterr().err
    assert out.read_text() == before
    assert "wheel_radius" not in before  # the shapes show it


#: Another ARM, named to the right of the first.
TWIN = (
    "".join(ARM.split(link("palm"))[:1])
    .replace('name="', 'name="right_')
    .replace('link="', 'link="right_')
    .replace("right_hull", "hull")
    .replace("0.1 0 0.3", "0.1 -0.4 0.3")
)


def test_two_arms(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What the robot has beside the chosen arm is said with the option that takes it, and both can be taken: each with its tool and its
    own joints, homes within their ranges."""
    path = model(tmp_path, DIFFERENTIAL + ARM + TWIN)
    one = load_robot(new(path)).description
    shown = capsys.readouterr().out
    assert not one.arms and "other arms: right; to use them: --arm pan,right" in shown
    out = new(path, "--arm", "pan,right")
    assert "other arms" not in capsys.readouterr().out
    robot = load_robot(out)
    arms = robot.description.arms
    assert {n: (len(a.joints), a.tool) for n, a in arms.items()} == {
        "pan": (3, "grasp_frame"),
        "right": (3, "right_fore"),
    }
    assert {"right_pan", "right_lift", "right_elbow"} <= robot.description.home.keys()
    assert np.all(robot.home >= robot.limits.state_lower) and np.all(robot.home <= robot.limits.state_upper)
    assert main(["new", str(path), "--yes", "--arm", "pan,pan", "--out", str(tmp_path / "b.yaml")]) == 2


def test_a_hand_of_three_fingers_is_no_part_of_the_arm(tmp_path: Path) -> None:
    """Their joints have no names that say so."""
    fingers = "".join(
        link(f"f{k}")
        + joint(f"f{k}_j", "palm", f"f{k}", (0.02, 0.02 * k, 0), "0 1 0", 'lower="0" upper="1" velocity="1"')
        for k in range(3)
    )
    joints = load_robot(new(model(tmp_path, DIFFERENTIAL + ARM + fingers))).description.arm.joints
    assert joints == ("pan", "lift", "elbow")


def test_a_wrist_belongs_to_the_arm_whatever_it_moves_is_called(tmp_path: Path) -> None:
    """What it moves is the hand, and the frame on that the tool; a joint of another name that moves a hand is a gripper's."""
    for name, joints, tool in (
        ("wrist", ("pan", "lift", "elbow", "wrist"), "tcp"),
        ("turn", ("pan", "lift", "elbow"), "grasp_frame"),
    ):
        limit = 'lower="-2" upper="2" velocity="1.5"'
        hand = link("hand") + joint(name, "fore", "hand", (0.3, 0, 0), "1 0 0", limit) + link("tcp")
        hand += joint("tcp_fixed", "hand", "tcp", (0.1, 0, 0))
        arm = load_robot(new(model(tmp_path, DIFFERENTIAL + ARM + hand))).description.arm
        assert (arm.joints, arm.tool) == (joints, tool)


def test_a_sensor_between_wrist_and_hand_does_not_end_the_arm(tmp_path: Path) -> None:
    """Its joint has an empty range, so the hand behind it is fixed to the wrist; a bumper on such a joint is no wheel."""
    limit, empty = 'lower="-2" upper="2" velocity="1.5"', 'lower="0" upper="0" velocity="1.5"'
    hand = link("sensor_mount") + joint("wrist", "fore", "sensor_mount", (0.3, 0, 0), "1 0 0", limit)
    hand += link("sensor_frame") + joint("sensor_joint", "sensor_mount", "sensor_frame", (0.05, 0, 0), "0 0 1", empty)
    hand += link("tcp") + joint("tcp_fixed", "sensor_frame", "tcp", (0.1, 0, 0))
    hand += link("bumper") + joint("bumper_joint", "hull", "bumper", (0.3, 0, RADIUS), "0 1 0", empty)
    arm_alone = "".join(ARM.split(link("palm"))[:1])
    path = model(tmp_path, DIFFERENTIAL + arm_alone + hand)
    assert {w.joint for w in find_wheels(read_mechanism(read_model(path)))} == {"left_joint", "right_joint"}
    d = load_robot(new(path)).description
    assert (d.arm.joints, d.arm.tool) == (("pan", "lift", "elbow", "wrist"), "tcp")
    assert d.fixed_joints == {"sensor_joint": 0.0, "bumper_joint": 0.0}
    assert "range" not in {f.check for f in examine_robot(str(path.with_suffix(".yaml"))).findings}


def test_joints_that_move_the_whole_robot_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Files for planners that know no bases have them."""
    path = model(tmp_path, DIFFERENTIAL + ARM)
    moving = link("sliding") + joint(
        "virtual_x", "base_footprint", "sliding", (0, 0, 0), "1 0 0", 'lower="-9" upper="9"', "prismatic"
    )
    path.write_text(
        path.read_text().replace(
            joint("stand", "base_footprint", "hull", (0, 0, 0)),
            moving + joint("virtual_yaw", "sliding", "hull", (0, 0, 0), "0 0 1"),
        )
    )
    assert main(["new", str(path), "--yes", "--out", str(tmp_path / "a.yaml")]) == 2
    said = capsys.readouterr().err
    assert "'virtual_x', 'virtual_yaw' move wheels and arm, as the base type does: make them fixed in the file" in said


def test_a_robot_file_is_no_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = new(model(tmp_path, DIFFERENTIAL + ARM))
    assert main(["new", str(path), "--yes"]) == 2
    assert f"wbmpc doctor {path}" in capsys.readouterr().err


def test_wheels_that_do_not_turn_in_the_file_carry_a_base_that_takes_speeds(tmp_path: Path) -> None:
    wheels = "".join(
        link(f"wheel_{k}") + joint(f"axle_{k}", "hull", f"wheel_{k}", (0, 0.2 - 0.4 * k, 0.1)) for k in range(2)
    )
    base = load_robot(new(model(tmp_path, wheels + ARM), "--set", "base.drive=omni")).description.base
    assert (base.type, base.drive) == ("planar", "omni")


@pytest.mark.parametrize(("ahead", "drive"), [(-0.1, "omni"), (0.0, "skid")])
def test_two_wheels_under_one_steering_axis_move_a_base_any_way_if_it_is_beside_their_axle(
    ahead: float, drive: str, tmp_path: Path
) -> None:
    """The axis is at the base of the wheels' lever: with none of it they only turn where they stand."""
    fork = link("fork") + joint("steer", "hull", "fork", (0, 0, RADIUS), "0 0 1", kind="continuous")
    wheels = "".join(wheel(f"w{k}", (ahead, 0.2 - 0.4 * k, 0), "fork") for k in range(2))
    base = load_robot(new(model(tmp_path, fork + wheels + ARM))).description.base
    assert (base.type, base.drive) == ("planar", drive)


def test_steering_axes_of_mecanum_wheels_can_be_held(tmp_path: Path) -> None:
    """Files for simulators have them in place of rollers."""
    places = [(0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2)]
    wheels = "".join(steered(f"w{k}", (*at, RADIUS)) for k, at in enumerate(places))
    path = model(tmp_path, wheels + ARM)
    assert load_robot(new(path)).description.base.type == "swerve"
    d = load_robot(new(path, "--base", "omnidirectional")).description
    assert d.base.rollers == "mecanum" and {f"w{k}_steer" for k in range(4)} <= d.fixed_joints.keys()
    # a caster's wheel trails its axis: one right under it is none
    path.write_text(path.read_text().replace("_steer", "_caster_joint"))
    assert load_robot(new(path)).description.base.type == "omnidirectional"
    path.write_text(path.read_text().replace(wheel("w0", (0, 0, 0), "w0_fork"), wheel("w0", (-0.04, 0, 0), "w0_fork")))
    assert load_robot(new(path)).description.base.type != "omnidirectional"


def test_a_heavy_torso_is_as_slow_as_the_robot_stands(tmp_path: Path) -> None:
    """30 kg at 1 m about a hinge; 33 kg in all on wheels 0.25 m from their middle: 15 % of the moment that tips it over."""
    heavy = (
        '<link name="chest"><inertial><origin xyz="0 0 1"/><mass value="30"/>'
        + INERTIAL.split('value="1"/>')[1]
        + "</link>"
    )
    torso = heavy + joint(
        "bow", "hull", "chest", (0, 0, 0.3), "0 1 0", 'lower="-0.5" upper="0.5" velocity="2" effort="400"'
    )
    path = new(model(tmp_path, DIFFERENTIAL + torso))
    limits = load_robot(path).description.limits.acceleration
    assert limits["bow"] == pytest.approx(0.15 * 33.0 * 9.81 * 0.25 / 30.01, abs=1e-3)
    light = load_robot(new(model(tmp_path, DIFFERENTIAL + ARM, "light.urdf"))).description.limits.acceleration
    assert light["pan"] == pytest.approx(3.0 * 1.5)  # turns about the vertical: it tips nobody over


def test_a_base_speeds_up_as_far_as_its_mass_is_from_the_edge(tmp_path: Path) -> None:
    """30 kg 0.12 m behind the middle of two wheels, which have casters 0.25 m ahead and behind; hull, wheels and mass at 0, 0.1 and 0.5 m."""
    load = (
        '<link name="load"><inertial><origin xyz="-0.12 0 0.5"/><mass value="30"/>' + INERTIAL.split('value="1"/>')[1]
    )
    load += "</link>" + joint("bolt", "hull", "load", (0, 0, 0))
    limits = load_robot(new(model(tmp_path, DIFFERENTIAL + load + mast(0.0, 0.0)))).description.limits.acceleration
    height, behind = (2.0 * RADIUS + 30.0 * 0.5) / 33.0, 30.0 * 0.12 / 33.0
    assert limits["left_joint"] * RADIUS == pytest.approx(0.4 * 9.81 * (0.25 - behind) / height, rel=0.01)


def mast(mass: float, beside: float) -> str:
    """A link on a vertical axis at 2 m, whose mass [kg] is so far [m] from it."""
    inertial = INERTIAL.replace('<mass value="1"/>', f'<origin xyz="{beside} 0 0"/><mass value="{mass}"/>')
    limit = 'lower="-3.1416" upper="3.1416" velocity="1"'
    return f'<link name="mast">{inertial}</link>' + joint("turn", "hull", "mast", (0, 0, 2), "0 0 1", limit)


def test_three_wheels_stand_as_far_as_the_edge_of_their_triangle(tmp_path: Path) -> None:
    """Corners 0.3 m from the middle: edges at 0.15 m. Hull, three wheels and mast of 1 kg each at 0, 0.1 and 2 m."""
    angles = (0.0, 2.0 * np.pi / 3.0, -2.0 * np.pi / 3.0)
    wheels = "".join(
        wheel(f"w{k}", (0.3 * np.cos(a), 0.3 * np.sin(a), RADIUS), turn=f"0 0 {a + np.pi / 2:.9g}")
        for k, a in enumerate(angles)
    )
    limits = load_robot(new(model(tmp_path, wheels + mast(1.0, 0.0)))).description.limits.acceleration
    height = (0.0 + 3.0 * RADIUS + 2.0) / 5.0
    assert limits["w0_joint"] * RADIUS == pytest.approx(0.4 * 9.81 * 0.15 / height, rel=0.01)


@pytest.mark.parametrize(("mass", "share"), [(5.0, 1.0 - 2.0 / np.pi * np.arcsin(0.8)), (1.0, 0.0)])
def test_an_arm_that_tips_the_robot_over_at_rest(mass: float, share: float, tmp_path: Path) -> None:
    """5 kg at 0.5 m beside 5 kg on wheels at (0.3, 0.2) m: 0.25 m from the middle, past an edge where the sine is beyond 0.8."""
    said = found(new(model(tmp_path, MECANUM + mast(mass, 0.5))), "steadiness")
    seen = float(said.split("in ")[1].split(" %")[0]) / 100.0 if said else 0.0
    assert seen == pytest.approx(share, abs=0.1) and bool(said) == (share > 0.0)


def test_what_is_assumed_is_marked_and_the_given_radius_counts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Wheels of meshes: their radius is the height of their centers, until it is given; then speeds and the floor follow it."""
    shape = '<geometry><cylinder radius="0.1" length="0.04"/></geometry>'
    mesh = '<geometry><mesh filename="w.stl"/></geometry>'
    bare = MECANUM.replace(shape, mesh).replace('<limit velocity="10.0" effort="5"/>', "")
    path = model(tmp_path, bare + ARM)
    assert (
        "assumed: wheel_radius: 0.1" in new(path).read_text() and "--set base.wheel_radius" in capsys.readouterr().out
    )
    out = new(path, "--set", "base.wheel_radius=0.05")
    assert "assumed: wheel_radius" not in out.read_text() and "--set base.wheel_radius" not in capsys.readouterr().out
    d = load_robot(out).description
    assert d.limits.velocity["mecanum_0_joint"] == pytest.approx(1.5 / 0.05)
    height = float(out.read_text().split("m above the floor")[0].split(", ")[-1])
    tool, _ = load_robot(out).pose(load_robot(out).home)
    assert height == pytest.approx(tool[2], abs=0.006)


def test_a_file_that_does_not_load_is_named_as_it_was_ordered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "mine.yaml"
    assert main(["new", str(model(tmp_path, ARM)), "--yes", "--out", str(out), "--set", "home.nobody=1"]) == 2
    assert f"{out}: " in (shown := capsys.readouterr().err) and ".part" not in shown


class Terminal(io.StringIO):
    """Somebody who answers."""

    def isatty(self) -> bool:
        return True


def test_questions_on_a_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wheels of meshes: base type, radius, rollers, tool and height are asked, each with its proposal; an empty answer takes it."""
    shape = '<geometry><cylinder radius="0.1" length="0.04"/></geometry>'
    path = model(tmp_path, MECANUM.replace(shape, '<geometry><mesh filename="w.stl"/></geometry>') + ARM)
    monkeypatch.setattr(sys, "stdin", Terminal("\n[-45, 45, 45, -45]\n0.098\npalm\n\n"))
    out = tmp_path / "asked.yaml"
    assert main(["new", str(path), "--out", str(out)]) == 0
    shown = capsys.readouterr().out
    for question in (
        "base type [omnidirectional]",
        "radius of the wheels [m] [0.1]",
        "rollers",
        "frame of the end effector",
        "height of",
    ):
        assert shown.count(question) == 1, shown
    d = load_robot(out).description
    assert d.base.model_dump()["wheel_radius"] == 0.098 and d.base.model_dump()["rollers"] == (-45.0, 45.0, 45.0, -45.0)
    assert d.arm.tool == "palm"


def test_a_wrong_answer_is_asked_for_again_with_its_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of every question; what was answered before stays."""
    shape = '<geometry><cylinder radius="0.1" length="0.04"/></geometry>'
    path = model(tmp_path, MECANUM.replace(shape, '<geometry><mesh filename="w.stl"/></geometry>') + ARM)
    answers = ("tank", "", "{", "[-45, 45, 45, -45]", "-1", "wide", "0.098", "thumb", "palm", "nan", "high", "0.7")
    monkeypatch.setattr(sys, "stdin", Terminal("\n".join(answers) + "\n"))
    out = tmp_path / "asked.yaml"
    assert main(["new", str(path), "--out", str(out)]) == 0
    captured = capsys.readouterr()
    shown = captured.out + captured.err
    for words in ("'tank'; valid: ", "'thumb'", "greater than or equal to", "got 'nan'", "got 'high'"):
        assert words in shown, shown
    d = load_robot(out).description
    assert d.base.model_dump()["wheel_radius"] == 0.098 and d.arm.tool == "palm"


def test_answers_that_end_write_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", Terminal("tank\n"))
    path = model(tmp_path, MECANUM + ARM)
    assert main(["new", str(path), "--out", str(tmp_path / "asked.yaml")]) != 0
    assert not (tmp_path / "asked.yaml").exists()


def test_an_mjcf_and_its_actuators(tmp_path: Path) -> None:
    """Two driven wheels, and a third that nothing drives: a caster by that alone."""
    hinge = '<body name="{n}" pos="{x} {y} 0.1"><joint name="{n}" axis="0 1 0"/><geom type="cylinder" size="0.1 0.02" euler="90 0 0"/></body>'
    wheels = "".join(hinge.format(n=n, x=x, y=y) for n, x, y in (("a", 0, 0.2), ("b", 0, -0.2), ("c", -0.3, 0)))
    path = tmp_path / "cart.xml"
    path.write_text(f"""<mujoco><worldbody><geom type="plane" size="5 5 1"/>
      <body name="cart"><freejoint/><geom type="box" size="0.2 0.2 0.05" pos="0 0 0.2"/>{wheels}
      <body name="up" pos="0 0 0.3"><joint name="yaw" axis="0 0 1" range="-170 170"/><geom type="capsule" size="0.03" fromto="0 0 0 0.3 0 0"/>
       <body name="out" pos="0.3 0 0"><joint name="bend" axis="0 1 0" range="-100 100"/><geom type="capsule" size="0.03" fromto="0 0 0 0.3 0 0"/>
        <site name="tcp" pos="0.35 0 0"/></body></body></body></worldbody>
      <actuator><velocity joint="a" kv="5" ctrlrange="-8 8"/><velocity joint="b" kv="5" ctrlrange="-8 8"/></actuator></mujoco>""")
    assert [w for w, d in read_mechanism(read_model(path)).drives.items() if d.driven] == ["a", "b"]
    robot = load_robot(new(path))
    d = robot.description
    assert (d.base.joints(), d.fixed_joints, d.arm.tool) == (["a", "b"], {"c": 0.0}, "tcp")
    assert d.limits.velocity == {"a": 8.0, "b": 8.0, "yaw": 2.0, "bend": 2.0}


@pytest.mark.parametrize(
    ("range_", "motor", "effort", "none"),
    [
        ('actuatorfrcrange="-5 5"', "", 5.0, False),
        ('actuatorfrcrange="0 5"', "", None, True),
        ("", 'forcerange="-7 -2"', None, True),
        ("", 'forcerange="-7 3"', 3.0, False),
        ("", 'ctrlrange="0 5"', None, True),
        ("", 'ctrlrange="-5 -1"', None, True),
        ("", 'ctrlrange="0 5" forcerange="-7 3"', 3.0, False),
        ("", 'ctrlrange="-5 4"', 4.0, False),
        ("", "", None, False),
    ],
)
def test_forces_to_one_side_are_no_effort(
    range_: str, motor: str, effort: float | None, none: bool, tmp_path: Path
) -> None:
    """In an MJCF. Truth: the largest force of the range that a drive has both ways."""
    (tmp_path / "a.xml").write_text(
        f'<mujoco><worldbody><body name="b"><joint name="j" {range_}/><geom size="0.1"/></body></worldbody>'
        f'<actuator><motor joint="j" {motor}/></actuator></mujoco>'
    )
    drive = read_mechanism(read_model(tmp_path / "a.xml")).joints["j"].drive
    assert (drive.effort, drive.no_effort) == (effort, none)
