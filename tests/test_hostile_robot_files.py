"""Robot files and models that nobody wrote well, or somebody wrote to do harm, are errors that name them. Truth: what each file lacks."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from own_bases import write_base
from wbmpc.errors import InputError
from wbmpc.input_file import load_json
from wbmpc.robots import load_description
from wbmpc.robots.doctor import examine_robot
from wbmpc.robots.file_limits import check_size
from wbmpc.robots.xacro_file import find_package
from wbmpc.yaml_file import load_yaml

# ---------------------------------------------------------------------- robots
ARM = """<mujoco>{top}<worldbody><body name="b"><geom size="0.1"/>
<body name="t" pos="0 0 1"><joint name="j" range="-60 60"/><geom size="0.1"/>{inside}</body></body>{world}</worldbody></mujoco>"""
HUGE = [
    ({"world": '<replicate count="100000"><body><geom size="1"/></body></replicate>'}, "more than"),
    ({"inside": '<replicate count="999"><replicate count="999"><geom size="1"/></replicate></replicate>'}, "more than"),
    ({"world": "<body>" * 5000 + "</body>" * 5000}, "nested deeper"),
    ({"world": '<include file="arm.xml"/>'}, "leads back to itself"),
    ({"top": '<asset><texture name="x" type="2d" builtin="flat" width="90000" height="90000"/></asset>'}, "texture"),
    ({"top": '<size nuser_body="2000000000"/>'}, "nuser_body"),
]  # fmt: skip


@pytest.mark.parametrize(("parts", "says"), HUGE, ids=range(len(HUGE)))
def test_a_robot_file_that_asks_for_too_much_is_an_error_before_it_is_compiled(
    parts: dict[str, str], says: str, tmp_path: Path
) -> None:
    (tmp_path / "arm.xml").write_text(ARM.format(**{"top": "", "inside": "", "world": "", **parts}))
    with pytest.raises(InputError, match=rf"arm\.xml: line \d+: .*{says}"):
        load_description(_arm(tmp_path, "arm.xml"))


@pytest.mark.parametrize(
    "parts",
    [
        {"world": '<include file="pipe.stl"/>'},
        {"top": '<asset><mesh name="x" file="pipe.stl"/></asset>'},
        {"top": '<compiler meshdir="meshes"/><asset><mesh name="x" file="beside.stl"/></asset>'},
        {"top": '<asset><hfield name="x" file="/dev/zero" size="1 1 1 1"/></asset>'},
    ],
)
def test_a_robot_file_that_names_a_pipe_is_an_error(parts: dict[str, str], tmp_path: Path) -> None:
    """Whoever opened it would wait until somebody writes."""
    (tmp_path / "meshes").mkdir()
    os.mkfifo(tmp_path / "pipe.stl")
    os.mkfifo(tmp_path / "meshes" / "beside.stl")
    (tmp_path / "arm.xml").write_text(ARM.format(**{"top": "", "inside": "", "world": "", **parts}))
    with pytest.raises(InputError, match=r"arm\.xml: line \d+: <.*is no regular file"):
        check_size(tmp_path / "arm.xml")


@pytest.mark.parametrize("name", ["x" * 5000, "x" * 300 + ".urdf", "a/" * 3000 + "b.xml"])
def test_a_name_that_no_file_system_takes_is_an_error(name: str, tmp_path: Path) -> None:
    """Of a model, and of what a model names: pathlib raises for these where it says no to others."""
    with pytest.raises(InputError, match="key 'model': there is no file"):
        load_description(_arm(tmp_path, name))
    mesh = f'<asset><mesh name="m" file="{name}.stl"/></asset>'
    (tmp_path / "arm.xml").write_text(ARM.format(top=mesh, inside="", world=""))
    check_size(tmp_path / "arm.xml")
    with pytest.raises(InputError):
        load_description(tmp_path / f"{name}.yaml")


@pytest.mark.parametrize("kind", ["yes", "no", "5", "[a]", "{a: yes}", "~"])
def test_a_base_type_that_is_no_text_is_an_error_with_its_key(kind: str, tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM.format(top="", inside="", world=""))
    path = _arm(tmp_path, "arm.xml")
    path.write_text(path.read_text().replace("type: fixed", f"type: {kind}"))
    with pytest.raises(InputError, match=r"key 'base\.type"):
        load_description(path)


@pytest.mark.parametrize(
    "manifest", [b"<package><name>", b'<?xml version="1.0" encoding="no-such"?><a/>', b"\xff\xfe<"]
)
def test_a_damaged_manifest_beside_a_model_is_none(manifest: bytes, tmp_path: Path) -> None:
    (tmp_path / "package.xml").write_bytes(manifest)
    assert find_package("robot", tmp_path, {}) is None


@pytest.mark.parametrize(
    ("manifest", "found"),
    [
        ("<package><a><name>other</name></a><name>\n robot </name></package>", True),
        ("<package><name>other</name></package>", False),
        ("<!DOCTYPE p [<!ENTITY n 'robot'>]><package><name>&n;</name></package>", False),
        ("<package><name>robot</name>" + " " * 2_000_000 + "</package>", False),
    ],
    ids=["named", "other", "entity", "huge"],
)
def test_a_manifest_is_read_within_limits(manifest: str, found: bool, tmp_path: Path) -> None:
    """Truth: REP 149 (the package's name is the root's element of that name)."""
    (tmp_path / "package.xml").write_text(manifest)
    assert find_package("robot", tmp_path, {}) == (tmp_path if found else None)


@pytest.mark.parametrize("kind", ["pipe", "/dev/zero", "/proc/self/mem", "nul"])
@pytest.mark.parametrize("read", [load_yaml, load_json], ids=["yaml", "json"])
def test_what_is_no_regular_file_is_an_error(read: Callable[[Path], object], kind: str, tmp_path: Path) -> None:
    """A pipe without a writer, a device that never ends, memory that cannot be read, a name with NUL. Truth: POSIX."""
    path = tmp_path / "file"
    if kind == "nul":
        path = tmp_path / "\0"
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(kind)
    with pytest.raises(InputError, match=r"is no regular file|cannot be read"):
        read(path)


@pytest.mark.parametrize("name", ["arm.xml", "arm.urdf"])
def test_entities_are_an_error(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(
        '<!DOCTYPE x [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><robot name="&b;"><link name="b"/></robot>'
    )
    with pytest.raises(InputError, match="DOCTYPE"):
        load_description(_arm(tmp_path, name))


@pytest.mark.parametrize("root", ["robot", "mujoco"])
def test_an_element_of_many_attributes_is_an_error_before_it_is_compiled(root: str, tmp_path: Path) -> None:
    path = tmp_path / "many.xml"
    many = lambda n: path.write_text(f"<{root} " + " ".join(f"a{k}='1'" for k in range(n)) + "/>")
    many(256)
    check_size(path)
    many(257)
    with pytest.raises(InputError, match=rf"many\.xml: line 1: <{root}> has 257 attributes; at most 256"):
        check_size(path)


LINK = '<link name="{}"><visual name="v"><geometry><sphere radius="1"/></geometry></visual></link>'
JOINT = '<joint name="{}" type="continuous"><parent link="{}"/><child link="{}"/><axis xyz="0 0 1"/></joint>'


@pytest.mark.parametrize(("links", "joints"), [("abc", "jj"), ("abc", "jk")])
def test_names_that_are_there_twice_are_an_error(links: str, joints: str, tmp_path: Path) -> None:
    path = tmp_path / "twice.urdf"
    parts = [*map(LINK.format, links), *(JOINT.format(n, *links[k : k + 2]) for k, n in enumerate(joints))]
    path.write_text(f'<robot name="r">{"".join(parts)}</robot>')
    found = [f.message for f in examine_robot(str(path)).findings if f.severity == "error"]
    says = "twice.urdf: joint 'j' is in the file twice"
    assert any(says in text for text in found) == (joints == "jj")


def test_a_comment_of_dashes_is_none(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM.format(top="<!-- a -- b -->", inside="", world=""))
    assert load_description(_arm(tmp_path, "arm.xml")).arm.joints == ("j",)


def _arm(folder: Path, model: str) -> Path:
    path = folder / "arm.yaml"
    path.write_text(f"name: arm\nmodel: {model}\nbase: {{type: fixed, body: b}}\narm: {{joints: [j], tool: t}}\n")
    return path


@pytest.mark.parametrize(("radius", "fits"), [(0.08, True), (0.083, True), (0.077, True), (0.085, False), (5.0, False)])
def test_the_wheels_radius_is_that_of_their_shapes(radius: float, fits: bool, tmp_path: Path) -> None:
    """The base's wheels are drawn with 0.08 m."""
    path = write_base(tmp_path, 3, False)
    path.write_text(path.read_text().replace("wheel_radius: 0.08", f"wheel_radius: {radius}"))
    if fits:
        assert load_description(path).base.wheel_radius == radius
        return
    with pytest.raises(InputError, match=rf"key 'base.wheel_radius': {radius:g} m, but .* has a radius of 0.08 m"):
        load_description(path)


