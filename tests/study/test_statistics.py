"""Statistics of studies. Truth: closed forms, SciPy's own tests of them, coverage over drawn samples."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from wbmpc.log import Log
from wbmpc.result import Metric, RunResult
from wbmpc.study import page
from wbmpc.study import summary as summary_module
from wbmpc.study.rows import check_rows
from wbmpc.study.statistics import failure_rate, interval, paired, spread
from wbmpc.study.store import _unified, parquet, table_of
from wbmpc.study.summary import Cell, Summary, summarize
from wbmpc.study.work import _row


def test_order_statistics_are_values_and_infinity_is_one() -> None:
    s = spread(np.array([3.0, 1.0, 2.0, np.inf, 5.0]))
    assert (s.count, s.median, s.p5, s.p95, s.worst) == (5, 3.0, 1.0, np.inf, np.inf)
    assert spread(np.array([3.0, 1.0, 2.0]), largest_is_worst=False).worst == 1.0


def test_wilsons_interval() -> None:
    """In closed form, z = 1.96."""
    z, n, p = 1.959964, 20, 0.1
    middle, half = (p + z**2 / (2 * n)), z * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    found = failure_rate(2, 20)
    np.testing.assert_allclose([found.low, found.high], (middle + np.array([-half, half])) / (1 + z**2 / n), rtol=1e-5)
    assert failure_rate(0, 20).low == 0.0 and failure_rate(0, 20).high > 0.1


def test_the_interval_holds_the_median_as_often_as_it_says() -> None:
    rng = np.random.default_rng(3)
    inside = sum(low <= np.log(2.0) <= high for low, high in (interval(rng.exponential(size=25)) for _ in range(100)))
    assert 86 <= inside <= 100  # 95 % of 100, four standard deviations below; it is somewhat wide for few values
    assert np.isnan(interval(np.array([1.0]))).all()


def test_a_pair_cancels_what_a_seed_does_to_both() -> None:
    seeds = np.random.default_rng(0).normal(scale=100.0, size=20)
    found = paired(seeds - 1.0, seeds)
    assert found.difference == pytest.approx(-1.0) and found.high < 0.0 and found.text == "better"
    assert (found.wins, found.losses) == (20, 0)
    assert paired(seeds - 1.0, seeds, smaller_is_better=False).text == "worse"
    assert paired(seeds, seeds).text == "no difference"


def test_a_failure_loses_against_any_figure_and_equals_another() -> None:
    found = paired(np.array([np.inf, np.inf, 2.0]), np.array([1e9, np.inf, np.inf]))
    assert (found.wins, found.losses, found.difference) == (1, 1, 0.0)


@pytest.mark.parametrize("count", [2, 7, 150])
def test_the_interval_is_scipys(count: int) -> None:
    values = np.random.default_rng(count).normal(size=count)
    made = stats.bootstrap(
        (values,), np.median, n_resamples=2000, batch=100, method="percentile", rng=np.random.default_rng(0)
    ).bootstrap_distribution
    assert interval(values) == tuple(np.quantile(made, [0.025, 0.975], method="nearest"))


def test_a_page_of_many_metrics_draws_what_it_shows(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """And each bootstrap is made once, whatever asks for it. Truth: the limit of plots, one interval for each metric."""
    names, made, drawn = [f"m{k}" for k in range(200)], [], []
    figures = {n: np.array([1.0, 2.0, 4.0]) for n in names}
    cell = Cell("k", "e", "a", "", "", {}, np.arange(3), ("completed",) * 3, figures, ("",) * 3, ("",) * 3)
    units: dict[str, str] = dict.fromkeys(names, "m")
    summary = Summary("t", (cell,), units, {}, {"e": tuple(names)}, 3, {}, {})
    of = summary_module.spread
    monkeypatch.setattr(summary_module, "spread", lambda *given: made.append(1) or of(*given))
    monkeypatch.setattr(page, "figure_html", lambda *_, **__: drawn.append(1) or "")
    text = page.study_page(summary, tmp_path, {"e": {}})
    summary.to_json()
    assert len(made) == 200 and len(drawn) == page.MAX_PLOTS
    assert "The plots of 176 more metrics are left out" in text and text.count("<h3>m199") == 1


def cells(*figures: dict[str, list[float]]) -> tuple[Cell, ...]:
    """Of one experiment, each with figures of two runs that completed."""
    texts = (("completed",) * 2, ("",) * 2, ("",) * 2)
    return tuple(
        Cell(
            str(k), "e", f"c{k}", "", "", {}, np.arange(2), texts[0], {n: np.array(v) for n, v in f.items()}, *texts[1:]
        )
        for k, f in enumerate(figures)
    )


def test_what_a_robot_cannot_have_is_not_measured_and_no_win() -> None:
    """An arm has no path of its base: it was infinitely long, and any base's better. With a goal it still counts as missed."""
    an_arm, base = cells({"error": [1.0, 2.0]}, {"error": [1.0, 2.0], "path": [3.0, np.nan]})
    summary = Summary("t", (an_arm, base), {}, {}, {"e": ("error", "path")}, 4, {}, {})
    assert summary.comparison(base, "path") is None and summary.comparison(base, "error") is not None
    rows = page.metric_rows(summary, [an_arm, base], "path")
    assert rows[0][1:] == ["0 of 2", "0 (0 to 65.8 %)", "not measured", *[""] * 7]
    assert rows[1][1] == "1 of 2" and rows[1][3] == "3"
    goal = {"0": {"path": {"paper": None, "goal": 5.0, "least": None}}}
    judged = Summary("t", (an_arm, base), {}, goal, {"e": ("path",)}, 4, {}, {})
    assert judged.spread(an_arm, "path").median == np.inf and judged.met(an_arm, "path") is False


