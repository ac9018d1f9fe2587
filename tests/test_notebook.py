"""What notebooks and the prompt show of objects. Truth: the objects' own numbers."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import wbmpc as wb
from fake_experiment import FakeSettings, run
from wbmpc.solver.solution import Status


def solution() -> wb.Solution:
    x, u = np.outer(np.arange(4.0), [1.0, 2.0]), np.array([[1.0], [2.0], [3.0]])
    return wb.Solution(
        Status.CONVERGED, np.arange(4.0), x, u, np.zeros((3, 1, 2)), 5, 1.25, 1e-9, 1e-7, 0.002, np.zeros((5, 8))
    )


def objects() -> list[object]:
    found = solution()
    return [wb.load_robot("panda"), found, wb.Policy.of(found, 10.0), run(FakeSettings(), 3)]


def mpc() -> wb.MPC:
    system = wb.Ode({"body": ["place", "speed"]}, {"force": ["push"]}, lambda x, u: ca.vertcat(x[1], u[0]))
    ocp = wb.OptimalControlProblem(system, horizon=2.0, intervals=4, first_interval=0.1)
    ocp.add(wb.Cost("place", wb.residuals.State(system), 1.0))
    ocp.add(wb.Cost("force", wb.residuals.Input(system), 0.1))
    return wb.MPC(ocp, rate=20.0)


def test_an_mpc_and_its_problem_show_themselves() -> None:
    """The line is that of the settings; the table counts solves; the plot's steps are the grid's."""
    pytest.importorskip("plotly")
    made = mpc()
    assert repr(made) == "MPC(20 Hz, SQP, 2 s, 4 intervals, 2 states, 1 inputs)"
    made.reset(np.zeros(2))
    made.update(wb.Observation(t=0.0, x=np.array([1.0, 0.0])))
    shown = made._repr_html_()
    assert "<td style=text-align:left>solves</td><td style=text-align:left>1</td>" in shown and "place, force" in shown
    (line,) = made.ocp.plot().data
    assert list(line.x[::2]) == pytest.approx(made.ocp.grid[:-1], rel=1e-5)  # numbers of plots have six digits
    assert list(line.y[::2]) == pytest.approx(1e3 * np.diff(made.ocp.grid), rel=1e-5)


def test_reprs_are_short_and_tables_escape_what_they_show() -> None:
    for thing in objects():
        assert repr(thing).startswith(type(thing).__name__) and len(repr(thing)) < 200
        assert thing._repr_html_().startswith("<div>")  # type: ignore[attr-defined]
    result = run(FakeSettings(), 3)
    result.metrics["<b>"] = wb.Metric(1.0, "<i>")
    assert "<b><" not in result._repr_html_().partition("</b>")[2] and "&lt;b&gt;" in result._repr_html_()


def test_plots_of_solutions_and_policies_hold_their_numbers() -> None:
    """Inputs are held over their interval; a policy's times are absolute."""
    pytest.importorskip("plotly")
    found = solution()
    first, second, inputs = found.plot().data
    assert [list(first.y), list(second.y)] == found.x.T.tolist() and list(inputs.x) == [0, 1, 1, 2, 2, 3]
    assert list(inputs.y) == [1, 1, 2, 2, 3, 3] and inputs.name == "u[0]"
    assert list(wb.Policy.of(found, 10.0).plot().data[0].x) == [10, 11, 12, 13]


def test_a_run_draws_the_plots_of_its_report() -> None:
    result = run(FakeSettings(), 3)
    assert len(result.plot().data) == sum(len(plot.series) for plot in result.plots if isinstance(plot, wb.Plot))
