"""The command line when something goes wrong: its exit status, what is left, and one message for every bad input."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import CodeType, SimpleNamespace
from typing import Any

import casadi
import pytest

from command_line import FAKE_MAIN, call, shell
from effort import some
from fake_experiment import REGISTRY
from wbmpc.cli import main
from wbmpc.errors import WbmpcError
from wbmpc.interrupts import ended_by_signal, terminable
from wbmpc.recording.reader import read_recording
from wbmpc.report import files
from wbmpc.result import RunResult

pytestmark = pytest.mark.usefixtures("empty_directory")


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


def test_ctrl_c_in_any_command_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also where the command itself does not catch it."""

    class Interrupting(dict):  # type: ignore[type-arg]
        def __getitem__(self, name: str) -> Any:
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


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_while_files_are_written_waits_for_them(
    number: int, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """All files that metrics.json names are there; a second signal ends the writing, and then no metrics.json says that the
    run is complete."""
    page = files.page

    def interrupted(result: RunResult, times: int = 1) -> str:
        for _ in range(times):
            os.kill(os.getpid(), number)
        return page(result)

    monkeypatch.setattr(files, "page", interrupted)
    assert call("run", "fake", "--out", str(tmp_path / "a")) == status
    assert capsys.readouterr().err == "wbmpc: interrupted\n"
    said = json.loads((tmp_path / "a" / "metrics.json").read_text())
    assert said["completed"] is True and {Path(f).name for f in said["files"].values()} == {
        p.name for p in (tmp_path / "a").iterdir()
    }
    monkeypatch.setattr(files, "page", lambda result: interrupted(result, 2))
    assert call("run", "fake", "--out", str(tmp_path / "b")) == status
    assert not (tmp_path / "b" / "metrics.json").exists()


def goes_on(path: Path) -> bool:
    """Whether time has passed in the run that is recorded there."""
    with suppress(WbmpcError, OSError):
        recording = read_recording(path)
        return recording.end > recording.start
    return False


def test_sigterm_is_ctrl_c_from_another_process(tmp_path: Path) -> None:
    """A service manager ends a run: its files are written, and the status says by what it was ended."""
    run = [sys.executable, "-m", "wbmpc", "run", "hold", "--set", "robot=ur5", "--out", str(tmp_path / "a"), "--json"]
    process = subprocess.Popen(run, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 300.0
    # the file is there before the run has begun
    while not goes_on(tmp_path / "a" / "run.mcap") and time.monotonic() < deadline:
        time.sleep(0.1)
    process.terminate()
    out, err = process.communicate(timeout=300)
    data = json.loads(out)
    assert process.returncode == 143 and err == ""
    assert data["completed"] is False and data["reason"].startswith("interrupted at ")
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["log.npz", "metrics.json", "report.html", "run.mcap"]
    # where no run goes on, it ends the command
    for number, status in ((signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)):
        with terminable():
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), number)
            assert ended_by_signal() == status
        assert ended_by_signal() == 0


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
    ("run", "fake", "--out", ""): ["an argument after '--out' is empty"],
    ("run", "fake", "--out="): ["--out: its value is empty"],
    ("runs", " "): ["an argument after 'runs' is empty"],
    ("view", "rezero", "--host", ""): ["an argument after '--host' is empty"],
    ("export", "mpc.py", "--out", ""): ["an argument after '--out' is empty"],
    ("run", "fake", "--jsn"): ["No such option: --jsn"],
    ("walk",): ["No such command 'walk'"],
    ("bench", "--repeat", "0"): ["--repeat"],
    ("bench", "--out", "a-file"): ["--out: 'a-file' is a file"],
}


