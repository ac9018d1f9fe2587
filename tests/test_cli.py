"""The command line: what it prints and where it writes."""

from __future__ import annotations

import json
import os
import resource
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import wbmpc
from command_line import FAKE_MAIN, call, shell
from fake_experiment import REGISTRY
from wbmpc.cli import app, main
from wbmpc.cli.directories import resumed_directory
from wbmpc.cli.results import _table
from wbmpc.errors import InputError
from wbmpc.log import Log
from wbmpc.report import page
from wbmpc.result import Metric, RunResult

pytestmark = pytest.mark.usefixtures("empty_directory")


# ---------------------------------------------------------------------- where files go
def test_a_path_that_cannot_be_made_is_named_by_its_option(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for out in ("/proc/x", "/proc/x/y"):
        assert call("run", "fake", "--out", out) == call("bench", "--out", out) == 2
        for line in capsys.readouterr().err.splitlines():
            assert line.startswith(f"wbmpc: --out: '{out}' cannot be made (")
    assert call("run", "fake", "--out", "a", "--quiet") == 0
    assert call("compare", "a", "a", "--out", "/proc/x.html") == 2
    assert capsys.readouterr().err.startswith("wbmpc: --out: '/proc/x.html' cannot be written (")
    (tmp_path / "runs").write_text("")
    assert call("run", "fake") == 2
    assert "'runs/fake-seed200' cannot be made" in capsys.readouterr().err


def test_a_link_that_leads_nowhere_stays_one(tmp_path: Path) -> None:
    """Trying whether a page can be written changes nothing; the page then is where the link leads."""
    (tmp_path / "runs").mkdir()
    (tmp_path / "page.html").symlink_to("elsewhere.html")
    assert call("runs", "--quiet", "--page", "page.html") == 0
    assert (tmp_path / "page.html").is_symlink() and "<html" in (tmp_path / "elsewhere.html").read_text()
    (tmp_path / "other.html").symlink_to("missing/page.html")
    assert call("runs", "--quiet", "--page", "other.html") == 2 and (tmp_path / "other.html").is_symlink()


@pytest.mark.parametrize("more", [[], ["--force"]], ids=["", "force"])
def test_no_command_waits_for_the_reader_of_a_pipe(
    more: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "runs").mkdir()
    os.mkfifo(tmp_path / "page.html")
    (tmp_path / "link.html").symlink_to("page.html")
    for name in ("page.html", "link.html"):
        assert call("runs", "--page", name, *more) == 2
        assert f"--page: '{name}' is a pipe" in capsys.readouterr().err
    os.mkfifo(tmp_path / "compare.html")
    assert call("compare", "nothing", "here", *more) == 2
    assert ("--out: 'compare.html' is a pipe" in capsys.readouterr().err) == bool(more)  # else the next free name


def test_of_a_run_that_never_began_nothing_stays(tmp_path: Path) -> None:
    def fail(settings: Any, seed: int, progress: Any) -> Any:
        raise InputError("the problem has no solution")

    registry = {"fake": replace(REGISTRY["fake"], run=fail)}
    for out in ([], ["--out", "a/b"]):
        assert main(["run", "fake", *out], registry) == 2
        assert list(tmp_path.iterdir()) == []
    (tmp_path / "mine").mkdir()  # what was there stays
    assert main(["run", "fake", "--out", "mine"], registry) == 2
    assert [p.name for p in tmp_path.iterdir()] == ["mine"]
    assert call("run", "fake", "--quiet") == 0 and main(["run", "fake"], registry) == 2
    assert [p.name for p in (tmp_path / "runs").iterdir()] == ["fake-seed200"]


def test_a_run_whose_name_cannot_be_counted_on_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Beside '.' there is no '.-2', and what is beside the current directory was not named."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for out in (".", "../here/..", ".."):
        assert call("run", "fake", "--quiet", "--out", out) == (0 if out != ".." else 2)
        assert call("run", "fake", "--quiet", "--out", out) == 2
        assert f"--out: '{Path(out)}' has the files of a run already" in capsys.readouterr().err
    assert {p.name for p in tmp_path.iterdir() if p.is_dir()} == {"here"}


COMMANDS = [
    ("reproduce", "--only", "fake", "--seeds", "1"),
    ("study", "legs"),
    ("study", "legs", "--report"),
    ("tune", "rezero-tune-lqr"),
]


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_a_command_that_goes_on_takes_no_directory_of_something_else(
    command: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It would replace pages there. Truth: the page afterwards."""
    page, folders = tmp_path / "index.html", [tmp_path / name for name in ("parts", "trials", "network/seed1")]
    page.write_text("somebody's")
    for folder in folders:
        folder.mkdir(parents=True)
        (folder / "data.csv").write_text("somebody's")
    there = sorted(tmp_path.rglob("*"))
    for out in (".", str(tmp_path)):
        assert call(*command, "--quiet", "--out", out) == 2
        assert f"--out: '{out}' has files of something else (" in capsys.readouterr().err
    assert page.read_text() == "somebody's" and sorted(tmp_path.rglob("*")) == there


def test_the_root_of_the_file_system_is_no_directory_of_a_command() -> None:
    with (
        pytest.raises(InputError, match="--out: '/' has files of something else"),
        resumed_directory("--out", Path("/"), ("x/y",)),
    ):
        pytest.fail("it was taken")


# ---------------------------------------------------------------------- what works
def test_version_and_help_come_at_once() -> None:
    assert shell("--version").stdout.strip() == wbmpc.__version__
    spent = lambda: sum(
        resource.getrusage(resource.RUSAGE_CHILDREN)[:2]
    )  # of the processor: a busy machine changes nothing
    start = spent()
    out = shell("--help")
    # 0.15 s on a usual machine, 0.6 s is the goal; the heavy libraries alone would take longer than this bound
    assert spent() - start < 2.0
    assert out.returncode == 0 and all(c in out.stdout for c in ("list", "run", "bench", "demo"))


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys; from wbmpc.cli import main; main(['--help']); "
        "sys.exit(sum(m in sys.modules for m in ('casadi', 'mujoco', 'llvmlite', 'plotly', 'scipy', 'numpy', 'pydantic')))"
    )
    assert shell(code=code).returncode == 0


def test_no_command_shows_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert call() == 0
    assert "Usage" in capsys.readouterr().out


def test_list_names_experiments_and_robots(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list"]) == 0
    out = capsys.readouterr()
    assert out.err == ""
    for name in ("swerve-track", "rezero-steps", "swerve-ur10", "swerve-fixed-ur10", "rezero"):
        assert name in out.out
    assert main(["list", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert {e["name"] for e in data["experiments"]} >= {"swerve-track", "rezero-steps"}
    assert {"swerve-ur10", "rezero"} <= set(data["robots"])


def test_json_is_one_object_and_nothing_else(tmp_path: Path) -> None:
    out = shell("run", "fake", "--seed", "5", "--json", "--set", "mpc.rate=80", code=FAKE_MAIN)
    assert out.returncode == 0 and out.stderr == ""  # in a pipe: no progress bar
    data = json.loads(out.stdout)
    assert set(data) == {"experiment", "seed", "outcome", "completed", "reason", "metrics", "mpc", "files"}
    assert (data["experiment"], data["seed"], data["completed"], data["outcome"]) == ("fake", 5, True, "completed")
    assert set(data["metrics"]["fell"]) == {"value", "unit"}
    assert data["mpc"]["rate_hz"] == 80.0
    assert all((tmp_path / f).is_file() for f in data["files"].values())
    saved = json.loads((tmp_path / data["files"]["metrics"]).read_text())
    assert {k: saved[k] for k in data} == data
    assert saved["settings"]["mpc"]["rate"] == 80.0


def test_table_shows_ours_paper_goal_and_the_page(capsys: pytest.CaptureFixture[str]) -> None:
    assert call("run", "fake") == 0
    out = capsys.readouterr().out
    row = next(line for line in out.splitlines() if "hand_error_mean_odometry" in line)
    assert all(part in row for part in ("fake", " mm ", "16.7", "≤ 3", "reached"))
    assert "the report page is runs/fake-seed200/report.html" in out


def test_a_run_never_overwrites_another(tmp_path: Path) -> None:
    for _ in range(3):
        assert call("run", "fake", "--seed", "1", "--json") == 0
    assert sorted(p.name for p in (tmp_path / "runs").iterdir()) == ["fake-seed1", "fake-seed1-2", "fake-seed1-3"]
    texts = {json.dumps(json.loads(p.read_text())["metrics"]) for p in tmp_path.glob("runs/*/metrics.json")}
    assert len(texts) == 1  # the same seed gives the same figures


def test_out_chooses_the_directory(tmp_path: Path) -> None:
    assert call("run", "fake", "--out", "a/b", "--json") == 0
    assert sorted(p.name for p in (tmp_path / "a/b").iterdir()) == ["log.npz", "metrics.json", "report.html"]
    assert not (tmp_path / "runs").exists()


def test_a_given_directory_with_a_run_is_left_alone_too(tmp_path: Path) -> None:
    for seed in ("1", "2", "3"):
        assert call("run", "fake", "--out", "here", "--seed", seed, "--json") == 0
    seeds = {p.parent.name: json.loads(p.read_text())["seed"] for p in tmp_path.glob("*/metrics.json")}
    assert seeds == {"here": 1, "here-2": 2, "here-3": 3}


@pytest.mark.parametrize("place", ["front", "end"])
def test_quiet_and_verbose(place: str, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    at = lambda option: [option, "run", "fake"] if place == "front" else ["run", "fake", option]
    assert call(*at("--quiet")) == 0
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "") and (tmp_path / "runs/fake-seed200/report.html").exists()
    assert call(*at("--quiet"), "--set", "mpc.rate=-1") == 2
    assert "mpc.rate=-1" in capsys.readouterr().err  # errors are said
    assert call(*at("--quiet"), "--json") == 0
    assert json.loads(capsys.readouterr().out)["experiment"] == "fake"
    assert call(*at("--verbose"), "--set", "mpc.rate=70") == 0
    err = capsys.readouterr().err
    assert "files go into runs/fake-seed200-3" in err and '"rate": 70.0' in err and "report: runs/" in err
    assert call("run", "fake") == 0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    "line", ["--json run fake", "--json --quiet run fake --seed 3", "run --json fake", "--json list"]
)
def test_json_is_understood_before_the_command_too(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(*line.split()) == 0
    assert "experiment" in json.loads(capsys.readouterr().out) or line.endswith("list")
    assert call("--json") == 0 and "Usage" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["", "run", "log info", "log", "ros2 check", "compare"])
def test_every_help_says_what_is_understood_everywhere(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(*command.split(), "--help") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "--quiet, --verbose, --debug" in said and "before or after" in said


def test_figures_of_a_run_that_the_user_ended_are_not_judged(capsys: pytest.CaptureFixture[str]) -> None:
    """Truth: the same figures of a run that fell, which are judged."""
    figures = {
        "rise_time_max": Metric(np.inf, "s", goal=1.0, goal_note="of all steps"),
        "fell": Metric(0.0, "count", goal=0.0),
    }
    for interrupted in (True, False):
        result = RunResult("x", 1, False, "ended at 3 s", figures, None, Log(), interrupted=interrupted)
        _table([result])
        out = " ".join(
            (capsys.readouterr().out + page(result).split("<body>")[1].split("What is idealized")[0]).split()
        )
        assert ("missed" in out) is not interrupted and ("inf" in out) is not interrupted
        assert ("not measured" in out) is interrupted and ("of all steps" in out) is not interrupted


@pytest.mark.parametrize("paper", [None, 2.0])
@pytest.mark.parametrize("physics", ["mujoco", "kinematic"])
def test_what_was_simulated_and_whose_figures_there_are(
    paper: float | None, physics: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Truth: the run's own settings and metrics."""
    settings = {"plant": {"kind": physics}}
    result = RunResult("x", 1, True, "", {"way": Metric(1.0, "m", paper=paper)}, None, Log(), settings=settings)
    _table([result])
    out = " ".join(capsys.readouterr().out.split())
    body = page(result).split("<body>")[1].split("What is idealized")[0]
    assert ("paper" in out) is ("paper" in body) is (paper is not None)
    for text in (out, body):
        assert ("in MuJoCo" in text) is (physics == "mujoco")
        assert ("by the planner's own model" in text) is (physics == "kinematic")


def test_failures_of_the_solver_are_in_table_and_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert call("run", "fake", "--set", "failures=7", "--json") == 0
    mpc = json.loads(capsys.readouterr().out)["mpc"]
    assert (mpc["solves"], mpc["failures"], mpc["no_step"], mpc["failed_share"]) == (100, 7, 1, 0.08)
    assert call("run", "fake", "--set", "failures=7") == 0
    rows = capsys.readouterr().out.splitlines()
    assert any("solves that failed" in r and "of 100" in r and "8" in r for r in rows)
    assert any("deadline misses" in r for r in rows)


def test_a_missed_goal_is_explained(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert call("run", "fake", "--out", "here") == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "fake, hand_error_max_odometry: the goal is for the mean of many" in out
    assert "the goal is for the mean of many" in (tmp_path / "here/report.html").read_text()
    assert "path_length:" not in out


# ---------------------------------------------------------------------- the other commands
def test_demo_runs_both_and_prints_one_table(capsys: pytest.CaptureFixture[str]) -> None:
    both = {"swerve-track": REGISTRY["fake"], "rezero-steps": REGISTRY["fake"]}
    assert main(["demo"], both) == 0
    captured = capsys.readouterr()
    assert captured.out.count("this run") == 1  # the header of one table
    assert (
        "runs/swerve-track-seed200/report.html" in captured.out
        and "runs/rezero-steps-seed200/report.html" in captured.out
    )
    assert main(["demo", "--json"], both) == 0
    captured = capsys.readouterr()
    assert captured.err == "" and len(json.loads(captured.out)["runs"]) == 2


def test_bench_prints_one_object(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    import wbmpc.benchmark as benchmark

    def fake(repeat: int, progress: Any) -> dict[str, Any]:
        progress(0.5, "half")
        return {"rows": [], "repeat": repeat}

    monkeypatch.setattr(benchmark, "run_benchmark", fake)
    assert call("bench", "--json") == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out) == {"rows": [], "repeat": 200} and captured.err == ""
    assert call("bench", "--json", "--repeat", "7") == 0
    assert json.loads(capsys.readouterr().out) == {"rows": [], "repeat": 7}


def test_a_race_replaces_none_of_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import wbmpc.benchmark as benchmark
    import wbmpc.benchmark.table as table

    monkeypatch.setattr(benchmark, "run_benchmark", lambda repeat, progress: {"repeat": repeat})
    monkeypatch.setattr(table, "text", lambda figures: "")
    for repeat, folder in (("3", "race"), ("5", "race-2")):
        assert call("bench", "--json", "--repeat", repeat, "--out", "race") == 0
        assert json.loads(capsys.readouterr().out)["files"]["json"] == f"{folder}/race.json"
    assert json.loads((tmp_path / "race" / "race.json").read_text())["repeat"] == 3


def test_the_commands_are_the_documented_ones() -> None:
    from typer.testing import CliRunner

    out = CliRunner().invoke(app, ["run", "--help"])
    assert out.exit_code == 0
    assert all(option in out.stdout for option in ("--seed", "--set", "--out", "--json"))


def test_the_shell_completes_commands_and_names(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def ask(words: str) -> list[str]:
        given = {"_WBMPC_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1)}
        for name, value in given.items():
            monkeypatch.setenv(name, value)
        monkeypatch.setattr(sys, "argv", ["wbmpc"])
        with pytest.raises(SystemExit, match="0"):
            main()
        return capsys.readouterr().out.split()

    assert ask("wbmpc rep") == ["replay", "reproduce"]
    assert "swerve-track" in ask("wbmpc run swerve-t") and "rezero" in ask("wbmpc view rez")


def test_a_table_in_a_pipe_is_plain_columns(capsys: pytest.CaptureFixture[str]) -> None:
    assert call("run", "fake", "--quiet") == 0 and capsys.readouterr().out == ""
    assert call("run", "fake") == 0
    lines = capsys.readouterr().out.splitlines()
    row = next(line.split() for line in lines if "hand_error_mean_odometry" in line)
    assert row[:3] == ["fake", "hand_error_mean_odometry", "mm"] and row[4:] == ["16.7", "≤", "3", "reached"]
    assert not any(ord(c) > 0x2000 and c not in "≥≤…" for c in "".join(lines)) and "\x1b" not in "".join(lines)


def test_help_shows_its_words_as_they_are() -> None:
    """What looks like markup ([s] strikes through) would vanish. Truth: rich, which prints the help."""
    from rich.markup import render
    from typer.main import get_command

    def texts(command: Any) -> Iterator[str]:
        yield command.help or ""
        yield from (getattr(p, "help", None) or "" for p in command.params)
        for inner in getattr(command, "commands", {}).values():
            yield from texts(inner)

    found = list(texts(get_command(app)))
    assert len(found) > 60
    assert [text for text in found if render(text).plain != text] == []


@pytest.mark.parametrize("command", ["render", "ros2 sim"])
def test_help_shows_no_default_that_stands_for_something_else(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """An infinite or a huge number means "to the end". Truth: what a reader takes for a time in seconds."""
    assert call(*command.split(), "--help") == 0
    said = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "[default: inf" not in said and "[default: 1000000000" not in said
    assert "default: the end of the run" in said or "default: never" in said
