"""`wbmpc new` of models whose names would steer a reader of YAML or a terminal: a robot file that says the same, or one message. Truth: the
names of the files written here."""

from __future__ import annotations

import os
from itertools import pairwise
from pathlib import Path

import pytest
from urdf_parts import INERTIAL

from wbmpc.cli import main
from wbmpc.robots import load_description

SHAPE = '<collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision>'


def arm(folder: Path, name: str, file: str = "arm.urdf") -> Path:
    """Five links on a chain, the second of which has a name."""
    links = ["base", name, "l2", "l3", "l4"]
    text = "".join(f'<link name="{n}">{INERTIAL}{SHAPE}</link>' for n in links)
    for k, (above, below) in enumerate(pairwise(links)):
        ends = f'<parent link="{above}"/><child link="{below}"/><axis xyz="0 {int(k > 0)} {int(k == 0)}"/>'
        limit = '<limit lower="-2" upper="2" effort="50" velocity="2"/><origin xyz="0 0 0.3"/>'
        text += f'<joint name="j{k}" type="revolute">{ends}{limit}</joint>'
    path = folder / file
    path.write_text(f"<robot name='arm'>{text}</robot>", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "name", ["a&#x85;home: {}", "a&#x2028;b", "a&#x9b;31mb", "a&#x202e;b", "a: b # c", "010", "\u00e9"]
)
def test_names_stay_as_they_are(name: str, tmp_path: Path) -> None:
    """Line ends of Unicode, which YAML takes for spaces, controls of terminals, what YAML reads otherwise."""
    out = tmp_path / "arm.yaml"
    assert main(["new", str(arm(tmp_path, name)), "--yes", "--out", str(out)]) == 0
    named = {body for pair in load_description(out).collision.self.pairs or () for body in pair}
    expected = (
        name.replace("&#x85;", "\x85")
        .replace("&#x2028;", "\u2028")
        .replace("&#x9b;", "\x9b")
        .replace("&#x202e;", "\u202e")
    )
    assert expected in named and main(["doctor", str(out)]) == 0


@pytest.mark.parametrize("name", ["a&#x7f;b", "\u0663"])
def test_names_that_no_robot_file_has_are_one_message(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "arm.yaml"
    assert main(["new", str(arm(tmp_path, name)), "--yes", "--out", str(out)]) == 2
    assert str(out) in capsys.readouterr().err and not out.exists()


def test_a_file_whose_name_is_no_text(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = arm(tmp_path, "l1", os.fsdecode(b"\xff.urdf"))
    assert main(["new", str(path), "--yes", "--out", str(tmp_path / "arm.yaml")]) == 2
    assert "cannot be printed" in capsys.readouterr().err
