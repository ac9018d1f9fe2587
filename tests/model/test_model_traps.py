"""`wbmpc robot` says what is wrong with a model or a robot file, and how to fix it. Truth: files with one known fault."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from urdf_parts import (
    ARM,
    CASTER,
    DIFFERENTIAL,
    INERTIAL,
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
from wbmpc.robots.doctor import examine_robot

BAD = INERTIAL.replace('iyy="0.01"', 'iyy="-1"')
#: In kg mm², as an export in millimeters has it: a kilogram has a radius of gyration of √1e4 m.
MILLIMETERS = INERTIAL.replace('"0.01"', '"1e4"')
WEAK = joint("weak", "hull", "tray", (0, 0, 0.5), "0 1 0", 'lower="-1" upper="1"')
SLIDES = link("boom_1") + joint(
    "extend_1", "hull", "boom_1", (0, 0, 1), "1 0 0", 'lower="0" upper="0.3" velocity="1"', "prismatic"
)
SLIDES += link("boom_2") + joint(
    "extend_2", "boom_1", "boom_2", (0, 0, 0), "1 0 0", 'lower="0" upper="0.3" velocity="1"', "prismatic"
)


LIGHT = ARM
for _name in ("fore", "palm", "grasp_frame"):
    LIGHT = LIGHT.replace(link(_name), f'<link name="{_name}"/>')
SKIN = link("head", '<visual><geometry><mesh filename="package://skin/a.stl"/></geometry></visual>')
DRAWN = link("head", '<visual><geometry><mesh filename="a.dae"/></geometry></visual>')
BESIDE = steered("front", (0.3, 0, RADIUS), beside=0.04) + steered("back", (-0.3, 0, RADIUS))
LEVEL = DIFFERENTIAL + wheel("caster", (-0.3, 0, RADIUS)).replace('<limit velocity="10.0" effort="5"/>', "")
UNEVEN = wheel("left", (0, 0.25, 0.14), radius=0.14) + wheel("right", (0, -0.25, 0.14))
HIGH = wheel("left", (0, 0.25, 0.12)) + wheel("right", (0, -0.25, 0.12))
PLAIN = ARM.replace("grasp_frame", "end").replace("palm", "stub").replace("finger", "jaw")
LOOSE = link("float") + '<joint name="loose" type="planar"><parent link="hull"/><child link="float"/></joint>'
WORLD = '<link name="world"/>' + joint("on", "world", "base_footprint", (0, 0, 0))
IDLE = WEAK.replace("limit ", 'limit effort="0" ')
EMPTY = link("tray") + WEAK.replace('"-1" upper="1"', '"0" upper="0"')


@pytest.mark.parametrize(
    ("body", "check", "words"),
    [
        (
            ARM.replace(link("fore"), f'<link name="fore">{BAD}</link>'),
            "inertia",
            ("warning: link 'fore'", "not positive", "sphere"),
        ),
        (
            ARM.replace(link("fore"), f'<link name="fore">{MILLIMETERS}</link>'),
            "inertia",
            ("warning: link 'fore'", "radius of 100 m", "sphere"),
        ),
        (LIGHT, "inertia", ("link 'fore'", "moves and has no mass")),
        (ARM.replace(link("head"), SKIN), "meshes", ("info", "package://skin/a.stl", "packages: {skin: FOLDER}")),
        (ARM.replace(link("head"), DRAWN), "meshes", ("info", "not read", "a.dae", ".stl or .obj")),
        (ARM + link("tray") + WEAK, "velocity", ("warning: joint 'weak'", "limits.velocity: {weak:")),
        (ARM + link("tray") + IDLE, "effort", ("warning: joint 'weak'", "count for none", "limits.effort: {weak:")),
        (ARM + EMPTY, "range", ("joint 'weak'", "empty", "fixed_joints: {weak: 0}")),
        (ARM, "mimic", ("'finger_2_joint'", "follows 'finger_1_joint'", "{finger_1_joint: 0, finger_2_joint: 0}")),
        (ARM + SLIDES, "telescope", ("'extend_1', 'extend_2'", "arm.joints")),
        (SWERVE.replace("0 0 1", "0 0 -1", 1) + ARM, "steering", ("warning: joint 'front_steer'", "about -z")),
        (BESIDE + ARM, "steering", ("wheel 'front_joint'", "40 mm beside")),
        (BESIDE + ARM, "base", ("info", "base type wheels", "2 steered")),
        (DIFFERENTIAL + CASTER + ARM, "casters", ("caster_turn: 0",)),
        (LEVEL + ARM, "casters", ("level with the driven wheels",)),
        (WORLD + ARM, "world", ("info: link 'world'",)),
        (UNEVEN + ARM, "level", ("warning: wheel 'right_joint'", "40 mm above")),
        (HIGH + ARM, "wheel-radius", ("radius is 0.1 m", "0.12 m above")),
        (PLAIN, "tool", ("info: frame 'end'", "no frame is called like a tool")),
        (ARM + LOOSE, "joint-types", ("joint 'loose'", "planar")),
        ("", "tool", ("no joint looks like an arm's",)),
    ],
)
def test_a_trap_is_found_with_its_fix(body: str, check: str, words: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "a.dae").touch()
    text = found(model(tmp_path, body), check)
    assert all(w in text for w in words), text


def test_a_sound_model_has_none_of_them(tmp_path: Path) -> None:
    result = examine_robot(str(model(tmp_path, DIFFERENTIAL + ARM)))
    assert {f.check for f in result.findings} == {"mimic", "base"} and result.count("warning") == 0


@pytest.mark.parametrize(
    ("keys", "check", "words"),
    [
        (("home:\n", "hom:\n"), "description", ("unknown key 'hom'", "did you mean 'home'")),
        (("tool: grasp_frame", "tool: grasp"), "description", ("'grasp'", "did you mean 'grasp_frame'")),
        (("head_pan: 0", "head_pan: 0\n  caster: 0"), "description", ("'caster'",)),
        (("  head_pan: 0\n", ""), "description", ("'head_pan'", "fixed_joints: {head_pan: 0}")),
        (("  type: differential", "  type: differential\n  wheel_radius: 0.12"), "description", ("0.12 m", "0.1 m", "5 %")),
        (("  type: differential\n", "  type: omnidirectional\n  rollers: [1, -1]\n"), "base", ("rank 2", "3 is needed")),
    ],
)  # fmt: skip
def test_a_robots_yaml_is_examined(keys: tuple[str, str], check: str, words: tuple[str, ...], tmp_path: Path) -> None:
    path = new(model(tmp_path, DIFFERENTIAL + ARM))
    text = path.read_text()
    assert keys[0] in text
    path.write_text(text.replace(*keys))
    seen = found(path, check)
    assert all(w in seen for w in words), seen


@pytest.mark.parametrize("base", ["wheels", "planar"])
def test_wheels_beside_their_axes_are_no_trap_where_the_base_type_describes_them_or_uses_none(
    base: str, tmp_path: Path
) -> None:
    path = new(model(tmp_path, BESIDE + ARM), "--base", base)
    assert not any(f.check == "steering" for f in examine_robot(str(path)).findings)


def test_a_frame_above_the_wheels_is_not_the_ground(tmp_path: Path) -> None:
    low = wheel("left", (0, 0.25, -0.04)) + wheel("right", (0, -0.25, -0.04))
    findings = examine_robot(str(model(tmp_path, low + ARM))).findings
    assert not any(f.check == "wheel-radius" for f in findings)


def test_followers_that_are_held_are_no_trap(tmp_path: Path) -> None:
    path = new(model(tmp_path, DIFFERENTIAL + ARM))
    assert not any(f.check == "mimic" for f in examine_robot(str(path)).findings)


def test_wheels_that_hardly_hold_the_base(tmp_path: Path) -> None:
    """Omni wheels whose directions differ by 3 degrees: sideways motion is all in their difference."""
    angles = (0.0, 0.05, -0.05)
    wheels = "".join(
        wheel(f"w{k}", (0.3 - 0.3 * k, 0.2 - 0.2 * k, RADIUS), turn=f"0 0 {a}") for k, a in enumerate(angles)
    )
    path = new(model(tmp_path, wheels + ARM), "--base", "fixed")
    text = path.read_text().replace(
        "type: fixed", "type: omnidirectional\n  wheels: [w0_joint, w1_joint, w2_joint]\n  rollers: omni"
    )
    path.write_text("\n".join(line for line in text.splitlines() if "w" not in line or "_joint: 0" not in line) + "\n")
    assert "-fold in the worst motion" in found(path, "wheels"), examine_robot(str(path)).findings


def test_the_doctor_speaks_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = new(model(tmp_path, DIFFERENTIAL + ARM))
    capsys.readouterr()
    assert main(["doctor", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["errors"] == 0
    path.write_text(path.read_text().replace("lift:", "lift: 9 #", 1))
    assert main(["doctor", str(path), "--json"]) == 2
    report = json.loads(capsys.readouterr().out)
    assert report["errors"] >= 1 and report["model"] == str(tmp_path / "mover.urdf")
    assert any("home.lift" in f["where"] + f["text"] and f["severity"] == "error" for f in report["findings"])
    assert main(["doctor", "nobody.urdf"]) == 2
