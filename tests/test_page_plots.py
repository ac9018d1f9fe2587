"""Plots of pages: colors by meaning, limits, legends, zoom. Truth: what Plotly is given, and what a browser shows."""

from __future__ import annotations

import ast
import json
import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import wbmpc as wb
from fake_experiment import FakeSettings, run
from wbmpc.plots.figures import MAX_POINTS, _legend_rows, _thin, hint, palette, plotly_figure
from wbmpc.report import page, plots_page
from wbmpc.result import Plot, Series

CHROMIUM = shutil.which("chromium")


@pytest.mark.parametrize(("count", "length", "rows"), [(12, 17, 6), (3, 1, 1), (1, 200, 1), (0, 0, 1)])
def test_a_legend_has_room(count: int, length: int, rows: int) -> None:
    """Truth: two entries like ``rezero-run-two [0]`` stood in a row of Chromium's."""
    assert _legend_rows(["n" * length] * count) == rows


def test_figures_are_of_plotlys_schema() -> None:
    """A page is written without Plotly's own check of names and values, which is made here."""
    from plotly.graph_objects import Figure

    plots = [p for p in run(FakeSettings(), 3).plots if isinstance(p, Plot)]
    assert len(plots) == 4 and {p.equal_axes for p in plots} == {True, False}
    for plot in plots:
        figure = plotly_figure(plot)
        assert json.loads(Figure(figure).to_json()) == json.loads(json.dumps(figure))


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
@pytest.mark.parametrize("width", [1200, 500])
def test_plots_stay_within_their_cards(tmp_path: Path, width: int) -> None:
    """Measured by a browser; the first plot is a narrow one, which is drawn before its neighbor is there."""
    result = run(FakeSettings(), 3)
    result.plots = [result.plots[i] for i in (1, 2, 0)]
    measure = (
        "<script>addEventListener('load', () => setTimeout(() => { document.title = [...document.querySelectorAll('.plots > div')]"
        ".map(d => d.querySelector('.main-svg').getBoundingClientRect().right <= d.getBoundingClientRect().right"
        " ? 'fits' : 'spills').join(' ') }, 1500))</script></body>"
    )
    text = page(result)
    assert title_after(text.replace("</body>", measure), tmp_path, width) == "fits fits fits"


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_a_legend_is_below_the_axis_and_within_its_card(tmp_path: Path) -> None:
    """Measured by a browser as narrow as a phone: six names that fill four rows were drawn over the axis' title."""
    names = [f"arm.arm_shoulder_{i}" for i in range(6)]
    plot = Plot("t", "time [s]", "torque [N m]", [Series(n, np.arange(9.0), np.arange(9.0)) for n in names])
    measure = (
        "<style>main { width: 390px }</style><script>addEventListener('load', () => setTimeout(() => {"
        "const box = name => document.querySelector(name).getBoundingClientRect();"
        "const legend = box('.legend'), title = box('.xtitle'), card = box('.plots > div');"
        "document.title = `${title.bottom <= legend.top} ${legend.bottom <= card.bottom}` }, 1500))</script></body>"
    )
    text = plots_page("t", "a", [plot]).replace("</body>", measure)
    assert title_after(text, tmp_path, 500) == "true true"


def title_after(text: str, directory: Path, width: int) -> str:
    """The title that a page has when its scripts have run in a browser."""
    (directory / "page.html").write_text(text)
    options = (
        "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
        f"--disable-component-update --disable-sync --virtual-time-budget=6000 --window-size={width},2000 "
        f"--user-data-dir={directory / 'profile'} --dump-dom"
    )
    out = subprocess.run(
        [str(CHROMIUM), *options.split(), (directory / "page.html").as_uri()],
        capture_output=True,
        text=True,
        timeout=90,
    )
    found = re.search(r"<title>(.*?)</title>", out.stdout)
    assert found is not None
    return found.group(1)


def test_thinning_keeps_the_extremes_and_the_ends() -> None:
    rng = np.random.default_rng(0)
    x, y = np.arange(50_000.0), rng.normal(size=50_000)
    y[123] = np.nan
    for path in (False, True):
        tx, ty = _thin(x, y, path)
        assert tx.size <= MAX_POINTS
        assert (tx[0], tx[-1]) == (x[0], x[-1])
        assert np.all(np.diff(tx) > 0)
        np.testing.assert_array_equal(ty, y[tx.astype(int)])
    tx, ty = _thin(x, y, False)
    assert (np.nanmin(ty), np.nanmax(ty)) == (np.nanmin(y), np.nanmax(y))


def drawn_in(*plots: Sequence[Series]) -> list[list[str]]:
    """The colors of the lines of each plot of a page."""
    page = [Plot("t", "x", "y", list(lines)) for lines in plots]
    chosen = palette(page)
    return [[row["line"]["color"] for row in plotly_figure(plot, chosen)["data"]] for plot in page]


