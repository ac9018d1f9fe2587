"""`wbmpc compare`. Truth: the two runs' own files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fake_experiment import REGISTRY
from wbmpc.cli import main


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> list[dict]:  # type: ignore[type-arg]
    monkeypatch.chdir(tmp_path)
    assert main(["run", "fake", "--seed", "1", "--out", "a", "--json"], REGISTRY) == 0
    assert main(["run", "fake", "--seed", "2", "--out", "b", "--set", "mpc.rate=80", "--json"], REGISTRY) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_metrics_and_settings(runs: list[dict], capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[type-arg]
    assert main(["compare", "a", "b", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    rows = {row["metric"]: row for row in data["metrics"]}
    assert set(rows) == set(runs[0]["metrics"])
    for name, row in rows.items():
        assert row["values"] == [r["metrics"][name]["value"] for r in runs]
    a, b = rows["hand_error_mean_odometry"]["values"]
    assert rows["hand_error_mean_odometry"]["change"] == pytest.approx(b / a - 1.0)
    assert rows["fell"]["change"] is None  # nothing to divide by
    assert data["settings"] == {"seed": [1, 2], "mpc.rate": [50.0, 80.0]}


def test_table_and_page(runs: list[dict], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[type-arg]
    assert main(["compare", "a", "b", "--out", "both.html"]) == 0
    out = capsys.readouterr().out
    assert (
        "mpc.rate: 50.0 and 80.0" in out and "hand_error_mean_odometry" in out and "the signals are in both.html" in out
    )
    page = (tmp_path / "both.html").read_text()
    body = page[page.index("<body>") :]
    assert body.count("Plotly.newPlot") == 2 and "<h3>hand</h3>" in body and '"dash":"dash"' in body.replace(" ", "")


def test_quiet_says_nothing(runs: list[dict], capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[type-arg]
    assert main(["compare", "a", "b", "--quiet"]) == 0
    assert capsys.readouterr().out == "" and Path("compare.html").is_file()


def test_what_is_no_run_is_said(runs: list[dict], capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[type-arg]
    assert main(["compare", "a", "nowhere"]) == 2
    assert capsys.readouterr().err == "wbmpc: nowhere: is not the directory of a run: there is no metrics.json\n"
    Path("b/metrics.json").write_text("{")
    assert main(["compare", "a", "b"]) == 2
    assert "metrics.json or log.npz cannot be read" in capsys.readouterr().err
