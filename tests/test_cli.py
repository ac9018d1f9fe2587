"""The command line: what it prints, where it writes, its exit status, and one sentence for every bad input."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import wbmpc
from fake_experiment import REGISTRY
from wbmpc.cli import _table, app, main
from wbmpc.errors import InputError
from wbmpc.log import Log
from wbmpc.report import page
from wbmpc.result import Metric, RunResult

HERE = Path(__file__).parent


@pytest.fixture(autouse=True)
def _in_an_empty_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def call(*arguments: str) -> int:
    return main(list(arguments), REGISTRY)


def shell(*arguments: str, code: str | None = None) -> subprocess.CompletedProcess[str]:
    """A process of its own, as a user starts it."""
    paths = os.pathsep.join([str(HERE.parent / "src"), str(HERE)])
    command = [sys.executable, *(["-c", code] if code else ["-m", "wbmpc"]), *arguments]
    return subprocess.run(command, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": paths}, timeout=60)


FAKE_MAIN = (
    "import sys; from fake_experiment import REGISTRY; from wbmpc.cli import main; sys.exit(main(None, REGISTRY))"
)


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


# ---------------------------------------------------------------------- what works
def test_version_and_help_come_at_once() -> None:
    assert shell("--version").stdout.strip() == wbmpc.__version__
    start = time.perf_counter()
    out = shell("--help")
    # 0.15 s on a usual machine, 0.6 s is the goal; the heavy libraries alone would take longer than this bound
    assert time.perf_counter() - start < 2.0
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


def test_list_names_experiments_and_robots() -> None:
    out = shell("list")
    assert out.returncode == 0 and out.stderr == ""
    for name in ("swerve-track", "rezero-steps", "swerve-ur10", "swerve-fixed-ur10", "rezero"):
        assert name in out.stdout
    data = json.loads(shell("list", "--json").stdout)
    assert {e["name"] for e in data["experiments"]} >= {"swerve-track", "rezero-steps"}
    assert {"swerve-ur10", "rezero"} <= set(data["robots"])


def test_json_is_one_object_and_nothing_else(tmp_path: Path) -> None:
    out = shell("run", "fake", "--seed", "5", "--json", "--set", "mpc.rate=80", code=FAKE_MAIN)
    assert out.returncode == 0 and out.stderr == ""  # in a pipe: no progress bar
    data = json.loads(out.stdout)
    assert set(data) == {"experiment", "seed", "completed", "reason", "metrics", "mpc", "files"}
    assert (data["experiment"], data["seed"], data["completed"]) == ("fake", 5, True)
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
    assert all(part in row for part in ("fake", " m ", "0.0167", "0.003", "reached"))
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
            (capsys.readouterr().out + page(result).split("<body>")[1].split("What is idealised")[0]).split()
        )
        assert ("missed" in out) is not interrupted and ("inf" in out) is not interrupted
        assert ("not measured" in out) is interrupted and ("of all steps" in out) is not interrupted


def test_the_shell_completes() -> None:
    environment = {"_WBMPC_COMPLETE": "complete_bash", "COMP_WORDS": "wbmpc re", "COMP_CWORD": "1"}
    out = shell(code=f"import os; os.environ.update({environment!r}); from wbmpc.cli import main; main()")
    assert {"replay", "render", "reproduce"} <= set(out.stdout.split())


# ---------------------------------------------------------------------- runs that end early
def test_a_fall_is_status_1_with_its_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("run", "fake", "--set", "fall_at=2.0", "--json") == 1
    data = json.loads(capsys.readouterr().out)
    assert data["completed"] is False and data["metrics"]["fell"]["value"] == 1.0
    assert data["metrics"]["rise_time_max"]["value"] is None
    assert (tmp_path / data["files"]["metrics"]).is_file()


def test_a_fall_is_said_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    assert call("run", "fake", "--set", "fall_at=2.0") == 1
    assert "fake did not complete: the robot fell at 2.00 s" in capsys.readouterr().out


def test_an_abort_is_status_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also when the experiment has nothing to show: what it was and why it ended is on disk."""
    assert call("run", "fake", "--set", "abort=true", "--json") == 1
    data = json.loads(capsys.readouterr().out)
    assert data["completed"] is False and data["reason"] == "the solver gave up at 0.10 s"
    saved = json.loads((tmp_path / data["files"]["metrics"]).read_text())
    assert saved["settings"]["abort"] is True and saved["metrics"] == {}
    assert "the solver gave up at 0.10 s" in (tmp_path / data["files"]["report"]).read_text()


