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
PAGE = "words\n<!-- {0} goals -->\n### `swerve-old`\n| kept |\n<!-- end of {0} goals -->\nmore\n"


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


def test_tables_of_conditions_count_what_they_accept_apart() -> None:
    """Of four runs one fell and one was accepted; where all that did not complete are failures the count alone says so."""
    sys.path.insert(0, str(ROOT / "scripts"))
    try:
        from figures import loads
    finally:
        sys.path.remove(str(ROOT / "scripts"))
    cell: Any = {"experiment": "corridor", "condition": "narrow", "metrics": {}, "failures": {"failed": 1, "count": 4},
                 "outcomes": {"completed": 2, "declined": 1, "fell": 1}}  # fmt: skip
    assert "| narrow | 1 of 4; 2 completed, 1 declined, 1 fell |" in loads([cell], "abc")
    assert "| narrow | 2 of 4 |" in loads([{**cell, "failures": {"failed": 2, "count": 4}}], "abc")


def test_tables_of_goals_name_the_commit(tmp_path: Path) -> None:
    """Of an experiment without runs the old rows stay, and so does the page of a robot without a study."""
    (tmp_path / "results").mkdir()
    for robot in ("swerve", "ball"):
        (tmp_path / "results" / f"{robot}.md").write_text(PAGE.format(robot))
    error: dict[str, Any] = {"unit": "m", "median": 0.002, "p5": 0.001, "p95": 0.003, "worst": None, "goal": 0.002, "least": None,
                             "paper": 0.0167, "met": False}  # fmt: skip
    cell = {
        "experiment": "swerve-track",
        "condition": "protocol",
        "seeds": [300, 301],
        "outcomes": {"completed": 1, "fell": 1},
        "metrics": {"error": error},
    }
    (tmp_path / "runs" / "swerve-goals").mkdir(parents=True)
    study = json.dumps({"commit": ["abc1234567"], "cells": [cell]})
    (tmp_path / "runs" / "swerve-goals" / "statistics.json").write_text(study)
    readme = tmp_path / "README.md"
    readme.write_text(
        "<!--= commit -->old<!--/-->: <!--= swerve-track error mm -->1<!--/-->, <!--= swerve-track fell 1 count -->0<!--/-->,"
        " <!--= swerve-track error mm median -->1<!--/-->, <!--= rezero-door error m worst -->7<!--/-->"
    )
    script = [sys.executable, str(ROOT / "scripts" / "figures.py"), "--docs", str(tmp_path), "--readme", str(readme)]
    subprocess.run([*script, "--runs", str(tmp_path / "runs")], env=ENVIRONMENT, check=True, capture_output=True)
    rows = (tmp_path / "results" / "swerve.md").read_text().splitlines()
    expected = "| `error` | ≤ 2 mm | 16.7 mm | 2 mm | 3 mm | ∞ | **no** |"
    head = "2 runs, seeds 300 to 301, commit abc1234567; 1 completed, 1 fell."
    assert rows[rows.index("### `swerve-track`") + 1] == head and expected in rows
    assert rows[2:4] == ["### `swerve-old`", "| kept |"] and rows[-1] == "more"
    assert (tmp_path / "results" / "ball.md").read_text() == PAGE.format("ball")
    filled = [text.partition("<!--/-->")[0] for text in readme.read_text().split("-->")[1::2]]
    assert [text.removesuffix("<!--/") for text in filled] == [
        "abc1234567, old",
        "2.0 mm (inf)",
        "1 of 2",
        "2.0 mm",
        "7",
    ]
    readme.write_text("<!--= commit -->old<!--/-->: <!--= rezero-door error m worst -->7<!--/-->")
    subprocess.run([*script, "--runs", str(tmp_path / "runs")], env=ENVIRONMENT, check=True, capture_output=True)
    assert readme.read_text().startswith("<!--= commit -->old<!--/-->")  # no figure of these runs is in it
    done = subprocess.run([*script, "--runs", str(tmp_path)], env=ENVIRONMENT, capture_output=True, text=True)
    assert done.returncode == 1 and "holds no finished studies" in done.stderr


