"""Statistics over seeds. Truth: the runs that completed, by hand."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from fake_experiment import REGISTRY, FakeSettings

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
import seeds


def test_runs_that_failed_are_counted_and_not_averaged() -> None:
    experiment = REGISTRY["fake"]
    done = [experiment.run(FakeSettings(), seed, None) for seed in (0, 1, 2)]
    fell = experiment.run(FakeSettings(fall_at=0.5), 3, None)
    found = seeds.summary([*done, fell])
    assert found["outcomes"] == {"completed": 3, fell.outcome: 1} and fell.outcome != "completed"
    for name, row in found["metrics"].items():
        if name != "solve_ms":
            values = sorted(run.metrics[name].value for run in done)
            assert row["median"] == pytest.approx(values[1]) and row["worst"] == values[2]
    assert seeds.summary([fell]) == {"outcomes": {fell.outcome: 1}, "metrics": {}}
