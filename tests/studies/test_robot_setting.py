"""A robot of one's own on the command line: each fault is one message that names file and key, exit status 2."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from wbmpc.cli import main
from wbmpc.robots.description import DATA


def own_robot(folder: Path, **changes: object) -> Path:
    data = yaml.safe_load((DATA / "swerve-ur10.yaml").read_text())
    data["model"] = str(DATA / data["model"])
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump({**data, **changes}))
    return path


def rejected(path: str, capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["run", "swerve-track", "--set", f"robot={path}"]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "Traceback" not in printed.err
    assert len(printed.err.strip().splitlines()) == 1
    return printed.err


def test_missing_urdf(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = rejected(str(own_robot(tmp_path, model="nowhere.urdf")), capsys)
    assert "mine.yaml" in text and "model" in text and "nowhere.urdf" in text


def test_unknown_joint(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    arm = {"joints": ["shoulder_pan_join"], "tool": "tool0"}
    text = rejected(str(own_robot(tmp_path, arm=arm)), capsys)
    assert "mine.yaml" in text and "did you mean 'shoulder_pan_joint'" in text


def test_robot_without_swerve_base(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert "valid: swerve" in rejected("rezero", capsys)


def test_unknown_robot(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert "did you mean 'swerve-ur10'" in rejected("swerve-ur1", capsys)
