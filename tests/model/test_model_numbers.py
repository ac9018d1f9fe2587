"""Numbers of models that are none of a machine, and bodies without names: named in a message, or taken as MJCF allows.

Truth: the attributes that the generator breaks, IEEE 754, and the documentation of MJCF (names of bodies are optional).
"""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from wbmpc.cli import main
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.robots.mechanism import read_mechanism
from wbmpc.robots.model_file import read_model

MJCF = """<mujoco><option gravity="0 0 -9.81" timestep="0.002"/><worldbody>
<body name="b"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<body name="t" pos="0 0 1" euler="0 0 0"><joint name="j" axis="0 1 0" range="-60 60" damping="1"/>
<geom size="0.1" mass="1"/><site name="s" pos="0 0 0.3"/></body></body></worldbody>
<actuator><motor joint="j" gear="1" ctrlrange="-5 5"/></actuator><keyframe><key qpos="0.5"/></keyframe></mujoco>"""
URDF = """<robot name="a"><link name="b"/><link name="t"><inertial><origin xyz="0 0 0.1" rpy="0 0 0"/><mass value="2"/>
<inertia ixx="0.5" iyy="0.5" izz="0.5" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j" type="revolute"><parent link="b"/>
<child link="t"/><axis xyz="0 1 0"/><limit lower="-1" upper="1.5" effort="10" velocity="3"/></joint></robot>"""
PARTS = [
    ("arm.xml", part) for part in ('gravity="0 0 -9.81"', 'timestep="0.002"', 'pos="0 0 0"', 'mass="1"', 'diaginertia="1 1 1"',
    'euler="0 0 0"', 'axis="0 1 0"', 'range="-60 60"', 'damping="1"', 'size="0.1"', 'gear="1"', 'ctrlrange="-5 5"', 'qpos="0.5"')
] + [
    ("arm.urdf", part) for part in ('xyz="0 0 0.1"', 'rpy="0 0 0"', 'value="2"', 'izz="0.5"', 'xyz="0 1 0"', 'lower="-1"', 'upper="1.5"',
    'effort="10"', 'velocity="3"')
]  # fmt: skip


def mechanism(folder: Path, name: str, text: str) -> object:
    (folder / name).write_text(text)
    return read_mechanism(read_model(folder / name))


@pytest.mark.parametrize(("name", "part"), PARTS)
def test_no_number_of_a_model_is_nan(
    name: str, part: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The message has file, line, element and attribute; MuJoCo itself takes NaN, and prints a warning."""
    monkeypatch.chdir(tmp_path)
    attribute, _, value = part.partition("=")
    text = URDF if name.endswith("urdf") else MJCF
    words = value.strip('"').split()
    for word in ("nan", "-NaN", "nan(1)"):
        broken = text.replace(part, f'{attribute}="{" ".join([word, *words[1:]])}"', 1)
        assert broken != text
        with pytest.raises(
            InputError, match=rf"arm\.\w+: line \d: <\w+>: '{attribute}' has '.*', which is not a number"
        ):
            mechanism(tmp_path, name, broken)
    assert capfd.readouterr() == ("", "") and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize(
    ("part", "value", "says"),
    [
        ('pos="0 0 1"', "1e200 0 0", r"<body>: 'pos' has '1e200'"),
        ('pos="0 0 1"', "inf 0 0", r"<body>: 'pos' has 'inf'"),
        ('pos="0 0 1"', "0 3e5 0", r"body 't': its position \[m\] is 3e\+05; at most 10000 is possible"),
        ('size="0.1"', "1e9", r"body 't': its moment of inertia"),
        ('mass="1"', "1e9", r"body 'b': its mass \[kg\] is 1e\+09"),
        ('pos="0 0 0.3"', "0 1e9 0", r"site 's': its position"),
    ],
)
def test_no_number_of_a_model_is_beyond_machines(part: str, value: str, says: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=rf"arm\.xml: .*{says}"):
        mechanism(tmp_path, "arm.xml", MJCF.replace(part, f'{part.partition("=")[0]}="{value}"'))


@pytest.mark.parametrize("end", ["1e308", "1e16", "inf"])
@pytest.mark.parametrize("name", ["arm.xml", "arm.urdf"])
def test_a_range_that_no_joint_can_leave_is_none(name: str, end: str, tmp_path: Path) -> None:
    whole = MJCF.replace("-60 60", f"-{end} {end}")
    if name == "arm.urdf":
        whole = URDF.replace('"-1"', f'"-{end}"').replace('"1.5"', f'"{end}"')
    assert mechanism(tmp_path, name, whole).joints["j"].range is None  # type: ignore[attr-defined]
    robot = tmp_path / "arm.yaml"
    robot.write_text(f"name: arm\nmodel: {name}\nbase: {{type: fixed, body: b}}\narm: {{joints: [j], tool: t}}\n")
    assert load_robot(robot).limits.state_upper[0] == float("inf")


def test_a_name_may_look_like_a_number(tmp_path: Path) -> None:
    text = MJCF.replace('"j"', '"nan"').replace('"t"', '"inf"').replace('"s"', '"1e300"')
    assert list(mechanism(tmp_path, "arm.xml", text).joints) == ["nan"]  # type: ignore[attr-defined]


def test_bodies_need_no_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """They get names by the body that carries them, which others in the file do not have."""
    text = MJCF.replace('<body name="t"', "<body").replace('<body name="b">', '<body name="b"><body name="b_body1"/>')
    (tmp_path / "arm.xml").write_text(text)
    out = tmp_path / "new.yaml"
    assert main(["new", str(tmp_path / "arm.xml"), "--yes", "--out", str(out)]) == 0
    assert yaml.safe_load(out.read_text())["arm"]["joints"] == ["j"]
    bodies = read_mechanism(read_model(tmp_path / "arm.xml")).path("b_body2")
    assert bodies == ["world", "b", "b_body2"]
    assert load_robot(out).state.size == 1
    assert main(["doctor", str(out)]) == 0
