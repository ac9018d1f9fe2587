"""The study over burdens. Truth: files of runs written by hand, their order statistics."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import overview
import robustness

from wbmpc.configuration import configure
from wbmpc.experiments import REGISTRY
from wbmpc.experiments.swerve_unified import SwerveUnifiedSettings

METRIC = "hand_error_rms"


def finish(job: robustness.Job, value: float | None, completed: bool = True) -> None:
    job.directory.mkdir(parents=True)
    run = {
        "seed": job.seed,
        "completed": completed,
        "reason": "" if completed else "the robot fell at 3.00 s",
        "metrics": {METRIC: {"value": value, "unit": "m"}},
        "targets": {METRIC: {"paper": None, "goal": 0.005}},
    }
    (job.directory / "metrics.json").write_text(json.dumps(run))
    job.mark.touch()


@pytest.fixture
def study(tmp_path: Path) -> dict[robustness.Job, str]:
    found = robustness.jobs(tmp_path, ["protocol", "slope 3 deg"], ["swerve-unified"], range(200, 220))
    for k, (job, condition) in enumerate(found.items()):
        if condition == "protocol":
            finish(job, 1e-4 * (k // 2 + 1))
        elif job.seed < 203:
            finish(job, None if job.seed == 201 else 0.002, completed=job.seed != 201)
    return found


def test_figures_are_order_statistics_of_what_is_finished(study: dict[robustness.Job, str]) -> None:
    protocol, slope = robustness.cells(study)
    s = protocol.statistics()[METRIC]
    assert len(protocol.runs) == 20 and protocol.completed == 20
    assert s["worst"] == pytest.approx(2.0e-3) and s["p95"] == pytest.approx(1.9e-3, abs=1.01e-4)
    assert s["median"] == pytest.approx(1.05e-3, abs=0.51e-4) and s["goal"] == 0.005
    assert len(slope.runs) == 3 and slope.completed == 2
    # a run without the figure is as bad as can be
    assert slope.statistics()[METRIC]["worst"] == float("inf") and slope.statistics()[METRIC]["median"] == 0.002


def test_tables_say_what_is_missed(study: dict[robustness.Job, str], tmp_path: Path) -> None:
    robustness.write(robustness.cells(study), {}, tmp_path)
    lines = (tmp_path / "table.md").read_text().splitlines()
    (row,) = [line for line in lines if line.startswith("| slope 3 deg")]
    assert row.split("|")[2:4] == [" 3 ", " 2 "] and "**2 (∞, ∞)**" in row
    data = json.loads((tmp_path / "table.json").read_text())
    assert data["cells"][1]["metrics"][METRIC]["worst"] is None
    assert data["cells"][1]["reasons"] == ["the robot fell at 3.00 s"]
    if importlib.util.find_spec("matplotlib"):
        assert (tmp_path / "robustness.png").stat().st_size > 1000


def test_the_overview_judges_by_the_95_percent_value(study: dict[robustness.Job, str], tmp_path: Path) -> None:
    found = robustness.cells(study)
    (row,) = robustness.under_protocol(found)
    assert (row["experiment"], row["metric"], row["seeds"], row["reached"]) == ("swerve-unified", METRIC, 20, True)
    text = robustness.markdown(found).splitlines()
    assert text[2].startswith("| `swerve-unified` | `hand_error_rms` [mm] | ≤ 5 | – | 1") and text[2].endswith(
        "(1.9, 2) | 20 | yes |"
    )


@pytest.mark.parametrize(
    ("goal", "least", "reached", "text"),
    [(0.03, None, True, "≤ 30"), (0.02, None, False, "≤ 20"), (None, 0.01, True, "≥ 10"), (None, 0.02, False, "≥ 20"),
     (0.03, 0.02, False, "20 to 30"), (None, None, None, "–")],
)  # fmt: skip
def test_goals_are_largest_and_smallest_values(
    goal: float | None, least: float | None, reached: bool | None, text: str
) -> None:
    figures = {"unit": "m", "median": 0.02, "p5": 0.015, "p95": 0.025, "worst": 9.0, "paper": 0.0167}
    (row,) = overview.rows("rezero-steps", 3, {"error": {**figures, "goal": goal, "least": least}}, ["error"])
    assert row["reached"] is reached
    assert overview.markdown([row]).splitlines()[-1].split(" | ")[2:5] == [text, "16.7", "20 (25, 9000)"]


def test_a_document_gets_the_table_between_its_marks() -> None:
    text = "above\n<!-- ball -->\n| old |\n<!-- end of ball -->\nbelow\n"
    once = overview.put(text, "ball", "| new |")
    assert once == "above\n<!-- ball -->\n| new |\n<!-- end of ball -->\nbelow\n"
    assert overview.put(once, "ball", "| new |") == once
    with pytest.raises(SystemExit, match="'<!-- swerve -->'"):
        overview.put(text, "swerve", "| new |")


@pytest.mark.parametrize("name", robustness.SHOWN)
def test_every_condition_is_a_setting_of_every_experiment(name: str) -> None:
    for settings in robustness.conditions_of(name).values():
        configure(REGISTRY[name].config_type, settings, name)


def test_conditions_mean_what_they_are_called() -> None:
    given = {c: configure(SwerveUnifiedSettings, s, "") for c, s in robustness.SWERVE.items()}
    assert (given["hand 10 kg"].plant.payload, given["body 150 kg"].plant.load) == (10.0, 150.0)
    assert given["slope 3 deg"].plant.slope == pytest.approx(3.0 * 3.141592653589793 / 180.0, rel=1e-4)
    assert (given["delay 5 ms"].mpc.delay, given["delay 25 ms"].mpc.delay) == (0.005, 0.025)
    assert given["protocol"] == SwerveUnifiedSettings()
