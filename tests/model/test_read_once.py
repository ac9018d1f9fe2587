"""An examination reads a robot's model once. Truth: how often its file is read, what is found without that, and the file as it is now."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path

import pytest

from wbmpc.cli import main
from wbmpc.robots import doctor, model_file
from wbmpc.robots.description import load_description
from wbmpc.robots.doctor import examine_robot


def column(folder: Path, mass: float) -> Path:
    """A lift with a tool: one slide, and a joint that the robot file holds."""
    joint = (
        '<joint name="{0}" type="prismatic"><parent link="{1}"/><child link="{2}"/><axis xyz="0 0 1"/>'
        '<limit lower="0" upper="1" velocity="1" effort="1"/></joint>'
    )
    body = (
        '<link name="{0}"><inertial><mass value="{1}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
        "</inertial></link>"
    )
    parts = [body.format(*b) for b in (("ground", 1), ("lift", mass), ("tip", 1))]
    parts += [joint.format("up", "ground", "lift"), joint.format("out", "lift", "tip")]
    (folder / "column.urdf").write_text(f'<robot name="column">{"".join(parts)}</robot>')
    path = folder / "column.yaml"
    path.write_text(
        "name: column\nmodel: column.urdf\nbase: {type: fixed, body: ground}\narm: {joints: [up], tool: tip}\nfixed_joints: {out: 0.5}\n"
    )
    return path


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Files in the order in which they are read."""
    done, read = list[Path](), model_file._read

    def counted(path: Path, packages: Mapping[str, Path] | None, arguments: Mapping[str, str] | None) -> object:
        done.append(path)
        return read(path, packages, arguments)

    monkeypatch.setattr(model_file, "_read", counted)
    return done


def test_a_model_is_read_once(tmp_path: Path, reads: list[Path]) -> None:
    path = column(tmp_path, 1.0)
    examine_robot(str(path))
    assert len(reads) == 1
    assert main(["doctor", str(path)]) == 0
    assert len(reads) == 2  # with the pairs of its parts, for which the robot is loaded
    load_description(path)
    assert len(reads) > 3


@pytest.mark.parametrize("robot", ["swerve-ur10", "fetch", "rezero", "column"])
def test_the_findings_are_those_of_reading_it_each_time(
    robot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = str(column(tmp_path, -1.0)) if robot == "column" else robot
    found = examine_robot(name).findings
    monkeypatch.setattr(doctor, "reading_once", nullcontext)
    assert examine_robot(name).findings == found and (found or robot != "column")


def test_a_file_that_has_changed_is_read_anew(tmp_path: Path) -> None:
    before = examine_robot(str(column(tmp_path, 1.0))).findings
    after = examine_robot(str(column(tmp_path, -1.0))).findings
    assert not [f for f in before if f.check == "inertia"] and [f for f in after if "'lift'" in f.where]
