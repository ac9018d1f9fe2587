"""`wbmpc compare`. Truth: the runs' own files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fake_experiment import REGISTRY
from wbmpc.cli import main
from wbmpc.compare import difference_text, load, overlay
from wbmpc.errors import InputError
from wbmpc.log import Log
from wbmpc.plots.figures import plotly_figure
from wbmpc.recording.writer import McapFile
from wbmpc.report import plots_page
from wbmpc.result import Plot
from wbmpc.run_files import read_log
from wbmpc.units import Scale


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


def test_brackets_in_names_are_no_markup(runs: list[dict], capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[type-arg]
    for name in "ab":
        path = Path(name, "metrics.json")
        data = json.loads(path.read_text())
        data["metrics"] |= {"speed [m/s]": {"value": 1.0, "unit": "m"}, "x[/b]y": {"value": 2.0, "unit": "[/c]"}}
        path.write_text(json.dumps(data))
    assert main(["compare", "a", "b"]) == 0
    printed = capsys.readouterr().out
    assert all(text in printed for text in ("speed [m/s]", "x[/b]y", "[/c]"))


def test_outcomes_lead_the_table(runs: list[dict], capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[type-arg]
    assert main(["run", "fake", "--set", "fall_at=1.0", "--out", "fallen", "--json"], REGISTRY) != 0
    outcome = json.loads(capsys.readouterr().out)["outcome"]
    assert outcome != "completed"
    assert main(["compare", "a", "fallen", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["outcomes"] == ["completed", outcome]
    assert main(["compare", "a", "fallen", "--out", "page.html"]) == 0
    row = next(line for line in capsys.readouterr().out.splitlines() if "outcome" in line)
    assert "completed" in row and outcome in row


def test_any_number_of_runs(runs: list[dict], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[type-arg]
    assert main(["run", "fake", "--seed", "3", "--out", "c", "--json"], REGISTRY) == 0
    runs.append(json.loads(capsys.readouterr().out))
    assert main(["compare", "a", "b", "c", "--json", "--out", "three.html"]) == 0
    data = json.loads(capsys.readouterr().out)
    for row in data["metrics"]:
        values = [r["metrics"][row["metric"]]["value"] for r in runs]
        assert row["values"] == values and row["spread"] == max(values) - min(values)
    assert data["settings"] == {"seed": [1, 2, 3], "mpc.rate": [50.0, 80.0, 50.0]}
    body = Path(data["page"]).read_text().partition("<body>")[2]
    titles = ("hand x", "hand y", "hand z", "error")  # each with a line per run
    assert all(f"<h3>{title}</h3>" in body for title in titles) and body.count("Plotly.newPlot") == 4
    assert body.count('"name":"a"') == body.count('"name":"c"') == 4
    assert main(["compare", "a", "b", "c", "--quiet"]) == 0
    for many in (["a"], ["a"] * 9):
        assert main(["compare", *many]) == 2
        assert "two to 8 runs are needed" in capsys.readouterr().err


def test_the_same_run_twice_has_two_names(runs: list[dict], capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[type-arg]
    assert main(["compare", "a", "a"]) == 0
    assert "a (1)" in capsys.readouterr().out


def test_runs_of_different_experiments_are_noted(runs: list[dict], capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[type-arg]
    """Once, in the table's notes, in the object and on the page."""
    assert main(["compare", "a", "b"]) == 0
    assert "different experiments" not in capsys.readouterr().out
    path = Path("b/metrics.json")
    path.write_text(json.dumps({**json.loads(path.read_text()), "experiment": "other"}))
    assert main(["compare", "a", "b", "--out", "mixed.html"]) == 0
    assert capsys.readouterr().out.count("different experiments (fake and other)") == 1
    assert Path("mixed.html").read_text().count("different experiments (fake and other)") == 1
    assert main(["compare", "a", "b", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["notes"]) == 1


def test_table_and_page(runs: list[dict], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[type-arg]
    assert main(["compare", "a", "b", "--out", "both.html"]) == 0
    out = capsys.readouterr().out
    assert (
        "mpc.rate: 50.0 and 80.0" in out and "hand_error_mean_odometry" in out and "the signals are in both.html" in out
    )
    page = (tmp_path / "both.html").read_text()
    body = page[page.index("<body>") :]
    assert "<tr><td>mpc.rate</td><td>50.0</td><td>80.0</td></tr>" in body.partition("Settings that differ")[2]
    assert body.count("Plotly.newPlot") == 2 and "<h3>hand</h3>" in body and '"dash":"dash"' in body.replace(" ", "")


def test_a_log_that_lost_a_channel_is_compared_without_it(
    runs: list[dict], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:  # type: ignore[type-arg]
    """Its times are still there."""
    with np.load("b/log.npz") as log:
        channels = dict(log)
    lost = next(c for c in channels if f"{c}.time" in channels)
    np.savez("b/log.npz", **{name: values for name, values in channels.items() if name != lost})
    assert main(["compare", "a", "b", "--out", str(tmp_path / "p.html")]) == 0
    assert capsys.readouterr().err == ""


def test_quiet_says_nothing(runs: list[dict], capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[type-arg]
    assert main(["compare", "a", "b", "--quiet"]) == 0
    assert capsys.readouterr().out == "" and Path("compare.html").is_file()


def test_what_is_no_run_is_said(runs: list[dict], capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[type-arg]
    Path("empty").mkdir()
    for path, why in (
        ("nowhere", "there is no such run; give its directory or its recording (run.mcap)"),
        ("empty", "is not the directory of a run: there is no metrics.json and no run.mcap"),
        ("a/log.npz", "is not a recording (MCAP): it does not begin like one"),
    ):
        assert main(["compare", "a", path]) == 2
        assert capsys.readouterr().err == f"wbmpc: {path}: {why}\n"
    Path("b/metrics.json").write_text("{")
    assert main(["compare", "a", "b"]) == 2
    assert "b/metrics.json: is not JSON: Expecting property name" in capsys.readouterr().err


@pytest.fixture
def killed(tmp_path: Path) -> Path:
    """A run of which only the recording is left, without its end."""
    (tmp_path / "killed").mkdir()
    file = McapFile(tmp_path / "killed" / "run.mcap")
    file.metadata("run", {"experiment": "fake", "seed": 3, "settings": json.dumps({"mpc": {"rate": 25.0}})})
    for k in range(300):
        file.put("/mpc/solve_time", "std_msgs/Float64", 0.01 * k, [0.001 * k])
        file.put("/measured/leg", "std_msgs/Float64", 0.01 * k, [0.001 * k])
    file.close()
    whole = file.path.read_bytes()
    file.path.write_bytes(whole[: whole.rindex(b"/mpc/solve_time") - 2000])  # in the middle of the index
    return file.path.parent


def test_of_a_killed_run_what_there_is(runs: list[dict], killed: Path, capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[type-arg]
    """Beside a whole run: its metrics alone, the settings, and what is missing."""
    assert main(["compare", "a", "killed", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert {row["metric"]: row["values"] for row in data["metrics"]} == {
        name: [m["value"], None] for name, m in runs[0]["metrics"].items()
    }
    assert data["settings"]["seed"] == [1, 3] and data["settings"]["mpc.rate"] == [50.0, 25.0]
    assert data["notes"] == ["killed left no metrics; its recording ends at 2.99 s"]
    assert main(["compare", "a", "killed"]) == 0
    out = capsys.readouterr().out
    assert "killed left no metrics" in out and "the runs share no signals; compare.html is without plots" in out


def test_recordings_are_taken_as_runs(killed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """run.mcap of a directory is its run; a recording on its own gives the figures that it holds."""
    assert main(["compare", str(killed / "run.mcap"), str(killed), "--json", "--out", str(tmp_path / "a.html")]) == 0
    notes = json.loads(capsys.readouterr().out)["notes"]
    assert all("left no metrics; its recording ends at 2.99 s" in note for note in notes) and len(notes) == 2
    file = McapFile(tmp_path / "mailed.mcap")
    file.metadata("run", {"experiment": "fake", "seed": 4, "settings": "{}"})
    file.put("/mpc/solve_time", "std_msgs/Float64", 0.0, [0.001])
    file.metadata("result", {"completed": "true", "reason": "", "metrics": json.dumps({"fell": 0.0, "error": 0.5})})
    file.close()
    assert main(["run", "fake", "--out", str(tmp_path / "a"), "--quiet"], REGISTRY) == 0
    runs = [str(tmp_path / "a"), str(tmp_path / "mailed.mcap")]
    assert main(["compare", *runs, "--json", "--out", str(tmp_path / "b.html")]) == 0
    data = json.loads(capsys.readouterr().out)
    rows = {row["metric"]: (row["values"], row["unit"]) for row in data["metrics"]}
    assert rows["fell"] == ([0.0, 0.0], "1") and rows["error"] == ([None, 0.5], "") and data["notes"] == []


def test_a_recording_of_more_figures_than_a_table_shows_is_an_error(tmp_path: Path) -> None:
    """As of a metrics.json: a table takes a millisecond for each."""
    file = McapFile(tmp_path / "many.mcap")
    file.metadata(
        "run", {"experiment": "fake", "seed": "4", "settings": json.dumps({f"key{k}": k for k in range(6000)})}
    )
    file.close()
    with pytest.raises(InputError, match=r"has 6000 numbers and texts; at most 5000 are read of a run"):
        load(tmp_path / "many.mcap")


def test_settings_are_reported_on_a_screen(
    runs: list[dict],  # type: ignore[type-arg]
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Of different experiments as a number, of others not more than 20; what matters comes after them."""
    path = Path("b/metrics.json")
    known = json.loads(path.read_text())
    known["settings"] = {**known["settings"], **{f"key{k}": k for k in range(50)}}
    path.write_text(json.dumps(known))
    assert main(["compare", "a", "b"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum(" and " in line for line in lines) == 20 and "32 more settings differ: --json names them" in lines
    path.write_text(json.dumps({**known, "experiment": "other"}))
    assert main(["compare", "a", "b"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-3] == "52 settings differ: --json names them" and "different experiments" in lines[-2]
    assert "key1: " not in "".join(lines)


def test_two_killed_runs_are_compared_by_their_recordings(killed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = killed.parent / "both.html"
    assert main(["compare", str(killed), str(killed), "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert text.count("left no metrics") == 2 and "the signals are in" in text
    body = out.read_text().partition("<body>")[2]
    assert "<h3>mpc/solve_time</h3>" in body and body.count("Plotly.newPlot") == 1


def test_a_run_that_ended_early_is_compared_and_said_to_be(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for folder, setting in (("a", "fall_at=2.0"), ("b", "abort=true")):
        assert main(["run", "fake", "--out", str(tmp_path / folder), "--set", setting, "--quiet"], REGISTRY) == 1
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b"), "--out", str(tmp_path / "c.html"), "--json"]) == 0
    notes = json.loads(capsys.readouterr().out)["notes"]
    assert notes[0].endswith("a did not complete: the robot fell at 2.00 s")
    assert notes[1].endswith("b did not complete: the solver gave up at 0.10 s")


def test_curves_have_names_and_the_runs_the_same_colors(tmp_path: Path) -> None:
    """Those that the log has; places of well-known channels; else numbers."""
    rng, log = np.random.default_rng(1), Log()
    for channel, width in (
        ("tour.base_odometry", 3),
        ("hand", 3),
        ("hand_quaternion", 4),
        ("leg", 4),
        ("other", 2),
        ("one", 10),
    ):
        for k in range(5):
            log.add(channel, 0.1 * k, rng.normal(size=width))
    wheels = ("LF", "RF", "</script><b>", "RB")
    log.label("leg", wheels)
    log.label("nothing", ("a",))
    both = Log()
    both.extend(log, ".twice", ["leg"])
    assert both.names == {"leg.twice": wheels}
    log.save(tmp_path / "log.npz")
    (tmp_path / "metrics.json").write_text("{}")
    run = load(tmp_path)
    plots = {p.title: p.series for p in overlay([run] * 2, ["a", "b"])}
    names = {title: [s.name for s in series if not s.dashed] for title, series in plots.items()}
    assert names["tour.base_odometry, m"] == ["x", "y"] and names["tour.base_odometry, °"] == ["yaw"]
    assert np.array_equal(plots["tour.base_odometry, °"][0].y, np.degrees(log.array("tour.base_odometry")[:, 2]))
    assert names["hand"] == ["x", "y", "z"]
    assert names["hand_quaternion"] == ["qw", "qx", "qy", "qz"]
    assert names["leg"] == [*wheels] and names["other"] == ["[0]", "[1]"]
    assert len(names["one (8 of 10)"]) == 8
    for series in plots.values():
        half = len(series) // 2
        drawn = [row["line"]["color"] for row in plotly_figure(Plot("t", "x", "y", series))["data"]]
        assert drawn[:half] == drawn[half:] and len(set(drawn)) == half
        assert all(s.dashed and s.name == f"{s.signal}, b" for s in series[half:])
    page = plots_page("a", "b", overlay([run] * 2, ["a", "b"]))
    assert "</script><b>" not in page.partition("<body>")[2]


@pytest.mark.parametrize("names", [["a"], [["a", "b"]], [1.0, 2.0], [b"a", b"b"], ["a", "b", "c"]])
def test_names_that_do_not_fit_a_channel_are_an_error(names: list[object], tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", **{"x": np.zeros((3, 2)), "x.time": np.arange(3.0), "x.names": np.array(names)})
    with pytest.raises(InputError, match=r"log\.npz: channel 'x\.names': a text for each component"):
        read_log(tmp_path / "log.npz")


def test_differences_to_the_first_run_are_in_the_table_and_on_the_page(
    runs: list[dict],  # type: ignore[type-arg]
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["run", "fake", "--seed", "3", "--out", "c<b>", "--json"], REGISTRY) == 0
    third = json.loads(capsys.readouterr().out)
    assert main(["compare", "a", "b", "c<b>", "--json", "--out", "three.html"]) == 0
    data = json.loads(capsys.readouterr().out)
    row = next(row for row in data["metrics"] if row["metric"] == "hand_error_mean_odometry")
    a, b, c = (r["metrics"]["hand_error_mean_odometry"]["value"] for r in (*runs, third))
    assert row["differences"] == [0.0, b - a, c - a]
    assert main(["compare", "a", "b", "c<b>", "--force"]) == 0
    shown = next(line for line in capsys.readouterr().out.splitlines() if "hand_error_mean_odometry" in line)
    body = Path(data["page"]).read_text().partition("<body>")[2]
    for text in (f"{1e3 * a:.4g}", f"({100 * (c - a) / a:+.1f} %)"):  # in mm
        assert text in shown and text in body
    assert "<th class=n>c&lt;b&gt;</th>" in body and "c<b>" not in body


@pytest.mark.parametrize(("difference", "first", "text"), [
    (0.0005, 0.002, "+0.5 (+25.0 %)"), (-0.001, 0.002, "-1 (-50.0 %)"), (0.0, 0.002, "0"), (0.001, 0.0, "+1"), (None, 0.002, ""),
    (1e-17, 0.002, "0"),
])  # fmt: skip
def test_a_difference_has_its_unit_and_share(difference: float | None, first: float, text: str) -> None:
    assert difference_text(difference, first, Scale("mm", 1e3)) == text
