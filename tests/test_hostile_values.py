"""Numbers and names that no program should take, or print as they are. Truth: ISO/IEC 6429 (control sequences), Unicode's categories,
the ZIP format (names of members need not differ), sizes of robots."""

from __future__ import annotations

import json
import subprocess
import unicodedata
import zipfile
from pathlib import Path

import numpy as np
import pytest

from test_public_api import RAIL
from wbmpc import checks
from wbmpc.cli import main
from wbmpc.configuration import configure
from wbmpc.errors import InputError, NotFinite, RunAborted, printable, unknown_name
from wbmpc.recording.messages import encode, fields
from wbmpc.recording.writer import McapFile
from wbmpc.registry import REGISTRY
from wbmpc.robots import load_description
from wbmpc.robots.description import DATA
from wbmpc.run_files import read_log
from wbmpc.settings import MpcSettings, Settings, Weight
from wbmpc.yaml_file import parse_yaml

ODD = "\x1b[2J\x1b]0;x\x07\u202e\u2028\x9b31m"


class Cost(Settings):
    weight: Weight = 1.0
    start: str = "home"


@pytest.mark.parametrize("hidden", ["\ufeff", "\u0085", "\u2028", "\u2029"])
def test_characters_that_nobody_sees_are_no_part_of_a_number(hidden: str) -> None:
    for text in (f"{hidden}1", f"1{hidden}"):
        with pytest.raises(InputError, match=f"U\\+{ord(hidden):04X} is a character that cannot be printed"):
            configure(Cost, [f"weight={text}"], "run")


@pytest.mark.parametrize("text", ["\u0661\u0662", "\uff11", "'\u0661'", "-\u0663.5", "[1, \u0967]"])
def test_digits_of_other_scripts_are_no_numbers(text: str) -> None:
    assert any(unicodedata.category(c) == "Nd" and not c.isascii() for c in text)
    with pytest.raises(InputError, match="in other digits than 0 to 9"):
        configure(MpcSettings, [f"horizon={text}"], "toy")


def test_words_of_other_scripts_are_words() -> None:
    assert parse_yaml("a: r\u00e9sum\u00e9 \u0661x", "toy") == {"a": "r\u00e9sum\u00e9 \u0661x"}


@pytest.mark.parametrize(
    "text", ["1e300", "-1e300", "[1e13]", "{a: 1e300}", "1" + "0" * 40, "'1e300'", ".inf", "nan", "[[.nan]]"]
)
def test_numbers_that_no_robot_has_are_an_error_whatever_the_key(text: str) -> None:
    with pytest.raises(InputError, match="must be a finite number, at most"):
        configure(Cost, [f"start={text}"], "toy")


def test_large_numbers_are_finite() -> None:
    """Truth: IEEE 754: each of these is a number, though their sum is none."""
    large = np.full(2, 1.7e308)
    assert checks.numbers("robot", "x", large, 2) is large
    for wrong in (np.inf, np.nan):
        with pytest.raises(NotFinite, match="'x' needs 2 finite numbers"):
            checks.numbers("robot", "x", np.array([1.0, wrong]), 2)


def test_weights_are_bounded() -> None:
    assert configure(Cost, ["weight=1e9"], "toy").weight == 1e9
    with pytest.raises(InputError, match="weight"):
        configure(Cost, ["weight=1e10"], "toy")


def test_what_steers_a_terminal_is_written_out() -> None:
    shown = printable(ODD + "\u00e9\n")
    assert shown == "\\x1b[2J\\x1b]0;x\\x07\\u202e\\u2028\\x9b31m\u00e9\\n"
    assert all(unicodedata.category(c)[0] != "C" for c in shown)


def test_every_message_of_an_error_prints_safely() -> None:
    """Quoted by us, by a library that we quote, or in a list of what is valid."""
    for error in (InputError(f"a: {ODD}"), unknown_name(f"{ODD}\n", f"{ODD}\n", [ODD], where=ODD), RunAborted(ODD)):
        assert all(c.isprintable() or c == "\n" for c in str(error))
        assert "\\x1b[2J" in str(error)
    assert str(unknown_name("key", "a\nwbmpc: all is well", ["b"])) == "unknown key 'a\\nwbmpc: all is well'; valid: b"


