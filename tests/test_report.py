"""What a run leaves on disk: repeatable figures, valid JSON, a page that needs nothing from outside."""

from __future__ import annotations

import json
import math
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_experiment import FakeSettings, run
from wbmpc.log import Log
from wbmpc.report import goal_text, page, to_json, versions, write_run
from wbmpc.report.run_page import solve_lines
from wbmpc.result import Metric, MpcStatistics
from wbmpc.units import number, scale

CHROMIUM = shutil.which("chromium")
FELL = FakeSettings(fall_at=2.0)


def reject(constant: str) -> None:
    raise AssertionError(f"{constant} is not JSON")


@pytest.fixture(scope="module")
def html_page() -> str:
    return page(run(FakeSettings(), 3))


def test_files_of_a_run(tmp_path: Path) -> None:
    result = run(FakeSettings(), 3)
    files = write_run(result, tmp_path / "new" / "place")
    assert set(files) == {"metrics", "log", "report"}
    assert all(Path(f).is_file() for f in files.values())
    data = json.loads(Path(files["metrics"]).read_text(), parse_constant=reject)
    assert {
        "experiment",
        "seed",
        "completed",
        "metrics",
        "mpc",
        "files",
        "settings",
        "idealisations",
        "versions",
    } <= set(data)
    assert data["metrics"]["path_length"] == {"value": 20.53, "unit": "m"}
    assert data["settings"] == result.settings
    assert data["idealisations"] == result.idealizations
    assert {"wbmpc", "mujoco", "casadi", "numpy", "llvmlite", "python", "cpu"} <= set(data["versions"])
    with np.load(files["log"]) as log:
        np.testing.assert_array_equal(log["hand"], result.log.array("hand"))
        np.testing.assert_array_equal(log["hand.time"], result.log.times("hand"))


def test_metrics_repeat_bit_for_bit_and_hold_no_timings() -> None:
    first, second = (to_json(run(FakeSettings(), 7), {}) for _ in range(2))
    assert json.dumps(first["metrics"]) == json.dumps(second["metrics"])
    assert json.dumps(first["metrics"]) != json.dumps(to_json(run(FakeSettings(), 8), {})["metrics"])
    counts = {"solves", "failures", "no_step", "failed_share"}
    assert set(first["mpc"]) == {"rate_hz", "solve_ms", "deadline_misses"} | counts
    assert set(first["mpc"]["solve_ms"]) == {"median", "p95", "max"}


def test_figures_that_are_not_finite_are_null(tmp_path: Path) -> None:
    result = run(FELL, 1)
    result.settings["odd"] = [float("nan"), {"x": np.float64(np.inf)}]
    data = json.loads(Path(write_run(result, tmp_path)["metrics"]).read_text(), parse_constant=reject)
    assert data["metrics"]["rise_time_max"] == {"value": None, "unit": "s"}
    assert data["settings"]["odd"] == [None, {"x": None}]
    assert data["completed"] is False and data["reason"] == "the robot fell at 2.00 s"