def test_a_signal_and_its_reference_share_a_color_and_a_meaning_keeps_its_own() -> None:
    line = lambda name, color=None: Series(name, np.zeros(2), np.zeros(2), color=color)
    [[x, x_reference, y, y_planned]] = drawn_in([line("x"), line("x, reference"), line("y"), line("y, planned")])
    assert x == x_reference != y == y_planned
    [path], [error] = (
        drawn_in([line("reference"), line("estimated frame"), line("world")]),
        drawn_in([line("world"), line("estimated frame")]),
    )
    assert path[1:] == error[::-1] and len(set(path)) == 3
    [joints] = drawn_in([line("world"), *(line(f"joint {i}") for i in range(5))])
    assert len(set(joints)) == 6
    [[a, _], [c]] = drawn_in([line("a", 2), line("b", 2)], [line("c", 2)])
    assert a == c


def test_a_signal_has_one_color_on_a_page() -> None:
    """Yaw was blue beside pitch and green beside x and y. Names with and without their group are of one signal, but not side by side."""
    lines = lambda *names: [Series(name, np.zeros(2), np.zeros(2)) for name in names]
    one, two, three, four = drawn_in(
        lines("yaw", "pitch"), lines("x", "y", "yaw", "pitch"), lines("wheel.w", "base.yaw"), lines("yaw", "arm.yaw")
    )
    assert one == two[2:] and len(set(two)) == 4
    assert three[1] == one[0] != three[0]
    assert four[0] == one[0] != four[1]
    [many] = drawn_in(lines(*(str(i) for i in range(20))))
    assert max(many.count(color) for color in many) == 3  # of eight colors


def test_names_of_axes_make_no_links() -> None:
    line = wb.Series("a", np.arange(3.0), np.arange(3.0))
    text = plots_page("t", "a", [wb.Plot("t", "<a href='http://x'>", "<b>", [line])])
    assert "\\u003ca href" not in text
    assert "\\u003cb\\u003e" not in text


def joint(name: str, values: list[float], limits: tuple[float, float] | None, dashed: bool = False) -> Series:
    return Series(name, np.arange(float(len(values))), np.array(values), dashed, limits=limits)


def test_limits_are_drawn_in_the_color_of_their_line_and_shared_ones_once() -> None:
    """Truth: a limit is a level line over all times at its own height; an infinite one is none."""
    plot = Plot("t", "time [s]", "angle [rad]", [
        joint("a", [0.0, 1.0, 0.5], (-1.5, 2.0)), joint("a, planned", [0.1, 0.9, 0.4], None, True), joint("b", [0.2, 0.1, 0.0], (-np.inf, 2.0)),
    ])  # fmt: skip
    a, planned, b, *limits = plotly_figure(plot)["data"]
    assert a["line"]["color"] == planned["line"]["color"] != b["line"]["color"]
    assert [row["showlegend"] for row in (a, planned, b)] == [True, False, True]
    assert {tuple(row["y"]): row["line"]["color"] for row in limits} == {
        (-1.5, -1.5): a["line"]["color"],
        (2.0, 2.0): "#7b8894",
    }
    assert all(row["x"] == [0.0, 2.0] and row["line"]["dash"] == "dot" for row in limits)
    low, high = plotly_figure(plot)["layout"]["yaxis"]["range"]
    assert low < -1.5 and high > 2.0 and hint(plot) == "dashed: planned; dotted: limits"


def test_far_limits_do_not_flatten_a_plot() -> None:
    plot = Plot("t", "time [s]", "torque [N m]", [joint("a", [-1.0, 1.0], (-56.0, 56.0))])
    low, high = plotly_figure(plot)["layout"]["yaxis"]["range"]
    assert -2.0 < low < -1.0 and 1.0 < high < 2.0
    assert "(56 N m and further are outside of the picture" in hint(plot)
    below = Plot("t", "time [s]", "speed [m/s]", [joint("v", [0.0, 0.2], (-0.9, 0.9))])
    assert "(-0.9 m/s is outside of the picture: a double click shows it)" in hint(below)  # the upper one is drawn


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_plots_over_time_share_their_zoom(tmp_path: Path) -> None:
    """In a browser: one plot is zoomed; the script ends when the other one over time has its range. The path keeps its own."""
    zoom = """<script>addEventListener("load", async () => {
  const [path, first, second] = document.querySelectorAll(".js-plotly-plot");
  const before = JSON.stringify(path.layout.xaxis.range);
  const followed = new Promise(done => second.on("plotly_relayout", change => "xaxis.range" in change && done()));
  await Plotly.relayout(first, { "xaxis.range[0]": 1, "xaxis.range[1]": 2 });
  await followed;
  document.title = [second.layout.xaxis.range.join(" to "), before === JSON.stringify(path.layout.xaxis.range)].join(", ");
})</script></body>"""
    text = page(run(FakeSettings(), 3))
    assert title_after(text.replace("</body>", zoom), tmp_path, 1200) == "1 to 2, true"


def test_plots_are_read_in_degrees() -> None:
    """Truth: the labels of all plots in the source; a view's fastest joint may also slide."""
    found = []
    for path in Path(wb.__file__).parent.rglob("*.py"):
        calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
        plots = [call for call in calls if isinstance(call.func, ast.Name) and call.func.id == "Plot"]
        texts = [
            a.value for call in plots for a in call.args if isinstance(a, ast.Constant) and isinstance(a.value, str)
        ]
        found += [f"{path.name}: {text}" for text in texts if re.search(r"\bm?rad\b", text)]
    assert found == []
