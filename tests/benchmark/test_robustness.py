"""The study over loads and delays. Truth: files of runs written by hand, their order statistics."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import robustness
from goals import goal_rows, goals_markdown, publish

from wbmpc.configuration import configure
from wbmpc.errors import InputError
from wbmpc.registry import REGISTRY
from wbmpc.studies.pankert2022.unified_settings import SwerveUnifiedSettings

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
    assert s["median"] == pytest.approx(1.05e-3) and s["goal"] == 0.005
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


@pytest.mark.parametrize("name", REGISTRY)
def test_every_condition_changes_the_settings_of_its_experiment(name: str) -> None:
    kind = REGISTRY[name].config_type
    for condition, settings in robustness.conditions_of(name).items():
        as_it_is = condition == "protocol" or (name, condition) == (
            "rezero-wholebody",
            "end effector 1 kg",
        )  # its own protocol
        assert (configure(kind, settings, name) == kind()) == as_it_is, condition


def test_variants_belong_to_one_experiment(tmp_path: Path) -> None:
    names = ["swerve-track", "swerve-plaster", "swerve-fixed", "swerve-unified"]
    found = robustness.jobs(tmp_path, robustness.VARIANTS, names, [200, 201])
    ran = sorted((job.seed, job.name, condition) for job, condition in found.items())
    several = [(s, n, c) for s in (200, 201) for c, (n, *_) in robustness.VARIANTS.items() if c != "ten minutes"]
    assert ran == sorted([*several, (200, "swerve-fixed", "ten minutes")])


def goals(values: list[float], completed: bool = True, **target: float) -> dict[str, object]:
    runs = [
        {"seed": 200 + k, "completed": completed, "metrics": {"a": {"value": v, "unit": "m"}}, "targets": {"a": target}}
        for k, v in enumerate(values)
    ]
    (row,) = goal_rows("rezero-steps", runs, {}, ["a"])  # type: ignore[arg-type]
    return row


def test_goals_are_judged_by_the_bad_end_of_the_seeds() -> None:
    values = [float(v) for v in range(1, 22)]  # 5 % and 95 % of 21 values are the second and the last but one
    assert goals(values, goal=20.0)["reached"] and not goals(values, goal=19.9)["reached"]
    assert goals(values, least=2.0)["reached"] and not goals(values, least=2.1)["reached"]
    low, high = goals(values, least=0.0), goals(values, goal=30.0)
    assert (low["p95"], low["worst"]) == (2.0, 1.0) and (high["p95"], high["worst"]) == (20.0, 21.0)
    assert not goals(values, completed=False, goal=30.0)["reached"]


@pytest.mark.parametrize(
    ("target", "text"),
    [({"goal": 0.03}, "≤ 30"), ({"least": 0.01}, "≥ 10"), ({"goal": 0.03, "least": 0.02}, "≥ 20 ≤ 30"), ({}, "–")],
)
def test_a_row_says_the_goal_and_what_the_paper_says(target: dict[str, float], text: str) -> None:
    row = goals([0.02, 0.025, 1.0], **target)
    worst = "25 (20, 20)" if set(target) == {"least"} else "25 (1000, 1000)"
    expected = [text, "“acceptable”", worst]
    assert goals_markdown([row]).splitlines()[-1].split(" | ")[2:5] == expected
    assert row["reached"] is ({"least"} == set(target) if target else None)
    assert goals_markdown([{**row, "paper": 0.0167}]).splitlines()[-1].split(" | ")[3] == "16.7"


def test_table_of_goals(study: dict[robustness.Job, str], tmp_path: Path) -> None:
    robustness.write(robustness.cells(study), {}, tmp_path)
    head, _, row = (tmp_path / "goals.md").read_text().splitlines()
    assert [f.strip() for f in row.split("|")][1:4] == ["`swerve-unified`", f"`{METRIC}` [mm]", "≤ 5"]
    assert row.endswith("| 20 | yes |") and head.count("|") == row.count("|")
    assert json.loads((tmp_path / "table.json").read_text())["goals"][0]["worst"] == pytest.approx(2e-3)


def test_conditions_mean_what_they_are_called() -> None:
    given = {c: configure(SwerveUnifiedSettings, s, "") for c, s in robustness.SWERVE.items()}
    assert (given["end effector 10 kg"].plant.payload, given["body 150 kg"].plant.body_payload) == (10.0, 150.0)
    assert given["slope 3 deg"].plant.slope == pytest.approx(3.0 * 3.141592653589793 / 180.0, rel=1e-4)
    assert (given["delay 5 ms"].mpc.computation_delay, given["delay 25 ms"].mpc.computation_delay) == (0.005, 0.025)
    assert given["protocol"] == SwerveUnifiedSettings()


def test_tables_are_put_between_their_marks(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- a -->\nold\n<!-- end of a -->\nafter\n")
    for text in ("first\n", "second\n"):
        publish(page, "a", text)
    assert page.read_text() == "before\n<!-- a -->\nsecond\n<!-- end of a -->\nafter\n"
    with pytest.raises(InputError, match="end of b"):
        publish(page, "b", "text")


def test_what_is_published_leaves_other_experiments_as_they_are(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- a -->\n| head |\n| `one` | 1 |\n|  | 2 |\n| `one, more` | 3 |\n<!-- end of a -->\n")
    publish(page, "a", "| head |\n| `one` | 7 |\n| `two` | 8 |\n|  | 9 |\n", r"\| `")
    table = "| head |\n| `one` | 7 |\n| `one, more` | 3 |\n| `two` | 8 |\n|  | 9 |\n"
    assert page.read_text() == f"<!-- a -->\n{table}<!-- end of a -->\n"


def test_docs_have_their_marks() -> None:
    for name, mark in (
        ("swerve.md", "swerve goals"),
        ("ball.md", "ball goals"),
        ("swerve.md", "swerve loads"),
        ("ball.md", "ball loads"),
    ):
        text = (robustness.DOCS / "results" / name).read_text()
        assert text.index(f"<!-- {mark} -->") < text.index(f"<!-- end of {mark} -->")


@pytest.mark.parametrize(("robot", "prefix"), [("swerve", "swerve-"), ("ball", "rezero-")])
def test_a_robot_selects_its_experiments(robot: str, prefix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    selected: list[str] = []

    def jobs(out: Path, conditions: list[str], only: list[str], seeds: object) -> dict[object, str]:
        selected.extend(only)
        raise SystemExit

    monkeypatch.setattr(robustness, "jobs", jobs)
    monkeypatch.setattr("sys.argv", ["robustness.py", "--robot", robot])
    with pytest.raises(SystemExit):
        robustness.main()
    assert selected and all(name.startswith(prefix) for name in selected)
