"""What ``run --settings`` lists. Truth: the file and the assignments as written."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import BaseModel

from wbmpc.cli import main
from wbmpc.registry import REGISTRY


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


def leaves(settings: BaseModel, prefix: str) -> Iterator[tuple[str, Any]]:
    """Keys and values that no choice inside of the settings has."""
    for name, value in settings:
        if not isinstance(value, BaseModel):
            yield from () if name == "kind" else ((f"{prefix}.{name}", value),)
        elif not hasattr(value, "kind"):
            yield from leaves(value, f"{prefix}.{name}")


def test_keys_of_every_choice_are_listed_with_it(capsys: pytest.CaptureFixture[str]) -> None:
    """Truth: the fields of the controllers' models, and their defaults."""
    assert main(["run", "rezero-steps", "--settings", "--json"]) == 0
    found = [
        (row["key"], kind, row["default"].strip("`"))
        for row in json.loads(capsys.readouterr().out)["settings"]
        for kind in row["choice"].removeprefix("controller=").split(", ")
    ]
    for model in get_args(REGISTRY["rezero-steps"].config_type.model_fields["controller"].annotation):
        for kind in get_args(model.model_fields["kind"].annotation):
            values = dict(leaves(model(), "controller"))
            assert values and {(k, kind, str(v)) for k, v in values.items()} <= set(found)
    assert ("controller.tracking.wheel_damping", "controller.tracking=actuators", "0.02") in found


def test_values_of_the_choice_that_is_made_are_listed_last(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["run", "rezero-steps", "--settings", "--set", "controller=lqr", "--set", "controller.end_effector=0.25"]
    assert main([*words, "--json"]) == 0
    rows = [r for r in json.loads(capsys.readouterr().out)["settings"] if r["key"] == "controller.end_effector"]
    assert [(r["choice"], r["default"]) for r in rows[-2:]] == [
        ("controller=taskspace", "`5.02`"), ("controller=lqr, scheduled-lqr", "`0.25`"),
    ]  # fmt: skip
    assert main(words) == 0
    shown = capsys.readouterr().out
    assert "controller=taskspace" in shown and "controller=lqr, scheduled-lqr" in " ".join(shown.split())
