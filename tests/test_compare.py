"""`wbmpc compare`. Truth: the two runs' own files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fake_experiment import REGISTRY
from wbmpc.cli import main
from wbmpc.compare import overlay, wheels


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


def test_curves_have_names_and_the_runs_the_same_colours() -> None:
    rng = np.random.default_rng(1)
    log = {}
    for channel, width in (("tour.base_odometry", 3), ("hand", 3), ("leg", 4), ("other", 2)):
        log |= {channel: rng.normal(size=(5, width)), f"{channel}.time": np.arange(5.0)}
    modules = wheels({"settings": {"robot": "swerve-ur10"}})
    plots = {p.title: p.series for p in overlay([log, log], ["a", "b"], modules)}
    names = {title: [s.name for s in series if not s.dashed] for title, series in plots.items()}
    assert names["tour.base_odometry"] == ["a x", "a y", "a yaw"] and names["hand"] == ["a x", "a y", "a z"]
    assert names["leg"] == [f"a {wheel}" for wheel in ("LF", "RF", "LB", "RB")] and names["other"] == ["a [0]", "a [1]"]
    for series in plots.values():
        half = len(series) // 2
        assert [s.colour for s in series[:half]] == [s.colour for s in series[half:]] == list(range(half))
        assert all(s.dashed for s in series[half:])
    assert wheels({"settings": {"robot": "nowhere.yaml"}}) == wheels({}) == ()
