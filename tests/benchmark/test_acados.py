"""acados as a peer: without its build it is left out with a message; with it, it finds what our solver and dense KKT equations say.

Independent truths: the common residual, our converged solution, the dense KKT equations of a step.
"""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from small_problems import cartpole, double_integrator
from wbmpc.benchmark.peers import Measure
from wbmpc.benchmark.problems import Problem, suite_bench
from wbmpc.benchmark.program import Program
from wbmpc.benchmark.race import ours

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

from whole_race import acados_race
from whole_race.acados_peer import VARIABLE, Acados, AcadosProblem, NoAcados, Settings, installation
from whole_race.acados_tables import markdown
from whole_race.qp import quadratic_race


@cache
def missing() -> str:
    try:
        installation()
    except NoAcados as error:
        return str(error)
    return ""


needs_acados = pytest.mark.skipif(bool(missing()), reason=f"no acados: {missing()}")


def test_without_a_build_the_race_says_why(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    found = acados_race.acados_race()
    assert found == {"error": f"{VARIABLE} is not set"}
    assert VARIABLE in markdown(found) and acados_race.goals(found) == []
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    assert "libacados.so" in acados_race.acados_race()["error"]


def test_goals_are_times_and_ticks_at_the_first_error() -> None:
    tick = {"scenario": "s", "median_ratio": 7.0, "worst_ratio": 3.0}
    figures = {
        "cold": [{"problem": "p", "ratio": None}],
        "ticks": [{**tick, "error": e} for e in acados_race.INPUT_ERRORS],
    }
    assert [(g["value"], g["met"]) for g in acados_race.goals(figures)] == [(None, None), (7.0, True), (3.0, False)]


def test_the_search_goes_on_from_the_best_value_of_every_key() -> None:
    truth = Settings(blocks=25, mode="BALANCE", mu0=0.1)
    wrong = lambda s: sum(getattr(s, k) != getattr(truth, k) for k in ("blocks", "mode", "mu0"))
    assert acados_race.search(wrong, 100, ("blocks", "mode", "mu0", "warm")) == (truth, 0)


@needs_acados
@pytest.mark.parametrize("make", [double_integrator, cartpole], ids=["rk2", "rk4"])
def test_acados_finds_our_solution_under_hard_limits(make: object) -> None:
    problem: Problem = suite_bench(make(20, hard=True))  # type: ignore[operator]
    x, u, figures = ours(problem, 3)
    program = Program(problem.solver)
    solver = Acados(AcadosProblem(program), Settings())
    solver.warm_start(np.tile(problem.x0, (21, 1)), np.tile(problem.u0, (20, 1)))
    solver.solve(problem.x0)
    states, inputs = solver.trajectory()
    assert figures["success"] and Measure(program)(states, inputs, problem.x0).largest < 1e-6
    assert max(np.abs(states - x).max(), np.abs(inputs - u).max()) < 1e-4


@needs_acados
def test_hpipm_of_its_build_takes_our_step() -> None:
    rows = {r["solver"]: r for r in quadratic_race(suite_bench(double_integrator(10)), repeat=2, peers=("hpipm",))}
    assert rows["hpipm"]["success"] and rows["hpipm"]["build"].startswith("acados ")


def test_ticks_that_one_misses_are_counted_and_not_timed() -> None:
    times, counts = np.array([1.0, 9.0, 3.0, 2.0]), np.array([1, 30, 3, 2])
    slow = (times + 1.0, counts, np.array([True, False, True, True]))
    found = acados_race._summary([(times, *slow[1:]), slow], np.array([True, False, False, True]))
    assert found == {"missed": 1, "median_ms": 1.5, "worst_ms": 2.0, "iterations_median": 1.5, "iterations_worst": 2}
    assert acados_race._summary([slow], np.zeros(4, bool))["worst_ms"] is None