def test_a_larger_smallest_distance_is_better_and_last_digits_are_no_difference() -> None:
    near, far, same = cells(
        {"clearance_min": [0.1, 0.2]}, {"clearance_min": [0.2, 0.3]}, {"clearance_min": [0.1 + 1e-9, 0.2]}
    )
    summary = Summary("t", (near, far, same), {}, {}, {"e": ("clearance_min",)}, 6, {}, {}, "", ("clearance_min",))
    found = [summary.comparison(cell, "clearance_min") for cell in (far, same)]
    assert [c and c.text for c in found] == ["better", "no difference"] and summary.spread(
        far, "clearance_min"
    ).worst == 0.2


def test_a_metric_says_itself_that_small_values_are_bad_and_its_name_does_not(tmp_path: Path) -> None:
    """Through the rows and files of a study. A cost may be called ``cost_min``."""
    log = Log()
    log.add("x", 0.0, [1.0])
    metrics = {
        "reach": Metric(1.0, "m", larger_is_better=True),
        "cost_min": Metric(1.0, "1"),
        "load": Metric(2.0, "N", least=1.0),
    }
    row = {"key": "a-0", "experiment": "e", "seed": 0, **_row(RunResult("e", 0, True, "", metrics, None, log))}
    check_rows(tmp_path, [row])
    parquet().write_table(_unified_table(row), tmp_path / "rows.parquet")
    combination: Any = SimpleNamespace(key="a", experiment="e", label="", condition="", robot="", varied={}, accept=())
    found = summarize("t", [combination], parquet().read_table(tmp_path / "rows.parquet"), 1)
    (cell,) = found.cells
    assert [found.large_is_bad(cell, name) for name in metrics] == [False, True, False]
    assert found.units == {"reach": "m", "cost_min": "1", "load": "N"}


def _unified_table(row: dict[str, Any]) -> Any:
    """A row in the columns of it and of a run without metrics, as parts of a study are put together."""
    parts = [table_of([row]), table_of([{"key": "a-1", "experiment": "e", "outcome": "rejected"}])]
    return parts[0].cast(_unified([part.schema for part in parts]))


def test_a_count_that_is_the_same_in_all_runs_is_not_drawn(tmp_path: Path) -> None:
    summary = Summary("t", cells({"fell": [0.0, 0.0]}, {"fell": [0.0, 0.0]}), {}, {}, {"e": ("fell",)}, 4, {}, {})
    assert "Plotly.newPlot(" not in page.study_page(summary, tmp_path) and "fell" in page.study_page(summary, tmp_path)