def test_ctrl_c_is_status_130_and_leaves_what_there_is(tmp_path: Path) -> None:
    out = shell("run", "fake", "--set", "interrupt=true", "--json", code=FAKE_MAIN)
    assert out.returncode == 130 and "Traceback" not in out.stderr
    data = json.loads(out.stdout)
    assert data["completed"] is False and data["reason"] == "interrupted at 0.10 s"
    assert all((tmp_path / f).is_file() for f in data["files"].values())


def test_ctrl_c_in_any_command_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also where the command itself does not catch it."""

    class Interrupting(dict):  # type: ignore[type-arg]
        def values(self) -> Any:
            raise KeyboardInterrupt

    assert main(["list"], Interrupting(REGISTRY)) == 130
    assert capsys.readouterr().err == "wbmpc: interrupted\n"


def test_an_interrupted_demo_does_not_go_on(capsys: pytest.CaptureFixture[str]) -> None:
    fake = REGISTRY["fake"]
    begun: list[str] = []

    def run(settings, seed, progress):  # type: ignore[no-untyped-def]
        begun.append("run")
        return fake.run(settings.model_copy(update={"interrupt": True}), seed, progress)

    one = SimpleNamespace(name="x", config_type=fake.config_type, run=run)
    assert main(["demo", "--json"], {"swerve-track": one, "rezero-steps": one}) == 130  # type: ignore[dict-item]
    assert begun == ["run"]


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


# ---------------------------------------------------------------------- bad input
BAD = {
    ("run", "fakee"): ["unknown experiment 'fakee'", "did you mean 'fake'", "valid: fake"],
    ("run",): ["Missing argument", "wbmpc --help"],
    ("run", "fake", "--seed", "-1"): ["--seed", "negative"],
    ("run", "fake", "--seed", "x"): ["--seed", "integer"],
    ("run", "fake", "--set", "mpc.rat=3"): ["fake: --set", "did you mean 'mpc.rate'", "valid in mpc: rate, intervals"],
    ("run", "fake", "--set", "mpc.rate=-3"): ["mpc.rate=-3", "greater than 0"],
    ("run", "fake", "--set", "mpc.intervals=0"): ["mpc.intervals=0", "greater than or equal to 1"],
    ("run", "fake", "--set", "mpc.rate=nan"): ["mpc.rate=nan", "finite"],
    ("run", "fake", "--set", "mpc.rate"): ["key=value"],
    ("run", "fake", "--out", "a-file"): ["--out: 'a-file' is a file"],
    ("run", "fake", "--out", "a-file/below"): ["a-file/below", "Not a directory"],
    ("run", "fake", "--jsn"): ["No such option: --jsn"],
    ("walk",): ["No such command 'walk'"],
    ("bench", "--repeat", "0"): ["--repeat"],
    ("bench", "--out", "a-file"): ["--out: 'a-file' is a file"],
}


@pytest.mark.parametrize("arguments", BAD, ids=" ".join)
def test_bad_input_is_one_sentence_and_status_2(
    arguments: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a-file").write_text("")
    assert call(*arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("wbmpc: ") and captured.err.count("\n") == 1
    for part in BAD[arguments]:
        assert part in captured.err
    assert "Traceback" not in captured.err and "http" not in captured.err
    assert [p.name for p in tmp_path.iterdir()] == ["a-file"]  # nothing is left behind


REAL = {
    ("run", "swerve-trak"): "did you mean 'swerve-track'",
    ("run", "swerve-track", "--set", "mpc.rat=3"): "did you mean 'mpc.rate'",
    ("run", "swerve-track", "--set", "mpc.intervals=0"): "mpc.intervals=0",
    ("run", "swerve-track", "--set", "mpc.rate=77"): "mpc.rate",
    ("run", "rezero-steps", "--set", "plant.friction=[0.9, 0.2]"): "plant.friction",
    (
        "run",
        "swerve-track",
        "--set",
        "mpc.horizon=1e13",
    ): "first_interval: 0.017 s is too short for a horizon of 1e+13 s",
    ("run", "swerve-track", "--set", "mpc.first_interval=1e-30"): "first_interval: 1e-30 s is too short",
    ("run", "swerve-track", "--set", "cost.state.arm=1e308"): "cost 'state', terminal weight of 'arm': must be finite",
    ("run", "rezero-steps", "--set", "hold=1"): "hold=1",
    ("run", "rezero-steps", "--set", "hold=2"): "hold=2: a step needs 2.3 s",
    ("run", "rezero-steps", "--set", "hold=1.5"): "a smaller mpc.horizon or preview=false needs less",
    ("run", "rezero-steps", "--set", "mpc.rate=true"): "mpc.rate=true: a number or text is needed",
}


@pytest.mark.parametrize("arguments", REAL, ids=" ".join)
def test_bad_input_of_the_real_experiments(arguments: tuple[str, ...]) -> None:
    out = shell(*arguments)
    assert out.returncode == 2 and out.stdout == ""
    assert out.stderr.startswith("wbmpc: ") and out.stderr.count("\n") == 1
    assert REAL[arguments] in out.stderr


@pytest.mark.parametrize("place", ["front", "end"])
def test_debug_shows_the_traceback(place: str) -> None:
    arguments = ["run", "nope"]
    out = shell(*(["--debug", *arguments] if place == "front" else [*arguments, "--debug"]))
    assert out.returncode == 2
    assert "Traceback" in out.stderr and "InputError" in out.stderr
    assert out.stderr.splitlines()[-1].startswith("wbmpc: unknown experiment 'nope'")


def test_a_failed_run_leaves_a_given_directory_alone(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    assert call("run", "fake", "--out", "mine", "--set", "mpc.rate=-1") == 2
    assert (tmp_path / "mine").is_dir()


@pytest.mark.parametrize(
    "arguments, status", [(("list",), 0), (("run", "fake"), 0), (("run", "fake", "--set", "fall_at=2"), 1)]
)
@pytest.mark.parametrize("stream", [1, 2])
def test_a_reader_who_leaves_changes_nothing(
    stream: int, arguments: tuple[str, ...], status: int, tmp_path: Path
) -> None:
    """As ``| head`` does: the status is the command's own, its files are there, and nothing is said."""
    code = f"import os; r, w = os.pipe(); os.close(r); os.dup2(w, {stream}); " + FAKE_MAIN
    out = shell("--verbose", *arguments, code=code)
    assert out.returncode == status
    assert "Traceback" not in out.stderr + out.stdout and "BrokenPipe" not in out.stderr + out.stdout
    assert len(list(tmp_path.glob("runs/fake-seed200/*"))) == (0 if "list" in arguments else 3)