def test_without_round_shapes_nothing_can_be_said_of_the_radius(tmp_path: Path) -> None:
    path = write_base(tmp_path, 3, False)
    shapes = tmp_path / "base.xml"
    shapes.write_text(
        shapes.read_text().replace('type="ellipsoid" size="0.08 0.02 0.08"', 'type="box" size="0.01 0.02 0.01"')
    )
    path.write_text(path.read_text().replace("wheel_radius: 0.08", "wheel_radius: 0.2"))
    assert load_description(path).base.wheel_radius == 0.2


def test_the_balls_radius_is_that_of_its_sphere(tmp_path: Path) -> None:
    data = yaml.safe_load(Path(load_description("rezero").source).read_text())
    data["model"], data["base"]["ball_radius"] = str(load_description("rezero").model), 5.0
    (tmp_path / "ball.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(InputError, match=r"key 'base.ball_radius': 5 m"):
        load_description(tmp_path / "ball.yaml")


def changed(tmp_path: Path, name: str, key: str, value: object) -> Path:
    """A built-in robot's file with another value of a dotted key."""
    source = load_description(name)
    data = yaml.safe_load(Path(source.source).read_text())
    data["model"] = str(source.model)
    *parents, last = key.split(".")
    place = data
    for parent in parents:
        place = place.setdefault(parent, {})
    place[last] = value
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(data))
    return tmp_path / "robot.yaml"