def test_a_table_is_as_old_as_the_code_that_it_depends_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Truth: what is changed here after the commit. Comments, docstrings and packages that it does not depend on are none."""
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_ext"))
    import table_age

    git = lambda *words: table_age.git(tmp_path, "-c", "user.name=a", "-c", "user.email=a@b", *words)
    files = {
        "src/wbmpc/mpc/a.py": 1,
        "src/wbmpc/solver/a.py": 2,
        "src/wbmpc/bases/ball/a.py": 3,
        "src/wbmpc/lie.py": 4,
        "src/wbmpc/view/a.py": 5,
    }
    for name, value in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(f'"""Words."""\nx = {value}\n')
    if git("init", "-q") is None or git("add", "-A") is None or git("commit", "-qm", "first") is None:
        pytest.skip("there is no git")
    commit = (git("rev-parse", "HEAD") or "")[:10]
    page = tmp_path / "page.md"
    rows = f"| 0.12345678 | a{commit[:8]}b12345678 | 12345678 |\n| commit {commit}, acados 21376cb1a |"
    page.write_text(f"<!-- some goals -->\n{rows}\n<!-- end of some goals -->\n")
    monkeypatch.setattr(table_age, "ROOT", tmp_path)
    packages = frozenset({"mpc", "solver", "bases/ball", "bases/swerve", "modules"})
    table = table_age._marked("some goals", "page.md", packages)
    (tmp_path / "src/wbmpc/mpc/a.py").write_text("# other words\nx = (1)\n")
    (tmp_path / "src/wbmpc/view/a.py").write_text("x = 6\n")
    assert list(table_age.age(table, tmp_path)) == [f"of commit {commit}; nothing that it depends on has changed since"]
    (tmp_path / "src/wbmpc/lie.py").write_text("x = 7\n")
    (tmp_path / "src/wbmpc/bases/ball/a.py").unlink()
    table_age.changed.cache_clear()
    table_age.code_changed.cache_clear()
    assert list(table_age.age(table, tmp_path)) == [f"of commit {commit}; changed since: bases/ball, modules"]
    assert table_age.note(table, tmp_path) == f"*Of commit {commit}: changed since: bases/ball, modules.*"
    monkeypatch.setattr(table_age, "MOST_NAMED", 1)
    older = f"*Of commit {commit}: older than the code: 2 packages have changed since.*"
    assert table_age.note(table, tmp_path) == older
    page.write_text("<!-- some goals -->of commit 0123456abc<!-- end of some goals -->")
    assert list(table_age.age(table, tmp_path)) == ["of commit 0123456abc; it is not known here"]
    assert table_age.note(table, tmp_path) == "*Of commit 0123456abc: it is not known here.*"
    page.write_text("<!-- some goals -->\n<!-- end of some goals -->")
    assert table_age.note(table, tmp_path) == "*No runs are published here at present.*"


def test_every_table_has_its_marks_and_packages_that_exist(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_ext"))
    import table_age

    assert all(t.first in (text := (ROOT / t.page).read_text()) and t.last in text for t in table_age.TABLES)
    names = {name for table in table_age.TABLES for name in table.of} - {"modules"}
    assert [name for name in sorted(names) if not (ROOT / "src" / "wbmpc" / name).is_dir()] == []
    assert [name for name in sorted(table_age.NO_PART) if not (ROOT / "src" / "wbmpc" / name).is_file()] == []


def test_the_readme_says_whether_its_figures_are_older_than_the_code(monkeypatch: pytest.MonkeyPatch) -> None:
    """What git says of this checkout. After a change of code: python docs/_ext/table_age.py --write."""
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_ext"))
    import table_age

    text = (ROOT / "README.md").read_text()
    assert table_age.with_age(text, True) != table_age.with_age(text, False)
    old = table_age.is_old(table_age.TABLES[0])
    if old is None:
        pytest.skip("the commit of the figures is not in this checkout")
    assert text == table_age.with_age(text, old)