def test_names_of_files_and_topics_do_not_steer_the_terminal(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.mcap"
    file = McapFile(path)
    file.metadata("run", {"experiment": ODD, "seed": 1, "started": ODD})
    text = encode("std_msgs/String", {"data": "x"}, lookup=fields, missing={})
    file.put_bytes(f"/{ODD}", "std_msgs/String", 0.0, text)
    file.metadata("result", {"completed": "false", "reason": ODD})
    file.close()
    assert main(["log", "info", str(path)]) == 0
    assert main(["log", "info", f"{tmp_path}/{ODD}.mcap"]) == 2
    said = capfd.readouterr()
    assert said.out.count("\\x1b[2J") == 4 and "\\x1b[2J" in said.err
    assert not {c for c in said.out + said.err if not c.isprintable()} - {"\n"}


def test_two_arrays_of_one_name_are_an_error(tmp_path: Path) -> None:
    np.save(tmp_path / "x.npy", np.zeros(3))
    with zipfile.ZipFile(tmp_path / "log.npz", "w") as archive, pytest.warns(UserWarning, match="Duplicate name"):
        archive.write(tmp_path / "x.npy", "x.npy")
        archive.write(tmp_path / "x.npy", "x.npy")
    with pytest.raises(InputError, match=r"log\.npz: two of its arrays have one name"):
        read_log(tmp_path / "log.npz")


@pytest.mark.parametrize("name", ["''", "x" * 101])
def test_names_of_robots_are_short_and_not_empty(name: str, tmp_path: Path) -> None:
    text = (DATA / "swerve-ur10.yaml").read_text().splitlines()
    text = [f"name: {name}" if line.startswith("name:") else line for line in text]
    (tmp_path / "robot.yaml").write_text("\n".join(text))
    with pytest.raises(InputError, match="key 'name'"):
        load_description(tmp_path / "robot.yaml")


def test_the_limit_of_a_recording_that_is_not_made_is_an_error(capfd: pytest.CaptureFixture[str]) -> None:
    for given, says in (
        ("5MB", "nothing is recorded without --out DIRECTORY"),
        ("much", "a size from 1MB on is needed"),
    ):
        assert main(["view", "swerve-ur10", "--record-limit", given]) == 2
        assert f"--record-limit: {'' if given == '5MB' else repr(given) + ': '}{says}" in capfd.readouterr().err


def test_the_limit_reaches_the_recording_of_a_view(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("viser")
    from wbmpc.simulation.lockstep import Ending
    from wbmpc.view import session

    limits = []

    def run(robot: str, seed: int, view: object, *recorders: object) -> Ending:
        limits.extend(recorder.limit for recorder in recorders)  # type: ignore[attr-defined]
        return Ending("ended in the view", interrupted=True)

    monkeypatch.setattr(session, "run_session", run)
    assert main(["view", "swerve-ur10", "--out", str(tmp_path), "--record-limit", "3MB"]) == 0
    assert limits == [3_000_000]


def test_metrics_with_odd_names_are_printed_safely(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        metrics = {ODD: {"value": 1.0, "unit": ODD}}
        (tmp_path / name / "metrics.json").write_text(
            json.dumps({"experiment": name, "settings": {}, "metrics": metrics})
        )
        np.savez(tmp_path / name / "log.npz", x=np.zeros(2), **{"x.time": np.arange(2.0)})
    given = ["compare", str(tmp_path / "a"), str(tmp_path / "b"), "--out", str(tmp_path / "page.html")]
    assert main(given) == 0
    said = capfd.readouterr()
    assert "\x1b" not in said.out + said.err and "\u202e" not in said.out + said.err


@pytest.mark.parametrize("value", ["[a]", "{a: 1}", "[[]]", "5", "~"])
@pytest.mark.parametrize("more", [(), ("controller.tracking.x=1",), ("controller.tracking=[a]",)])
def test_a_kind_that_is_no_text_is_an_error(value: str, more: tuple[str, ...]) -> None:
    """Before it is looked up in a table."""
    settings = REGISTRY["rezero-push-ball"].config_type
    with pytest.raises(InputError, match="tracking"):
        configure(settings, [f"controller.tracking.kind={value}", *more], "rezero-push-ball")


@pytest.mark.parametrize("name", ["two words", "-dash", "--help", "$(touch made)", "a; touch made #", "it's"])
def test_commands_to_paste_have_names_of_files_as_one_word(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Truth: what the shell takes for the words."""
    monkeypatch.chdir(tmp_path)
    Path(f"{name}.xml").write_text(RAIL)
    assert main(["new", "--yes", "--", f"{name}.xml"]) == 0
    pasted = [line.partition("next: ")[2] or line for line in capsys.readouterr().out.splitlines()[-2:]]
    for line, command in zip(pasted, ("doctor", "view"), strict=True):
        shell = f'wbmpc() {{ printf "%s\\n" "$@"; }}; {line.partition(": 0 errors")[0]}'
        said = subprocess.run(["sh", "-c", shell], capture_output=True, text=True, check=True).stdout.splitlines()
        assert said[0] == command and len(said) == 2
        assert Path(said[1]).is_file() and not said[1].startswith("-")
    assert not Path("made").exists()