def test_omni_wheels_are_no_larger_than_their_ball(tmp_path: Path) -> None:
    """They have no shapes in the model: 64 mm in place of 6.4 m are on a ball of 125 mm."""
    assert load_description(changed(tmp_path, "rezero", "base.wheels.radius", 0.07)).base.wheels.radius == 0.07
    with pytest.raises(InputError, match=r"robot.yaml: .*wheels.radius: 6.4 m is more than the radius of the ball"):
        load_description(changed(tmp_path, "rezero", "base.wheels.radius", 6.4))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("arm.tool", "wheel_LF"), ("arm.tool", "world"), ("arm.tool", "body"), ("arm.tool", "mount"), ("base.body", "world"),
        ("base.wheel_radius", True), ("limits.base_linear", True), ("home.elbow_joint", False),
        ("limits.velocity.elbow_joint", 1e-300), ("limits.effort.elbow_joint", 1e300), ("limits.base_angular", 1e300),
        ("limits.position.elbow_joint", [-1e300, 1e300]),
    ],
)  # fmt: skip
def test_what_no_robot_can_be_is_an_error_with_its_key(key: str, value: object, tmp_path: Path) -> None:
    """A tool that the arm does not move, a base that is the world, numbers that are true or false, limits of no machine."""
    with pytest.raises(InputError, match=rf"robot.yaml: key '{key}"):
        load_description(changed(tmp_path, "swerve-ur10", key, value))


def test_a_tool_before_the_last_joint_and_a_payload_are_fine(tmp_path: Path) -> None:
    assert load_description(changed(tmp_path, "swerve-ur10", "arm.tool", "forearm_link")).arm.tool == "forearm_link"
    assert load_description(changed(tmp_path, "rezero", "base.payload", True)).base.payload  # type: ignore[union-attr]


def test_a_model_that_cannot_be_read_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As one whose permissions do not allow it, which a superuser's tests cannot make."""
    path = changed(tmp_path, "swerve-ur10", "model", "arm.xml")
    (tmp_path / "arm.xml").write_text("<mujoco/>")
    opened = os.open

    def denied(path: Path, *rest: int) -> int:
        if Path(path).name == "arm.xml":
            raise PermissionError(13, "Permission denied", str(path))
        return opened(path, *rest)

    monkeypatch.setattr(os, "open", denied)
    with pytest.raises(InputError, match=r"arm.xml: cannot be read \(Permission denied\)"):
        load_description(path)


@pytest.mark.parametrize(("key", "joint"), [("home", "elbow_joint"), ("fixed_joints", "leg_LF")])
def test_the_doctor_names_joints_that_are_where_they_cannot_be(key: str, joint: str, tmp_path: Path) -> None:
    """Beyond the ranges of the model."""
    name = "swerve-ur10" if key == "home" else "swerve-fixed-ur10"
    found = examine_robot(str(changed(tmp_path, name, f"{key}.{joint}", 9.0))).findings
    found = [f for f in found if f.severity == "error"]
    assert [(f.where, f.text.partition(" is ")[0]) for f in found] == [(f"key '{key}.{joint}'", "9")]


@pytest.mark.parametrize("key", ["model", "packages"])
def test_a_home_directory_that_is_missing_is_an_error_with_its_key(tmp_path: Path, key: str) -> None:
    path = tmp_path / "robot.yaml"
    own = {"model": "~no-such-user-at-all/a.urdf", "packages": "a.urdf\npackages: {own: ~no-such-user-at-all/own}"}
    path.write_text(
        f"name: own\nbase: {{type: fixed, body: base}}\narm: {{joints: [one], tool: hand}}\nhome: {{}}\nmodel: {own[key]}\n"
    )
    with pytest.raises(InputError, match=f"robot.yaml: {key}: '~no-such-user-at-all"):
        load_description(path)