def test_ctrl_c_within_compiled_code_is_no_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """CasADi and NumPy, called back, report KeyboardInterrupt as the cause of a SystemError."""

    def pressed(*_: object) -> None:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise SystemError("returned a result with an exception set") from error

    monkeypatch.setattr("wbmpc.robots.available_robots", pressed)
    assert call("list") == 130
    assert capsys.readouterr().err == "wbmpc: interrupted\n"


def test_an_error_of_the_program_itself_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError

    broken_one = SimpleNamespace(name="broken", config_type=REGISTRY["fake"].config_type, run=broken)
    with pytest.raises(ZeroDivisionError):
        main(["run", "broken"], {"broken": broken_one})  # type: ignore[dict-item]


# ---------------------------------------------------------------------- the other commands
def test_demo_runs_both_and_prints_one_table(capsys: pytest.CaptureFixture[str]) -> None:
    both = {"swerve-track": REGISTRY["fake"], "rezero-steps": REGISTRY["fake"]}
    assert main(["demo"], both) == 0
    captured = capsys.readouterr()
    assert captured.out.count("paper") == 1  # the header of one table
    assert (
        "runs/swerve-track-seed200/report.html" in captured.out
        and "runs/rezero-steps-seed200/report.html" in captured.out
    )
    assert main(["demo", "--json"], both) == 0
    captured = capsys.readouterr()
    assert captured.err == "" and len(json.loads(captured.out)["runs"]) == 2


