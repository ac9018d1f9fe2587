"""Links and joints of a URDF that make no tree: the fault names file, joint and link. Truth: the files written here."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import mujoco
import pytest

from wbmpc.errors import InputError
from wbmpc.robots.model_file import read_model
from wbmpc.robots.urdf_tree import check_tree


def links(names: str) -> str:
    return "".join(f'<link name="{name}"/>' for name in names)


def _weighted(text: str) -> str:
    """MuJoCo compiles only links that weigh something."""
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    return re.sub(
        r'<link name="(\w+)"/>', rf'<link name="\1"><inertial><mass value="1"/>{inertia}</inertial></link>', text
    )


def joint(name: str, parent: str, child: str, kind: str = "continuous") -> str:
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/></joint>'


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (links("ab") + joint("j", "hull", "b"), ("joint 'j'", "parent link", "unknown link 'hull'", "valid: a, b")),
        (links("ab") + joint("j", "a", "tip"), ("joint 'j'", "child link", "unknown link 'tip'")),
        (links("ab") + joint("j", "", "b"), ("joint 'j'", "no parent link")),
        (links("ab") + '<joint name="j" type="fixed"><parent link="a"/></joint>', ("joint 'j'", "no child link")),
        (links("abc") + joint("j", "a", "c") + joint("k", "b", "c"), ("joint 'k'", "link 'c'", "joint 'j' too")),
        (links("abc") + joint("j", "b", "c") + joint("k", "c", "b"), ("in a loop", "b, c")),
        (links("a") + joint("j", "a", "a"), ("joint 'j'", "in a loop")),
        (links("aab") + joint("j", "a", "b"), ("link 'a'", "twice")),
        (links("abc") + joint("j", "a", "b") + joint("j", "a", "c"), ("joint 'j'", "twice")),
        (links("ab") + joint("j", "a", "b", "screw"), ("joint 'j'", "unknown type 'screw'", "revolute")),
        (links("ab") + joint("j", "a", "b").replace(' name="j"', ""), ("a joint has no name",)),
    ],
)
def test_a_fault_is_named(body: str, words: tuple[str, ...], tmp_path: Path) -> None:
    path = tmp_path / "mover.urdf"
    path.write_text(f'<robot name="mover">{body}</robot>')
    with pytest.raises(InputError) as raised:
        read_model(path)
    said = str(raised.value)
    assert said.startswith(str(path)) and all(w in said for w in words), said


@pytest.mark.parametrize("text", ["1,5", "90deg", "2*pi", "1 2", "1_000", "0x10", "${speed}", ""])
def test_a_limit_that_is_no_number_is_an_error(text: str, tmp_path: Path) -> None:
    """MuJoCo reads no speeds: plans were as fast as they like. Truth: what C++'s streams and Python's ``float`` take for one number."""
    path, whole = tmp_path / "mover.urdf", joint("j", "a", "b", "revolute")
    for tag, name in (("limit", "velocity"), ("limit", "effort"), ("limit", "lower"), ("mimic", "multiplier")):
        limited = whole.replace("</joint>", f'<{tag} joint="k" {name}="{text}"/></joint>') + joint("k", "b", "c")
        path.write_text(f'<robot name="mover">{links("abc")}{limited}</robot>')
        with pytest.raises(InputError) as raised:
            read_model(path)
        assert f"joint 'j': <{tag}>: '{name}' must be a number, got '{text}'" in str(raised.value)
    path.write_text(path.read_text().replace(f'"{text}"/>', '" -1.5e-1 "/>'))
    assert read_model(path).root is not None


@pytest.mark.parametrize("text", ["-5", "-1e-9", "-inf", "-1e400"])
@pytest.mark.parametrize("name", ["velocity", "effort"])
def test_a_negative_limit_is_an_error(name: str, text: str, tmp_path: Path) -> None:
    """It counted for none: a drive as strong, or as fast, as it likes. 0 and inf are what files write that know none."""
    path = tmp_path / "mover.urdf"
    limited = joint("j", "a", "b", "revolute").replace("</joint>", f'<limit {name}="{text}"/></joint>')
    path.write_text(f'<robot name="mover">{links("ab")}{limited}</robot>')
    with pytest.raises(InputError) as raised:
        read_model(path)
    said = f"joint 'j': <limit>: '{name}' must not be negative, got '{text}'; valid: a number above 0"
    assert str(raised.value).startswith(f"{path}: {said}"), raised.value
    for valid in ("0", "-0", "inf", "12.5"):
        path.write_text(path.read_text().replace(f'{name}="{text}"', f'{name}="{valid}"'))
        assert read_model(path).root is not None
        text = valid


def mimic(name: str, parent: str, child: str, leader: str, kind: str = "revolute") -> str:
    return joint(name, parent, child, kind).replace("</joint>", f"{leader}</joint>")


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (
            mimic("j", "a", "b", '<mimic joint="missing"/>'),
            ("joint 'j'", "unknown joint 'missing'", "valid: k, fixture"),
        ),
        (mimic("j", "a", "b", "<mimic/>"), ("joint 'j'", "names no joint to follow")),
        (mimic("j", "a", "b", '<mimic joint=""/>'), ("joint 'j'", "names no joint to follow")),
        (mimic("j", "a", "b", '<mimic joint="j"/>'), ("joint 'j'", "in a loop: j")),
        (
            mimic("j", "a", "b", '<mimic joint="fixture"/>'),
            ("joint 'j'", "'fixture' is fixed", "valid: a joint that is"),
        ),
        (
            mimic("j", "a", "b", '<mimic joint="m"/>') + mimic("m", "a", "e", '<mimic joint="j"/>'),
            ("joint 'j'", "in a loop: j, m"),
        ),
    ],
)
def test_a_joint_that_mimics_none_is_an_error(body: str, words: tuple[str, ...], tmp_path: Path) -> None:
    """MuJoCo drops such a mimic without a name, and the joint was planned as one that moves by itself."""
    path = tmp_path / "mover.urdf"
    others = joint("k", "b", "c") + joint("fixture", "c", "d", "fixed")
    path.write_text(f'<robot name="mover">{body}{others}{links("abcde")}</robot>')
    with pytest.raises(InputError) as raised:
        read_model(path)
    said = str(raised.value)
    assert said.startswith(str(path)) and all(w in said for w in words), said


def test_followers_of_followers_are_read(tmp_path: Path) -> None:
    """As in telescopes of several stages, the last one first in the file."""
    path = tmp_path / "mover.urdf"
    body = (
        mimic("m", "a", "d", '<mimic joint="k"/>') + mimic("k", "a", "c", '<mimic joint="j"/>') + joint("j", "a", "b")
    )
    path.write_text(f'<robot name="mover">{body}{links("abcd")}</robot>')
    assert read_model(path).root is not None


def test_a_chain_of_all_kinds_is_a_tree(tmp_path: Path) -> None:
    """With the ball joint that ball robots need. Truth: MuJoCo reads it."""
    kinds = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar", "spherical")
    chain = "".join(joint(f"j{k}", "abcdefgh"[k], "abcdefgh"[k + 1], kind) for k, kind in enumerate(kinds))
    path = tmp_path / "mover.urdf"
    path.write_text(f'<robot name="mover">{chain}{links("hgfedcba")}</robot>')
    assert read_model(path).root is not None
    ball = f'<robot name="mover">{links("ab")}{joint("j", "a", "b", "spherical")}</robot>'
    assert mujoco.MjModel.from_xml_string(_weighted(ball)).jnt_type[0] == mujoco.mjtJoint.mjJNT_BALL


def test_a_long_chain_is_followed_once(tmp_path: Path) -> None:
    """20 000 links, the last one first: following each to the root would take 2e8 steps."""
    names = [f"l{k}" for k in range(20_000)]
    root = Element("robot")
    for name in reversed(names):
        SubElement(root, "link", name=name)
    for above, below in pairwise(names):
        part = SubElement(root, "joint", name=below, type="fixed")
        SubElement(part, "parent", link=above)
        SubElement(part, "child", link=below)
    check_tree(tmp_path / "chain.urdf", root)
    SubElement(root, "joint", name="back", type="fixed").extend(
        [Element("parent", link=names[-1]), Element("child", link=names[0])]
    )
    with pytest.raises(InputError, match="in a loop"):
        check_tree(tmp_path / "chain.urdf", root)