def test_page_is_self_contained(html_page: str) -> None:
    outside = []

    class Finder(HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            outside.extend(v for k, v in attrs if k in ("src", "href") and v)

    Finder().feed(html_page)
    assert outside == []
    assert html_page.count("plotly.js v") == 1  # the library's banner: embedded once


def test_page_shows_everything(html_page: str) -> None:
    body = html_page[html_page.index("<body>") :]
    for text in (
        "hand_<wbr>error_<wbr>mean_<wbr>odometry",
        "<td class=n>16.7</td>",
        "<td class=n>≤ 3</td>",
        "reached",
        "missed",
        "27.2 ms",
        "mujoco",
        "&quot;rate&quot;: 50.0",
    ):
        assert text in body
    assert "The run completed; 2 of 3 metrics reach their goal, missed: hand_error_max_odometry." in body
    assert body.count("Plotly.newPlot") == 4
    assert "there is no physics &lt;at all&gt;" in body and "Empty &lt;plot&gt;" in body
    assert "<plot>" not in re.sub(r"<script.*?</script>", "", body, flags=re.S)
    assert '"scaleanchor":"x"' in body.replace(" ", "")


def test_page_of_a_fall_says_so() -> None:
    text = page(run(FELL, 3))
    assert "The run did not complete: the robot fell at 2.00 s" in text
    assert '"card summary bad"' in text


NUMBERS = {0.00159712: "0.001597", 20.53: "20.53", 0.0: "0", np.inf: "inf", -np.inf: "-inf", np.nan: "not a number"}


@pytest.mark.parametrize(("value", "text"), NUMBERS.items())
def test_numbers(value: float, text: str) -> None:
    assert number(value) == text


@pytest.mark.parametrize(
    ("unit", "values", "shown"),
    [
        ("m", (0.001457, 0.0167, 0.002), ["mm", "1.457", "16.7", "2"]),
        ("m", (0.05, 2.0), ["m", "0.05", "2"]),
        ("m", (3e-5,), ["µm", "30"]),
        ("m", (0.0, None), ["m", "0", ""]),
        ("m", (float("inf"), 0.02), ["mm", "inf", "20"]),
        ("rad", (math.pi / 180,), ["°", "1"]),
        ("rad/s", (math.pi,), ["°/s", "180"]),
        ("rad", (0.0, None), ["°", "0", ""]),
        ("rad/s", (float("inf"),), ["°/s", "inf"]),
        ("1", (6.645e-5, 0.01009, 0.003), ["%", "0.006645", "1.009", "0.3"]),
        ("1", (0.56, 0.05), ["", "0.56", "0.05"]),
        ("1", (3.0,), ["", "3"]),
        ("s", (0.92, 1.0), ["s", "0.92", "1"]),
        ("N m", (0.01,), ["N m", "0.01"]),
    ],
)
def test_units_of_a_row_read_well(unit: str, values: tuple[float | None, ...], shown: list[str]) -> None:
    """Truth: by hand."""
    found = scale(unit, *values)
    assert [found.unit, *map(found.text, values)] == shown


@given(st.sampled_from(["m", "m/s", "s", "rad", "rad/s", "1", "N m", ""]), st.floats(1e-12, 1e12))
def test_a_shown_figure_is_the_figure(unit: str, value: float) -> None:
    """Truth: definitions of the units."""
    per_unit = {"µm": 1e-6, "mm": 1e-3, "mm/s": 1e-3, "ms": 1e-3, "°": math.pi / 180, "°/s": math.pi / 180, "%": 0.01}
    found = scale(unit, value)
    assert float(found.text(value)) * per_unit.get(found.unit, 1.0) == pytest.approx(value, rel=1e-3)


def test_goals_as_text() -> None:
    metric = lambda **bounds: Metric(0.01, "m", **bounds)
    shown = scale("m", 0.01)
    texts = [
        goal_text(m, shown) for m in (metric(), metric(goal=0.02), metric(least=0.005), metric(least=0, goal=0.02))
    ]
    assert texts == ["", "≤ 20", "≥ 5", "0 to 20"]


def test_the_page_names_command_and_duration(tmp_path: Path) -> None:
    result = replace(run(FakeSettings(), 3), command="wbmpc run fake --set 'a=<b>'", wall_time=12.3456)
    body = page(result)
    assert "<code>wbmpc run fake --set &#x27;a=&lt;b&gt;&#x27;</code>" in body and "12.35 s" in body
    saved = json.loads(Path(write_run(result, tmp_path)["metrics"]).read_text(), parse_constant=reject)
    assert (saved["command"], saved["wall_time"]) == (result.command, result.wall_time)


def test_goals_are_largest_values() -> None:
    assert Metric(1.0, "m").met is None
    assert Metric(1.0, "m", goal=1.0).met is True
    assert Metric(1.1, "m", goal=1.0).met is False
    assert Metric(float("nan"), "m", goal=1.0).met is False


def test_solve_time_statistics() -> None:
    s = MpcStatistics.of(100.0, [0.001] * 95 + [0.011] * 5)
    assert s.solve_ms == pytest.approx({"median": 1.0, "p95": 1.5, "max": 11.0})
    assert s.deadline_misses == 5
    assert (s.failed_share, s.fault) == (0.0, "")
    some = MpcStatistics.of(100.0, [], solves=200, failures=15, no_step=5)
    assert some.failed_share == pytest.approx(0.1) and some.fault == ""
    many = MpcStatistics.of(100.0, [], solves=200, failures=15, no_step=6)
    assert "10 % of the MPC's 200 solves gave no new plan (15 failed, 6 without a step)" in many.fault
    empty = MpcStatistics.of(100.0, [])
    assert empty.deadline_misses == 0 and np.isnan(empty.solve_ms["max"])


def test_log_keeps_copies_and_channels_of_their_own_rate() -> None:
    log, row = Log(), np.zeros(2)
    log.add("a", 0.0, row)
    row[:] = 5.0
    log.add("a", 0.1, row)
    log.add("b", 0.05, 1.0)
    np.testing.assert_array_equal(log.array("a"), [[0.0, 0.0], [5.0, 5.0]])
    np.testing.assert_array_equal(log.array("b"), [1.0])
    np.testing.assert_array_equal(log.times("a"), [0.0, 0.1])
    assert log.channels == ["a", "b"]


def test_versions_are_known() -> None:
    found = versions()
    assert found["wbmpc"] and found["cpu"]
    assert "unknown" not in found.values()


def test_a_run_that_did_not_complete_reaches_no_goal() -> None:
    result = run(FELL, 3)
    judged = [name for name, m in result.metrics.items() if m.met is not None]
    text = page(result)
    assert any(result.metrics[name].met for name in judged)  # as far as the run went
    assert f"0 of {len(judged)} metrics reach their goal (those of a run that does not complete do not)" in text
    assert '<span class="met">' not in text


def test_definitions_are_shown_beside_names_and_stay_text() -> None:
    result = run(FakeSettings(), 3)
    result.metrics["fell"] = replace(result.metrics["fell"], definition='whether "it" <fell>')
    text = page(result)
    assert 'data-about="whether &quot;it&quot; &lt;fell&gt;">fell</span>' in text


def test_the_outcome_says_what_late_and_failed_solves_mean() -> None:
    """Truth: counts of the statistics; 20 ms is the period of 50 Hz."""
    result = run(FakeSettings(), 3)
    result.mpc = MpcStatistics.of(50.0, [0.001, 0.030, 0.025], 100, failures=4, no_step=2)
    result.settings = {"mpc": {"computation_delay": 0.010}}
    failed, stuck, late = solve_lines(result)
    assert failed.startswith("4 of 100 solves failed") and stuck.startswith("2 of 100 solves found no step")
    assert late.startswith("2 of 100 solves took longer than the period of 20 ms on this machine (30 ms at most)")
    assert "after the same delay of 10 ms" in late and late in page(result).replace("&#x27;", "'")
    result.mpc = MpcStatistics.of(50.0, [0.001], 100)
    assert solve_lines(result) == ["All 100 solves gave a plan, each within the period of 20 ms."]