def test_bench_prints_one_object(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    import wbmpc.benchmark as benchmark

    def fake(repeat: int, progress: Any, peers: bool) -> dict[str, Any]:
        progress(0.5, "half")
        return {"rows": [], "repeat": repeat, "peers": peers}

    monkeypatch.setattr(benchmark, "run_benchmark", fake)
    assert call("bench", "--json") == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out) == {"rows": [], "repeat": 200, "peers": False} and captured.err == ""
    assert call("bench", "--json", "--peers", "--repeat", "7") == 0
    assert json.loads(capsys.readouterr().out) == {"rows": [], "repeat": 7, "peers": True}


def test_the_commands_are_the_documented_ones() -> None:
    from typer.testing import CliRunner

    out = CliRunner().invoke(app, ["run", "--help"])
    assert out.exit_code == 0
    assert all(option in out.stdout for option in ("--seed", "--set", "--out", "--json"))


def test_sigterm_is_ctrl_c_from_another_process(tmp_path: Path) -> None:
    """A service manager ends a run: its files are written, and the status says by what it was ended."""
    run = [sys.executable, "-m", "wbmpc", "run", "rezero-steps", "--out", str(tmp_path / "a"), "--json"]
    process = subprocess.Popen(run, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60.0
    while not (tmp_path / "a" / "run.mcap").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    process.terminate()
    out, err = process.communicate(timeout=60)
    data = json.loads(out)
    assert process.returncode == 143 and err == ""
    assert data["completed"] is False and data["reason"].startswith("interrupted at ")
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["log.npz", "metrics.json", "report.html", "run.mcap"]
    # where no run goes on, it ends the command
    code = "import os, signal; from wbmpc.cli.terminal import terminable\nwith terminable() as t:\n  try: os.kill(os.getpid(), 15)"
    code += "\n  except KeyboardInterrupt: print(t.came, signal.getsignal(15) is t)"
    assert shell(code=code).stdout == "True True\n"


def test_the_shell_completes_commands_and_names() -> None:
    ask = lambda words: subprocess.run(
        [sys.executable, "-m", "wbmpc"], capture_output=True, text=True, timeout=60,
        env={
            **os.environ, "PYTHONPATH": str(HERE.parent / "src"), "_WBMPC_COMPLETE": "complete_bash", "COMP_WORDS": words,
            "COMP_CWORD": str(len(words.split()) - 1),
        },
    ).stdout.split()  # fmt: skip
    assert ask("wbmpc rep") == ["replay", "reproduce"]
    assert "swerve-track" in ask("wbmpc run swerve-t") and "rezero" in ask("wbmpc view rez")


def test_a_table_in_a_pipe_is_plain_columns() -> None:
    out = shell("run", "fake", "--quiet", code=FAKE_MAIN).stdout
    assert out == ""
    lines = shell("run", "fake", code=FAKE_MAIN).stdout.splitlines()
    row = next(line.split() for line in lines if "hand_error_mean_odometry" in line)
    assert row[:3] == ["fake", "hand_error_mean_odometry", "m"] and row[4:] == ["0.0167", "0.003", "reached"]
    assert not any(ord(c) > 0x2000 and c not in "≥…" for c in "".join(lines)) and "\x1b" not in "".join(lines)


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


def test_a_picture_before_the_start_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["render", str(tmp_path), "--png", str(tmp_path / "a.png"), "--start", "-5"]) == 2
    assert capsys.readouterr().err == "wbmpc: --start: must not be negative, got -5\n"
