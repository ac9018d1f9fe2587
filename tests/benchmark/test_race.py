"""The race: its operation counts, the program that peers get, the quadratic problem, and what is said when a peer is missing.

Independent truths: a textbook Riccati step on numbers that count their operations; CasADi's own differentiation of the
peers' program; dense KKT equations solved by NumPy; IPOPT, HPIPM and OSQP; the C compiler.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import venv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from effort import some
from small_problems import cartpole, double_integrator
from wbmpc.benchmark import race
from wbmpc.benchmark.peers import peer_statistics, prepare, solve_with, within
from wbmpc.benchmark.problems import Problem, RaceProblems, suite_bench
from wbmpc.benchmark.program import Program, compiler, run_whole
from wbmpc.benchmark.race import ours, peak_gflops
from wbmpc.kernel.sizes import Sizes
from wbmpc.studies.race.ballbot import ballbot

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

from whole_race import closed_loop, crocoddyl_peer
from whole_race import race as whole
from whole_race.figure import write
from whole_race.floor import operations, riccati_operations
from whole_race.lq import linearize, our_step, pack
from whole_race.qp import matrices, quadratic_race, step_problem
from whole_race.scaling import limited_arm, slope
from whole_race.tables import text
from whole_race.yardstick import yardstick


# ---------------------------------------------------------------------- operation counts
def test_operations_of_a_function_by_hand() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    f = ca.Function("f", [x, y], [ca.sin(x * y) + x / y])  # product, sine, quotient, sum
    assert operations(f) == (4, 1)
    assert operations(ca.Function("g", [x], [-x, ca.SX(2.0)])) == (0, 0)


class Tally:
    """Counts multiplications and additions of matrices of real size, done naively."""

    def __init__(self) -> None:
        self.count = 0

    def product(self, rows: int, columns: int, inner: int) -> None:
        for _ in range(rows * columns):
            for _ in range(inner):
                self.count += 2  # one product, one sum

    def solve(self, unknowns: int, right: int) -> None:
        for _ in range(right):
            for k in range(unknowns):
                self.count += 2 * k + 1  # what is known, and the division by the diagonal


@pytest.mark.parametrize("share", [0.1, 1.0])
@pytest.mark.parametrize("nx, nu", [(2, 1), (5, 3), (16, 9)])
def test_operations_of_a_riccati_step_without_rows(nx: int, nu: int, share: float) -> None:
    x, tally = nx + 1, Tally()  # the state has a one behind it, for the gradient
    step = np.random.default_rng(nx).uniform(size=(x, x + nu)) <= share
    for _, j in np.argwhere(step):  # every entry of [A b B]
        tally.product(x, 1, 1)  # in P [A b B]
        tally.product(j + 1, 1, 1)  # in [A b B]ᵀ … above the diagonal
    for j in reversed(range(nu)):  # elimination of the inputs from the last, the rows above with it
        for _ in range(x + j + 1):
            tally.count += 2 * (nu - 1 - j) + 1
    tally.solve(nu, x)  # gains
    for j in range(x):
        tally.product(j + 1, 1, nu)  # value function, above the diagonal
    assert riccati_operations(Sizes(nx, nu, 0, 0, 0), step.sum(axis=0), 0) == tally.count


def test_rows_cost_what_two_passes_of_their_schur_complement_cost() -> None:
    nx, nu, g, held, tally = 21, 21, 8, 15, Tally()
    x = nx + 1
    tally.solve(held, g)  # U⁻¹ Dᵀ, of the inputs up to the last one in a row
    tally.product(x, g, held)  # C and e after the elimination of the inputs
    tally.product(g, g, held)  # Schur complement
    tally.count += g**3 // 3  # its factor
    for j in range(x):
        tally.product(j + 1, 1, g)  # value function, above the diagonal
    for _ in range(2):
        tally.solve(g, x)  # forwards
        tally.solve(g, x)  # backwards
        tally.product(x, held, g)  # on the inputs
    tally.product(x, g, held)  # what is left of the rows
    tally.product(x, g, 1)
    tally.solve(nu, x)  # gains again
    full = np.full(nx + 1 + nu, nx + 1)
    without = riccati_operations(Sizes(nx, nu, 0, 0, 0), full, held)
    assert riccati_operations(Sizes(nx, nu, g, 0, 0), full, held) - without == tally.count


def test_the_peak_is_that_of_a_processor() -> None:
    assert 1.0 < peak_gflops() < 1000.0


# ---------------------------------------------------------------------- the program that peers get
MAKERS: dict[str, Callable[[], Problem]] = {
    "rk2, soft": lambda: suite_bench(ballbot(4)),
    "hard limit": lambda: suite_bench(double_integrator(4, hard=True)),
    "rk4, hard": lambda: suite_bench(cartpole(4, hard=True)),
    "hard states, general rows": lambda: limited_arm(24, "general", 3),
    "hard states": lambda: limited_arm(36, "boxes", 3),
}


@pytest.mark.parametrize("name", some(list(MAKERS), [0, 1, 2, 3]))
def test_derivatives_of_the_program_are_casadis_own(name: str) -> None:
    problem = MAKERS[name]()
    program = Program(problem.solver)
    functions, rng = program.functions(), np.random.default_rng(1)
    z = np.concatenate([np.tile(np.concatenate([problem.x0, problem.u0]), program.n), problem.x0])
    z = z + 0.05 * rng.normal(size=z.size)
    jacobian = ca.Function("j", [program.x, program.p], [ca.jacobian(program.constraints(), program.x)])
    gradient = ca.Function("g", [program.x, program.p], [ca.gradient(program.cost(), program.x)])
    rows, found = functions["nlp_jac_g"](z, problem.x0)
    dense = lambda m: np.array(ca.densify(m))
    np.testing.assert_allclose(dense(found), dense(jacobian(z, problem.x0)), rtol=1e-9, atol=1e-9)
    assert rows.shape[0] == program.rows == program.equality().size
    slope_found = dense(functions["nlp_grad_f"](z, problem.x0))
    np.testing.assert_allclose(slope_found, dense(gradient(z, problem.x0)), rtol=1e-7, atol=1e-7)


def test_the_hessian_of_a_quadratic_cost_is_the_exact_one() -> None:
    problem = suite_bench(double_integrator(5, hard=True))
    program = Program(problem.solver)
    exact = ca.Function("h", [program.x, program.p], [ca.hessian(program.cost(), program.x)[0]])
    z = np.random.default_rng(2).normal(size=program.x.shape[0])
    _, hessian = program.functions()["nlp_hess_l"](z, problem.x0, 1.0, np.zeros(program.rows))
    np.testing.assert_allclose(np.array(ca.densify(hessian)), np.array(ca.densify(exact(z, problem.x0))), atol=1e-12)


def test_hard_states_do_not_count_at_the_measured_state() -> None:
    program = Program(limited_arm(36, "boxes", 3).solver)
    # torques (12) count at every node, rates and angles (24) from the first on, and at the end
    assert np.count_nonzero(~program.equality()) == 12 + 2 * 36 + 24


@pytest.mark.parametrize("name", ["ipopt", "fatrop"])
def test_peers_find_our_solution_under_a_hard_limit(name: str) -> None:
    problem = suite_bench(double_integrator(20, hard=True))
    x, u, figures = ours(problem, 3)
    assert figures["success"] and np.abs(u).max() > 1.0 - 1e-6  # the limit is active
    start = (np.tile(problem.x0, (21, 1)), np.zeros((20, 1)))
    states, inputs, found = solve_with(name, prepare(problem, compile_functions=False), problem.x0, *start, repeat=1)
    assert found["success"] and found["how"].startswith("functions interpreted")
    assert max(np.abs(states - x).max(), np.abs(inputs - u).max()) < 1e-5


# ---------------------------------------------------------------------- the quadratic problem of a step
@pytest.mark.parametrize("make", [lambda: double_integrator(10), lambda: ballbot(8)], ids=["integrator", "ballbot"])
def test_our_step_solves_the_dense_kkt_equations(make: Callable[[], Any]) -> None:
    lq, packed = step_problem(suite_bench(make()))
    h, g, a, right = matrices(lq)
    nothing = np.zeros((a.shape[0],) * 2)
    kkt = np.block([[h.toarray(), a.toarray().T], [a.toarray(), nothing]])
    step = np.linalg.solve(kkt, np.concatenate([-g, right]))[: g.size]
    np.testing.assert_allclose(our_step(packed), np.concatenate([lq.dx0, step]), atol=1e-9)


def test_qp_peers_agree_with_us() -> None:
    rows = {r["solver"]: r for r in quadratic_race(suite_bench(double_integrator(10)), repeat=2)}
    assert set(rows) == {"wbmpc Riccati", "hpipm", "osqp"}
    for row in rows.values():
        assert row["success"] and row["difference"] < 1e-6 and row["step_ms"] > 0.0


def test_a_start_beside_the_guess_moves_the_step() -> None:
    problem = suite_bench(double_integrator(10))
    program, kernel = Program(problem.solver), problem.solver.kernel
    assert kernel is not None
    x, u = np.tile(problem.x0, (11, 1)), np.zeros((10, 1))
    lq = linearize(program, x, u, problem.x0 + np.array([0.3, -0.1]))
    step = our_step(pack(kernel, lq, problem.solver.problem.softness))
    h, g, a, right = matrices(lq)
    z = step[2:]
    np.testing.assert_allclose(a @ z, right, atol=1e-10)
    np.testing.assert_allclose(step[:2], [0.3, -0.1])
    basis = np.linalg.svd(a.toarray())[2][a.shape[0] :]  # directions in which the step may move
    np.testing.assert_allclose(basis @ (h @ z + g), 0.0, atol=1e-8)


# ---------------------------------------------------------------------- C
@pytest.mark.skipif(compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("make", [lambda: double_integrator(12), lambda: ballbot(12)], ids=["integrator", "ballbot"])
def test_the_c_iteration_is_ours(make: Callable[[], Any]) -> None:
    row = yardstick(suite_bench(make()), repeat=5, rounds=1)
    assert row["success"] and row["difference"] < 1e-9
    assert row["ratio"] == row["ours_ms"] / row["c_ms"] > 0.0


def test_c_says_what_it_cannot_do() -> None:
    row = yardstick(suite_bench(cartpole(4)), repeat=1, rounds=1)
    assert not row["success"] and "rk2" in row["error"]


# ---------------------------------------------------------------------- missing and hanging peers
def test_without_its_environment_crocoddyl_is_left_out_with_a_message(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("WBMPC_CACHE_DIR", str(tmp_path))
    assert crocoddyl_peer.environment(install=False) == "its environment has not been made"

    def offline(*_: object, **__: object) -> None:
        raise subprocess.CalledProcessError(1, "pip install")

    monkeypatch.setattr(venv, "create", offline)
    rows = whole.crocoddyl_race()
    assert len(rows) == 3 and all("could not be installed" in r["error"] and not r["success"] for r in rows)
    assert list(tmp_path.glob("crocoddyl/ready")) == []


def test_a_compiler_that_is_ended_leaves_no_process(tmp_path: Path) -> None:
    """Truth: the process that its driver started, as the system knows it."""
    note = tmp_path / "started"
    command = ["sh", "-c", f"sleep 300 & echo $! > {note}; wait"]
    with pytest.raises(subprocess.TimeoutExpired):
        run_whole(command, 2.0)
    started = Path(f"/proc/{note.read_text().strip()}/stat")
    for _ in range(200):
        if not started.exists() or started.read_text().rpartition(")")[2].split()[0] == "Z":
            break
        time.sleep(0.02)
    else:
        pytest.fail("it works on")
    with pytest.raises(subprocess.CalledProcessError):
        run_whole(["sh", "-c", "exit 3"], 20.0)


def _sleep() -> None:
    import time

    time.sleep(60.0)


def test_a_peer_that_hangs_or_dies_ends_with_a_message() -> None:
    assert within(0.5, _sleep) == "no answer in 0 s"
    assert "exit status 3" in within(120.0, os._exit, 3)
    assert within(120.0, float, "x") == "could not convert string to float: 'x'"
    assert within(120.0, float, "2") == 2.0


def test_a_peer_without_a_compiler_runs_interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wbmpc.benchmark.program.compiler", lambda: None)
    problem = suite_bench(double_integrator(8))
    prepared = prepare(problem)
    assert "no C compiler" in prepared.how
    figures = peer_statistics("ipopt", prepared, problem)
    assert figures["success"] and figures["iteration_ms"] > 0.0


# ---------------------------------------------------------------------- closed loop
def test_late_plans_cost_more_and_more_iterations_do_not() -> None:
    problem = suite_bench(double_integrator(20))
    planner = closed_loop.our_planner(problem, [])
    cost = lambda iterations, late: closed_loop.drive(problem, planner, iterations, late, 0, 80, slice(1, 2))
    best = cost(10, 0)
    assert best <= cost(1, 0) * (1.0 + 1e-9)
    assert cost(10, 4) > 1.01 * best


# ---------------------------------------------------------------------- the whole
def test_power_laws_are_found() -> None:
    rows = [{"solver": "s", "problem": "p", "n": n, "iteration_ms": 0.1 * n**1.5} for n in (10, 20, 50)]
    assert slope(rows, "n", "s") == pytest.approx(1.5)
    assert slope(rows[:1], "n", "s") is None


def test_goals_compare_with_the_fastest_peer() -> None:
    rows = [{"problem": "p", "solver": s, "equal_ms": t} for s, t in (("wbmpc SQP", 1.0), ("a", 7.0), ("b", 4.0))]
    rows.append({"problem": "p", "solver": "c", "error": "no answer in 20 s"})  # type: ignore[dict-item]
    sizes = [{"problem": "q", "ratio": 6.0, "goal": 5.0}]
    found = race.goals({"rows": rows, "sizes": sizes, "limits": {"q": {"ratio": 1.4}}, "yardstick": [{"problem": "q"}]})
    assert [(g["value"], g["met"]) for g in found] == [(4.0, False), (6.0, True), (1.4, False), (None, None)]
    assert "faster than b" in found[0]["what"]


def test_the_run_is_one_object_of_known_structure(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    make = lambda limits="soft": suite_bench(double_integrator(6, hard=limits == "hard"))
    monkeypatch.setattr(race, "race_problems", lambda: RaceProblems((make,), {}, {}))
    monkeypatch.setattr(race, "iteration_times", lambda: {"p": {"hard_ms": 1.1, "unlimited_ms": 1.0, "ratio": 1.1}})
    size = {
        "problem": "p",
        "nx": 1,
        "nu": 1,
        "intervals": 5,
        "iteration_ms": 1.0,
        "ocs2_ms": 6.0,
        "ratio": 6.0,
        "goal": 5.0,
    }
    monkeypatch.setattr(race, "size_race", lambda *_: [size])
    monkeypatch.setattr(whole, "crocoddyl_figures", lambda specs: "it could not be installed: offline")
    arm = {"problem": "torque arm, 6 joints", "solver": "wbmpc SQP", "iteration_ms": 1.0, "joints": 6, "limits": 0}
    rows = [{**arm, "intervals": n, "iteration_ms": 0.01 * n} for n in (25, 50)]
    for name in ("over_intervals", "over_joints", "over_limits"):
        monkeypatch.setattr(whole.scaling, name, lambda *_, rows=rows: rows)
    loop = {
        "solver": "wbmpc SQP",
        "budget_ms": 1.0,
        "iterations": 1,
        "late": 0,
        "cost": 2.0,
        "fell": 0,
        "success": True,
    }
    monkeypatch.setattr(whole.closed_loop, "closed_loop_race", lambda *_: [loop])
    seen: list[float] = []
    cores = os.sched_getaffinity(0)
    figures = whole.run_whole_race(2, lambda fraction, note: seen.append(fraction))
    assert os.sched_getaffinity(0) == cores
    assert seen == sorted(seen) and seen[-1] <= 1.0
    assert [r["solver"] for r in figures["rows"]] == ["wbmpc SQP", "fatrop", "ipopt"] * 2
    assert all(r["success"] and r["iteration_ms"] > 0.0 for r in figures["rows"])
    assert [r["limits"] for r in figures["rows"]] == [0] * 3 + [2] * 3
    assert all(r["residual"] < 1e-6 and 0 < r["equal_iterations"] <= r["iterations"] for r in figures["rows"])
    (profile,) = figures["floor"]
    assert profile["operations"] == sum(p["operations"] for p in profile["parts"].values())
    assert sum(p["ms"] for p in profile["parts"].values()) == pytest.approx(profile["iteration_ms"])
    assert {g["what"].split(":")[0] for g in figures["goals"]} >= {"double integrator", "p"}
    files = write(figures, tmp_path)
    assert json.loads(Path(files["json"]).read_text())["goals"] == figures["goals"]
    json.dumps(figures, allow_nan=False)
    page = Path(files["plots"]).read_text()
    assert page.count("plotly-graph-div") >= 3 and "http://" not in page.split("</script>")[-1]
    assert "offline" in Path(files["table"]).read_text() and "Goals" in text(figures)
