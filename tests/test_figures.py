"""Figures in documents and the commit they are of. Truth: git itself; files of runs written by hand."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from wbmpc.report import provenance

ROOT = Path(__file__).parents[1]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
PAGE = "words\n<!-- {0} goals -->\n| head |\n| --- |\n| `swerve-old` | kept |\n<!-- end of {0} goals -->\nmore\n"


def git(*words: str) -> str:
    done = subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True)
    if done.returncode:
        pytest.skip("not a git checkout")
    return done.stdout.strip()


def test_a_run_records_the_commit_of_its_checkout() -> None:
    changed = git("status", "--porcelain", "--untracked-files=no", "src/wbmpc")
    assert provenance.versions()["commit"] == git("rev-parse", "--short=10", "HEAD") + "+" * bool(changed)


def test_an_installed_package_has_no_commit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither outside of a repository nor as an untracked file in somebody else's."""
    monkeypatch.setattr(provenance, "PACKAGE", tmp_path)
    assert provenance.commit.__wrapped__() == ""
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    made = ["-c", "user.name=a", "-c", "user.email=a@b", "commit", "-q", "--allow-empty", "-m", "somebody's"]
    subprocess.run(["git", "-C", str(tmp_path), *made], check=True)
    assert provenance.commit.__wrapped__() == ""


def finished_run(site: Path, name: str, seed: int, error: float, commit: str) -> None:
    directory = site / name / f"seed{seed}"
    directory.mkdir(parents=True)
    run: dict[str, Any] = {
        "seed": seed, "completed": True, "metrics": {"hand_error_mean_odometry": {"value": error, "unit": "m"}},
        "targets": {"hand_error_mean_odometry": {"goal": 0.002, "least": None, "paper": 0.0167}}, "versions": {"commit": commit},
    }  # fmt: skip
    (directory / "metrics.json").write_text(json.dumps(run))
    (directory / "finished").touch()


def test_tables_of_goals_name_the_commit(tmp_path: Path) -> None:
    """Of an experiment without runs the old rows stay, and so does the page of a robot without a study."""
    (tmp_path / "results").mkdir()
    for robot in ("swerve", "ball"):
        (tmp_path / "results" / f"{robot}.md").write_text(PAGE.format(robot))
    error: dict[str, Any] = {"unit": "m", "median": 0.002, "p5": 0.001, "p95": 0.003, "worst": None, "goal": 0.002, "least": None,
                             "paper": 0.0167, "met": False}  # fmt: skip
    cell = {"experiment": "swerve-track", "condition": "protocol", "seeds": [300, 301], "metrics": {"error": error}}
    (tmp_path / "runs" / "swerve-goals").mkdir(parents=True)
    study = json.dumps({"commit": ["abc1234567"], "cells": [cell]})
    (tmp_path / "runs" / "swerve-goals" / "statistics.json").write_text(study)
    script = [sys.executable, str(ROOT / "scripts" / "figures.py"), "--docs", str(tmp_path)]
    subprocess.run([*script, "--runs", str(tmp_path / "runs")], env=ENVIRONMENT, check=True, capture_output=True)
    rows = (tmp_path / "results" / "swerve.md").read_text().splitlines()
    expected = "| `swerve-track` | `error` [mm] | ≤ 2 | 16.7 | 2 (3, ∞) | abc1234567 | 2 | **no** |"
    assert expected in rows and "| `swerve-old` | kept |" in rows and rows[-1] == "more"
    assert (tmp_path / "results" / "ball.md").read_text() == PAGE.format("ball")
    done = subprocess.run([*script, "--runs", str(tmp_path)], env=ENVIRONMENT, capture_output=True, text=True)
    assert done.returncode == 1 and "holds no finished studies" in done.stderr


def test_the_readme_names_the_commit(tmp_path: Path) -> None:
    finished_run(tmp_path / "site", "swerve-track", 200, 0.0012, "abc1234567")
    readme = tmp_path / "README.md"
    readme.write_text(
        "of <!--= commit -->unknown<!--/-->: <!--= swerve-track hand_error_mean_odometry mm -->–<!--/-->\n"
    )
    for name in ("log.npz", "run.mcap"):
        (tmp_path / "site" / "swerve-track" / "seed200" / name).touch()
    code = f"import sys; sys.path.insert(0, {str(ROOT / 'scripts')!r}); import readme; readme.clip = lambda *a: None; readme.main()"
    words = ["--site", str(tmp_path / "site"), "--readme", str(readme)]
    subprocess.run([sys.executable, "-c", code, *words], env=ENVIRONMENT, check=True, capture_output=True)
    assert "of <!--= commit -->abc1234567<!--/-->: " in readme.read_text() and ">1.2 mm (1.2)<" in readme.read_text()
