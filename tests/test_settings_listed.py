"""What ``run --settings`` lists. Truth: the file and the assignments as written."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from wbmpc.cli import main


def listed(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, str]:
    assert main(["run", "hold", "--settings", "--json", *words]) == 0
    return {row["key"]: row["default"].strip("`") for row in json.loads(capsys.readouterr().out)["settings"]}


def test_values_are_those_of_file_and_assignments(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("mpc: {rate: 25.0, horizon: 1.5}\n")
    before, after = listed(capsys), listed(capsys, "--config", str(file), "--set", "mpc.rate=40.0")
    assert {k: (before[k], v) for k, v in after.items() if v != before[k]} == {
        "mpc.rate": (before["mpc.rate"], "40.0"),
        "mpc.horizon": (before["mpc.horizon"], "1.5"),
    }


@pytest.mark.parametrize(
    ("words", "says"),
    [(["--config", "missing.yaml"], "missing.yaml"), (["--set", "mpc.rates=3"], "did you mean 'mpc.rate'")],
)
def test_what_cannot_be_meant_is_an_error(words: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "hold", "--settings", *words]) == 2
    assert says in capsys.readouterr().err
