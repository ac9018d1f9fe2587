"""Gains of baselines are those of the best trial of a recorded search, on other seeds than the reported ones. Truth: the kept tables of trials
(docs/results/trials, written by scripts/trials.py)."""

from __future__ import annotations

import csv
from functools import reduce
from pathlib import Path
from typing import Any

import pytest

from wbmpc.registry import load
from wbmpc.study.study import Study

ROOT = Path(__file__).parents[1]
TABLES = sorted((ROOT / "docs" / "results" / "trials").glob("*.csv"))


@pytest.mark.parametrize("table", TABLES, ids=[t.stem for t in TABLES])
def test_a_baseline_has_the_gains_that_its_search_found(table: Path) -> None:
    pytest.importorskip("optuna")
    (file,) = (ROOT / "src" / "wbmpc" / "studies").rglob(f"{table.stem}.yaml")
    definition = Study.load(file).definition
    tune = definition.tune
    assert tune is not None
    with table.open() as lines:
        rows = list(csv.DictReader(lines))
    assert len(rows) >= tune.trials >= 200
    assert {row["seeds"] for row in rows} == {" ".join(map(str, tune.seeds))}
    best = min((row for row in rows if row["feasible"] == "1"), key=lambda row: float(row["objective"]))
    for name, own in definition.experiments.items():
        assert not set(own) & set(tune.search)
        used: Any = load(name).config_type().model_dump()
        for key, search in tune.search.items():
            values = [float(row[key]) for row in rows]
            assert search.low <= min(values) and max(values) <= search.high
            assert reduce(dict.__getitem__, key.split("."), used) == pytest.approx(float(best[key]), rel=0.01, abs=1e-3)
