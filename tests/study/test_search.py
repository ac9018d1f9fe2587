"""`wbmpc tune`: searches, their fronts and figures. Truth: functions whose best point is known."""

from __future__ import annotations

import json
import os
import sqlite3
import subprocess
from contextlib import closing
from pathlib import Path

import pytest
import yaml
from valley import error

from wbmpc.cli import main
from wbmpc.errors import InputError
from wbmpc.study.files import DATABASE
from wbmpc.study.study import Study

pytest.importorskip("pyarrow")
from studies import HERE, study, traces

TUNE = """
experiments: [VALLEY]
seeds: 300-304
tune:
  seeds: 0-2
  search: {control.gain: {from: 0.01, to: 100, log: true}, offset: [0, 1]}
  minimize: [{metric: error, limit: 100}]
  trials: 14
"""


def test_a_search_finds_the_best_of_its_trials_on_its_own_seeds(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    made = Study.load(study(tmp_path, TUNE), tmp_path / "out")
    tuned = made.tune(workers=0)
    mean = [error(t["settings"]["control.gain"], t["settings"]["offset"], 1) for t in tuned.trials]
    assert tuned.best is not None and tuned.best["values"] == [pytest.approx(min(mean))]
    assert len(tuned.trials) == 14 and (tmp_path / "out" / "index.html").is_file()
    rows = Study.load(made.path, made.out / "trials").table().to_pylist()
    assert len(rows) == 42 and {r["seed"] for r in rows} == {0, 1, 2}
    assert tuned.report is not None and {s for c in tuned.report.cells for s in c.seeds} == set(range(300, 305))
    after = tuned.report.comparison(tuned.report.cells[1], "error")
    assert after is not None and after.text == "better" and after.wins == 5
    assert Study.load(made.path, made.out).tune(workers=0).trials == tuned.trials  # nothing is left to do
    other = Study.load(study(tmp_path, TUNE.replace("to: 100", "to: 90")), made.out)
    with pytest.raises(InputError, match=r"14 trials are of another search \(search\)"):
        other.tune(workers=0)


def test_a_front_is_what_no_trial_beats_and_the_least_sum_is_kept(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    text = TUNE.replace(
        "minimize: [{metric: error, limit: 100}]", "minimize: [{metric: error, limit: 100}, {metric: effort, limit: 9}]"
    )
    made = Study.load(study(tmp_path, text + "  pareto: true\n"), tmp_path / "out")
    tuned = made.tune(workers=0)
    values = {t["trial"]: t["values"] for t in tuned.trials}
    beaten = {k for k, a in values.items() for b in values.values() if b != a and b[0] <= a[0] and b[1] <= a[1]}
    assert {t["trial"] for t in tuned.front} == values.keys() - beaten and len(tuned.front) > 1
    assert tuned.best is not None and sum(tuned.best["values"]) == min(sum(values[t["trial"]]) for t in tuned.front)
    assert tuned.settings == tuned.best["settings"]


def test_the_best_settings_as_a_file_are_those_that_were_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A range that is of one choice alone means nothing without it. Truth: the settings of the run that takes the file."""
    pytest.importorskip("optuna")
    text = """
experiments: {end-effector-track: {path.kind: circle, plant: kinematic}}
robots: [panda-omni]
settings: {path.length: 0.1}
seeds: 300
tune:
  seeds: 0
  trials: 1
  search: {path.laps: {from: 0.1, to: 0.2}}
  minimize: [{metric: end_effector_error_mean, limit: 1}]
"""
    tuned = Study.load(study(tmp_path, text), tmp_path / "out").tune(workers=0)
    best = ["--config", str(tmp_path / "out" / "best.yaml"), "--out", str(tmp_path / "run"), "--json"]
    assert main(["run", "end-effector-track", *best]) == 0
    used = json.loads((tmp_path / "run" / "metrics.json").read_text())["settings"]
    assert used["robot"] == "panda-omni" and used["plant"] == {"kind": "kinematic"}
    assert (used["path"]["kind"], used["path"]["length"], used["path"]["laps"]) == (
        "circle",
        0.1,
        tuned.settings["path.laps"],
    )


def test_the_best_settings_of_unlike_experiments_have_what_they_share(tmp_path: Path) -> None:
    """Truth: the search's range, and what is written for all of them."""
    pytest.importorskip("optuna")
    text = (
        TUNE.replace("[VALLEY]", "{VALLEY: {goal: 0.25}}").replace("trials: 14", "trials: 1")
        + """
settings: {shift: 0.5}
conditions: {a: {settings: {robot: one}}, b: {settings: {robot: two}}}
"""
    )
    tuned = Study.load(study(tmp_path, text), tmp_path / "out").tune(workers=0)
    found = yaml.safe_load((tmp_path / "out" / "best.yaml").read_text())
    gain, offset = tuned.settings["control.gain"], tuned.settings["offset"]
    assert found == {"shift": 0.5, "goal": 0.25, "control": {"gain": gain}, "offset": offset}


def test_heat_maps_and_scatters_keep_conditions_apart(tmp_path: Path) -> None:
    pytest.importorskip("plotly")
    vary = (
        "vary: {control.gain: [1, 3], offset: [0.0, 0.2]}\nconditions: {protocol: {}, far: {settings: {shift: 7.0}}}\n"
    )
    file = tmp_path / "maps.yaml"
    file.write_text(f"experiments: [{HERE / 'valley.py'}]\nseeds: 300-302\nmetrics: [error]\n{vary}")
    made = Study.load(file, tmp_path / "maps")
    made.run(workers=0)
    maps = [trace for trace in traces(made.out / "index.html") if trace["type"] == "heatmap"]
    shifts = {0.0, 7.0}
    assert {round(m["z"][0][0] - error(1, 0.0, 1), 9) for m in maps} == shifts and len(maps) == 2
    assert {(m["zmin"], m["zmax"]) for m in maps} == {(error(3, 0.0, 1), 7.0 + error(1, 0.2, 1))}  # one scale of colors
    file.write_text(file.read_text().replace(", offset: [0.0, 0.2]", ", offset: [0.0]").replace("[1, 3]", "[1, 2, 3]"))
    other = Study.load(file, tmp_path / "scatter")
    other.run(workers=0)
    assert {t["name"] for t in traces(other.out / "index.html") if t["type"] == "scatter"} >= {
        "protocol, offset=0.0",
        "far, offset=0.0",
    }


def test_constraints_and_pruning(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    limits = "  constraints: {error: 5}\n  prune: true\n"
    made = Study.load(study(tmp_path, TUNE + limits), tmp_path / "out")
    tuned = made.tune(workers=0)
    rows = Study.load(made.path, made.out / "trials").table().to_pylist()
    worst = {t["trial"]: max(r["metric.error"] for r in rows if r["draw"] == t["trial"]) for t in tuned.trials}
    whole = [t for t in tuned.trials if not t["pruned"]]
    assert all(t["feasible"] == (worst[t["trial"]] <= 5.0) for t in whole) and not all(t["feasible"] for t in whole)
    pruned = [t["trial"] for t in tuned.trials if t["pruned"]]
    assert pruned and all(sum(r["draw"] == k for r in rows) < 3 for k in pruned)


@pytest.mark.parametrize(("robots", "status"), [("[unknown]", 1), ("[one, unknown]", 0)])
def test_settings_that_only_the_runs_reject_and_metrics_that_none_has_are_reported(
    robots: str, status: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A study of which every run rejected its settings has failed."""
    file = tmp_path / "rejected.yaml"
    file.write_text(f"experiments: [{HERE / 'valley.py'}]\nrobots: {robots}\nseeds: 1-2\nmetrics: [eror]\n")
    assert main(["study", str(file), "--workers", "0", "--out", str(tmp_path / "out"), "--json"]) == status
    said = capsys.readouterr().err
    assert "wbmpc: 2 runs rejected their settings: there is no such robot\n" in said
    assert (f"{file}: metrics: no run has 'eror'; valid: error" in said) is (status == 0)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("constraints: {error: .nan}", "constraints.error=nan: input should be"),
        ("constraints: {eror: 1}", "tune.constraints: no run has the metric 'eror'; valid: error"),
        ("storage: 'nothing://there'", "tune.storage: 'nothing://there': cannot be used as the database of a search ("),
        ("storage: 'sqlite:////proc/nowhere/trials.db'", "trials.db': cannot be used as the database of a search ("),
    ],
)
def test_what_is_wrong_with_a_search_is_named(
    more: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("optuna")
    file = tmp_path / "search.yaml"
    search = "search: {offset: {from: 0, to: 1}}, minimize: [{metric: error, limit: 9}], trials: 1"
    file.write_text(f"experiments: [{HERE / 'valley.py'}]\nseeds: 1\ntune: {{seeds: 0, {search}, {more}}}\n")
    assert main(["tune", str(file), "--workers", "0", "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert message in said and said.count("wbmpc:") == 1


@pytest.mark.skipif(os.geteuid() != 0, reason="needs a small disk of its own")
@pytest.mark.parametrize("size", [64, 120, 132])
def test_a_search_on_a_full_disk_names_the_file(size: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """When the database is made, and when the first trials come. Truth: a file system of so many kB."""
    pytest.importorskip("optuna")
    disk, file = tmp_path / "disk", tmp_path / "search.yaml"
    disk.mkdir()
    if subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}k", "none", str(disk)], capture_output=True
    ).returncode:
        pytest.skip("needs a small disk of its own")
    try:
        search = "search: {offset: {from: 0, to: 1}}, minimize: [{metric: error, limit: 9}], trials: 1"
        file.write_text(f"experiments: [{HERE / 'valley.py'}]\nseeds: 1\ntune: {{seeds: 0, {search}}}\n")
        assert main(["tune", str(file), "--workers", "0", "--out", str(disk / "out")]) == 1
        said = capsys.readouterr().err
        assert f"{disk / 'out' / DATABASE}: cannot be written (" in said and "tune.storage" not in said
    finally:
        subprocess.run(["umount", "--lazy", str(disk)], check=True)


def test_a_search_goes_on_with_more_trials(tmp_path: Path) -> None:
    """They find better settings, with which the study's own seeds are run in place of the old ones. Truth: the runs of the report."""
    pytest.importorskip("optuna")
    few = Study.load(study(tmp_path, TUNE.replace("trials: 14", "trials: 2")), tmp_path / "out").tune(workers=0)
    more = Study.load(study(tmp_path, TUNE), tmp_path / "out").tune(workers=0)
    assert more.trials[:2] == few.trials and few.best is not None and more.best is not None
    assert more.best["values"] < few.best["values"]
    rows = Study.load(tmp_path / "study.yaml", tmp_path / "out" / "report").table().to_pylist()
    gains = {json.loads(row["changes"]).get("control.gain") for row in rows}
    assert gains == {None, more.best["settings"]["control.gain"]} and len(rows) == 10
    assert more.report is not None and more.report.finished == more.report.planned == 10


@pytest.mark.parametrize(
    "damage",
    [
        "delete from trial_params", "update trial_params set param_value=1e308", "update trial_params set distribution_json='{'",
        """update trial_params set distribution_json='{"name": "CategoricalDistribution", "attributes": {"choices": []}}'""",
        "delete from trial_values", "update trial_values set value=null", "update trials set state='odd'", "drop table trial_params",
        "update trials set datetime_start='then'", "update study_user_attributes set value_json='{'",
    ],
)  # fmt: skip
def test_a_damaged_database_is_one_message(damage: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Truth: what SQLite changed in a database that was good."""
    pytest.importorskip("optuna")
    file, out = study(tmp_path, TUNE.replace("trials: 14", "trials: 2")), tmp_path / "out"
    Study.load(file, out).tune(workers=0)
    with closing(sqlite3.connect(out / DATABASE)) as database, database:
        database.execute(damage)
    assert main(["tune", str(file), "--workers", "0", "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert f"wbmpc: {out / DATABASE}: cannot be used as the database of a search (" in said and "Traceback" not in said


def test_a_database_of_another_search_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("optuna")
    file, out = study(tmp_path, TUNE.replace("trials: 14", "trials: 1")), tmp_path / "out"
    Study.load(file, out).tune(workers=0)
    with closing(sqlite3.connect(out / DATABASE)) as database, database:
        database.execute("update study_user_attributes set value_json='5'")
    assert main(["tune", str(file), "--workers", "0", "--out", str(out)]) == 2
    assert "its 1 trials are of another search (seeds, search," in capsys.readouterr().err


def test_whole_numbers_are_those_of_their_range(tmp_path: Path) -> None:
    """Also on a logarithmic scale, and with ends that are none. Truth: the whole numbers from 0.4 to 2.6."""
    pytest.importorskip("optuna")
    ranges = "{control.gain: {from: 0.4, to: 2.6, whole: true, log: true}, offset: {from: 0.4, to: 2.6, whole: true}}"
    text = TUNE.replace("{control.gain: {from: 0.01, to: 100, log: true}, offset: [0, 1]}", ranges)
    tuned = Study.load(study(tmp_path, text), tmp_path / "out").tune(workers=0)
    for key in ("control.gain", "offset"):
        assert {trial["settings"][key] for trial in tuned.trials} == {1, 2}
    none = text.replace("from: 0.4, to: 2.6, whole: true}", "from: 0.4, to: 0.6, whole: true}")
    with pytest.raises(InputError, match=r"tune\.search\.offset.*whole: there is no whole number from 0\.4 to 0\.6"):
        Study.load(study(tmp_path, none), tmp_path / "other")