@pytest.mark.parametrize("arguments", BAD, ids=" ".join)
def test_bad_input_is_one_message_and_status_2(
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
        "mpc.horizon=1e12",
    ): "mpc.horizon=1000000000000.0: input should be less than or equal to 1000",
    ("run", "swerve-track", "--set", "mpc.first_interval=1e-30"): "first_interval: 1e-30 s is too short",
    ("run", "swerve-track", "--set", "cost.state.arm=1e308"): "cost.state.arm=1e308: the value must be a finite number",
    ("run", "rezero-steps", "--set", "hold_time=1"): "hold_time=1",
    ("run", "rezero-steps", "--set", "hold_time=2", "--set", "preview=true"): "hold_time=2: a step needs 2.3 s",
    (
        "run",
        "rezero-steps",
        "--set",
        "hold_time=1.5",
        "--set",
        "preview=true",
    ): "a smaller controller.plan.horizon or preview=false needs less",
    ("run", "rezero-steps", "--set", "mpc.rate=true"): "mpc.rate=true: a number or text is needed",
}


@pytest.mark.parametrize("arguments", REAL, ids=" ".join)
def test_bad_input_of_the_real_experiments(arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(list(arguments)) == 2
    out = capsys.readouterr()
    assert out.out == "" and out.err.startswith("wbmpc: ") and out.err.count("\n") == 1
    assert REAL[arguments] in out.err


def test_bad_input_in_a_process_of_its_own() -> None:
    """As a user starts it: the registry is the installed one, and nothing but the message is printed."""
    out = shell("run", "swerve-track", "--set", "mpc.rate=77")
    assert out.returncode == 2 and out.stdout == ""
    assert out.stderr.startswith("wbmpc: ") and out.stderr.count("\n") == 1 and "mpc.rate" in out.stderr


@pytest.mark.parametrize("place", ["front", "end"])
def test_debug_shows_the_traceback(place: str, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["run", "nope"]
    assert call(*(["--debug", *arguments] if place == "front" else [*arguments, "--debug"])) == 2
    err = capsys.readouterr().err
    assert "Traceback" in err and "InputError" in err
    assert err.splitlines()[-1].startswith("wbmpc: unknown experiment 'nope'")


def test_a_failed_run_leaves_a_given_directory_alone(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    assert call("run", "fake", "--out", "mine", "--set", "mpc.rate=-1") == 2
    assert (tmp_path / "mine").is_dir()


@pytest.mark.parametrize(
    ("stream", "arguments", "status"),
    some([(1, ("list",), 0), (2, ("run", "fake"), 0), (1, ("run", "fake", "--set", "fall_at=2"), 1)], [1, 2]),
)
def test_a_reader_who_leaves_changes_nothing(
    stream: int, arguments: tuple[str, ...], status: int, tmp_path: Path
) -> None:
    """As ``| head`` does: the status is the command's own, its files are there, and nothing is said."""
    code = f"import os; r, w = os.pipe(); os.close(r); os.dup2(w, {stream}); " + FAKE_MAIN
    out = shell("--verbose", *arguments, code=code)
    assert out.returncode == status
    assert "Traceback" not in out.stderr + out.stdout and "BrokenPipe" not in out.stderr + out.stdout
    assert len(list(tmp_path.glob("runs/fake-seed200/*"))) == (0 if "list" in arguments else 3)


@pytest.mark.parametrize("stream", some([(0, "stdin"), (1, "stdout"), (2, "stderr")], [1]))
def test_closed_streams_change_nothing(stream: tuple[int, str], tmp_path: Path) -> None:
    """As ``>&-`` does, for which Python has None: the status is the command's own, and its files are there."""
    code = f"import os, sys; os.close({stream[0]}); sys.{stream[1]} = None; " + FAKE_MAIN
    out = shell("run", "fake", code=code)
    assert out.returncode == 0 and "Traceback" not in out.stderr
    assert len(list(tmp_path.glob("runs/fake-seed200/*"))) == 3


def test_characters_that_a_stream_does_not_have_are_written_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of a terminal without UTF-8, after a run that had completed: its table has a ≤."""
    narrow = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", narrow)
    assert call("run", "fake") == 0
    assert b"\\u2264 3" in narrow.buffer.getvalue()  # type: ignore[attr-defined]


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


def test_a_picture_before_the_start_is_rejected(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["render", str(tmp_path), "--png", str(tmp_path / "a.png"), "--start", "-5"]) == 2
    assert capsys.readouterr().err == "wbmpc: --start: must not be negative, got -5\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_not_lost_in_casadi(number: int) -> None:
    """CasADi calls ``__DM__`` of what it is given, and drops what that raises. Truth: what comes after it is never reached."""

    class Odd:
        def __DM__(self) -> casadi.DM:
            os.kill(os.getpid(), number)
            return casadi.DM(1.0)

    with terminable():
        with pytest.raises(KeyboardInterrupt):
            casadi.DM(Odd())
            signal.sigtimedwait([], 60.0)  # it comes in here
        assert ended_by_signal() == 128 + number
    assert signal.getsignal(signal.SIGALRM) is signal.SIG_DFL
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


START = """
import signal, sys
import wbmpc.__main__ as command
assert "wbmpc.cli" not in sys.modules
class Finder:
    def find_spec(self, name, *_):
        if name == "wbmpc.cli":
            {what}
sys.meta_path.insert(0, Finder())
sys.exit(command.main())
"""


def test_ctrl_c_before_the_command_line_is_loaded_is_one_message() -> None:
    run = subprocess.run(
        [sys.executable, "-c", START.format(what="raise KeyboardInterrupt")], capture_output=True, text=True
    )
    assert (run.returncode, run.stdout, run.stderr) == (130, "", "wbmpc: interrupted\n")


#: What Python calls while it clears up: a callback of a weak reference, and __del__.
CLEARED = {
    "weak reference": """
            import signal, weakref
            thing = type("Thing", (), {})()
            gone = weakref.ref(thing, lambda _: signal.raise_signal(NUMBER))
            del thing""",
    "__del__": """
            import signal
            type("Thing", (), {"__del__": lambda self: signal.raise_signal(NUMBER)})()""",
}


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
@pytest.mark.parametrize("how", CLEARED)
def test_a_signal_is_not_lost_where_python_drops_its_exception(how: str, number: int, status: int) -> None:
    """While the command line is loaded, and in what it calls. Truth: Python's documents: exceptions there are ignored."""
    what = CLEARED[how].replace("NUMBER", str(int(number))).lstrip()
    run = subprocess.run([sys.executable, "-c", START.format(what=what), "list"], capture_output=True, text=True)
    assert (run.returncode, run.stdout, run.stderr) == (status, "", "wbmpc: interrupted\n")


def test_the_status_of_an_interrupt_is_kept() -> None:
    """Python ends by SIGINT, whatever the status, once an interrupt came in code that it made of a text (dataclasses are)."""
    program = """
import sys, types
import wbmpc.__main__ as command
def interrupted():
    try:
        exec("raise KeyboardInterrupt")
    except KeyboardInterrupt:
        return 143
sys.modules["wbmpc.cli"] = types.SimpleNamespace(main=interrupted)
sys.exit(command.main())
"""
    assert subprocess.run([sys.executable, "-c", program]).returncode == 143


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("library", ["casadi.py", "trimesh/nsphere.py"])
def test_a_request_to_end_is_not_lost_in_a_library_that_drops_it(library: str, number: int, tmp_path: Path) -> None:
    """Truth: the signal comes inside of a handler for every exception, and the program goes on after it until it is interrupted."""
    with terminable(), pytest.raises(KeyboardInterrupt):
        exec(dropping(library, tmp_path), {"signal": signal, "number": number})
        signal.sigtimedwait([], 60.0)  # it comes in here


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_command_that_ends_before_a_dropped_signal_acts_was_interrupted(
    number: int, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The signal is the last thing that happens, inside of a library that drops it. Truth: the status of Ctrl-C."""
    monkeypatch.setattr("wbmpc.interrupts._AGAIN", 60.0)  # the command ends first

    def last(*_: object, **__: object) -> None:
        exec(dropping("trimesh/nsphere.py", tmp_path), {"signal": signal, "number": number})

    monkeypatch.setattr("wbmpc.cli._command_line", lambda: last)
    assert main(["list"]) == status
    assert capsys.readouterr().err == "wbmpc: interrupted\n"
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0.0


def dropping(library: str, folder: Path) -> CodeType:
    """Code of a library that sends a signal to itself and drops every exception."""
    text = "try:\n    signal.raise_signal(number)\nexcept BaseException:\n    pass\n"
    return compile(text, str(folder / library), "exec")
