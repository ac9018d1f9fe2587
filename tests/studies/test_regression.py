"""The comparison of recorded metrics: to the last digit, missing ones included."""

from __future__ import annotations

import importlib.util
import json
import math
import tomllib
from pathlib import Path

import pytest

from configured import check_taken

_spec = importlib.util.spec_from_file_location("regression", Path(__file__).parents[2] / "scripts" / "regression.py")
assert _spec is not None and _spec.loader is not None
regression = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(regression)
FAST, differences, key, main = regression.FAST, regression.differences, regression.key, regression.main

RUN = {
    "exit": 0,
    "completed": True,
    "reason": "",
    "metrics": {"error": 0.1, "time": 2.0, "ratio": math.nan, "worst": None},
}


def changed(**metrics: float | None) -> dict[str, object]:
    return {**RUN, "metrics": {**RUN["metrics"], **metrics}}  # type: ignore[dict-item]


def test_the_same_is_the_same_not_a_number_included() -> None:
    assert differences(RUN, json.loads(json.dumps(RUN))) == []


def test_one_unit_in_the_last_place_differs() -> None:
    following = math.nextafter(0.1, 1.0)
    assert differences(RUN, changed(error=following)) == [f"error: 0.1 -> {following!r}"]


def test_what_is_missing_new_or_no_number_any_more_differs() -> None:
    fewer = {**RUN, "metrics": {n: v for n, v in RUN["metrics"].items() if n != "time"}}  # type: ignore[attr-defined]
    assert differences(RUN, fewer) == ["time: 2.0 -> None"]
    assert differences(fewer, RUN) == ["time: None -> 2.0"]
    assert differences(RUN, changed(ratio=1.0)) == ["ratio: nan -> 1.0"]


def test_an_outcome_differs_before_its_metrics() -> None:
    fell = {"exit": 1, "completed": False, "reason": "the robot fell", "metrics": {}}
    assert [line.split(":")[0] for line in differences(RUN, fell)][:3] == ["exit", "completed", "reason"]


@pytest.mark.parametrize(("name", "settings"), regression.all_cases())
def test_every_case_is_one_that_can_be_run(name: str, settings: tuple[str, ...]) -> None:
    check_taken(name, settings)


def test_every_experiment_has_a_case_with_its_defaults() -> None:
    """Truth: the entry points of the distribution."""
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    offered = set(project["entry-points"]["wbmpc.experiments"])
    assert offered <= {name for name, settings in regression.all_cases() if not settings}
    assert len(set(regression.all_cases())) == len(regression.all_cases())


def test_recording_goes_on_and_comparing_finds_what_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Recorded cases are not run again; the exit status says whether something differs."""
    file, runs, now = tmp_path / "metrics.json", list[str](), dict(RUN)

    def run(name: str, settings: tuple[str, ...], seed: int) -> dict[str, object]:
        runs.append(key(name, settings, seed))
        return now

    monkeypatch.setattr(regression, "run", run)
    monkeypatch.setattr(regression, "commit", lambda: "0123456789")
    assert main(["record", str(file), "--fast", "--seeds", "0"]) == 0 and len(runs) == len(FAST)
    assert main(["record", str(file), "--fast", "--seeds", "0", "1"]) == 0
    assert len(runs) == len(set(runs)) == 2 * len(FAST)
    assert json.loads(file.read_text())["begun"]["commit"] == "0123456789"
    monkeypatch.setattr(regression, "commit", lambda: "of a later one")
    assert main(["compare", str(file), "--fast"]) == 0
    assert "compared with commit 0123456789, recorded on 20" in capsys.readouterr().out
    now = changed(error=0.25)
    capsys.readouterr()
    assert main(["compare", str(file), "--only", "rezero-circle", "--seeds", "0"]) == 1
    assert "error: 0.1 -> 0.25" in capsys.readouterr().out
