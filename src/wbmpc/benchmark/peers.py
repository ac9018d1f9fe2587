"""IPOPT and Fatrop of CasADi's wheel on the same program, with the same Gauss-Newton Hessian.

Where there is a C compiler the program's functions are compiled; else they run in CasADi's interpreter, and Fatrop, to
whose interface no Hessian can be handed then, takes the exact one.

One measure for all: how far a point is from the optimality conditions, for any solver and scaling.

Multipliers are not asked for, since every solver scales its own. They are those of least squares: for equalities g = 0 with
multipliers λ and inequalities h ≥ 0 with ν ≥ 0 they make ∇f − g_xᵀ λ − h_xᵀ ν and the products h ν as small as can be (Nocedal
and Wright 2006, section 18.3, for equalities alone). Any multipliers bound the distance from above, these do so tightly.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from queue import Empty
from time import monotonic
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from wbmpc.arrays import Array
from wbmpc.benchmark.problems import Problem
from wbmpc.benchmark.program import Program, compiled_library

#: Solvers are compared at points that are this close to the conditions (the tables say 1e-6).
EQUAL = 1e-6
#: Keeps the multipliers of dependent rows finite.
_DAMPING = 1e-12


class Residual(NamedTuple):
    """Largest violation of a row (of a limit: in units of its range), largest entry of the Lagrangian's gradient, largest
    product h ν."""

    primal: float
    dual: float
    complementarity: float

    @property
    def largest(self) -> float:
        return max(self)

    @property
    def figure(self) -> float | None:
        """The largest for a table; None for a point that is not finite."""
        return self.largest if np.isfinite(self.largest) else None


def least_squares(gradient: Array, jacobian: sp.csc_matrix, weights: Array, signed: Array) -> Array:
    """y that makes |∇f − Jᵀ y|² + |w y|² small, y ≥ 0 where ``signed``: (rows,). Negative ones are left out, in turn."""
    rows, free = jacobian.shape[0], np.ones(jacobian.shape[0], bool)
    y = np.zeros(rows)
    for _ in range(30):
        matrix = sp.vstack([jacobian[free].T, sp.diags(weights[free])], format="csc")
        equations = sp.bmat(
            [[sp.eye(matrix.shape[0]), matrix], [matrix.T, -_DAMPING * sp.eye(free.sum())]], format="csc"
        )
        right = np.concatenate([gradient, np.zeros(matrix.shape[1] + free.sum())])
        y[:] = 0.0
        y[free] = splu(equations).solve(right)[matrix.shape[0] :]
        negative = free & signed & (y < 0.0)
        if not negative.any():
            return y
        free &= ~negative
    return np.where(signed, np.maximum(y, 0.0), y)


class Measure:
    """The residual of points of one program."""

    def __init__(self, program: Program) -> None:
        arguments = [program.x, program.p]
        self._rows = ca.Function("rows", arguments, [program.constraints(), program.jacobian()])
        self._gradient = ca.Function("gradient", arguments, [program.gradient()])
        self._equality = program.equality()

    def __call__(self, x: Array, u: Array, x0: Array) -> Residual:
        """At states x (N + 1, nx) and inputs u (N, nu), for the measured state x0 (nx,)."""
        z = np.concatenate([np.hstack([x[:-1], u]).ravel(), x[-1]])
        if not np.isfinite(z).all():
            return Residual(np.inf, np.inf, np.inf)
        value, slope = self._rows(z, x0)
        rows, gradient = np.array(value).ravel(), np.array(ca.densify(self._gradient(z, x0))).ravel()
        jacobian = sp.csc_matrix(slope.sparse())
        weights = np.where(self._equality, 0.0, np.maximum(rows, 0.0))
        y = least_squares(gradient, jacobian, weights, ~self._equality)
        primal = np.where(self._equality, np.abs(rows), np.maximum(-rows, 0.0))
        left = gradient - jacobian.T @ y
        return Residual(*(float(np.abs(v).max(initial=0.0)) for v in (primal, left, weights * y)))


def to_equal_residual(
    attempt: Callable[[int], tuple[float, Array, Array]], maximum: int, measure: Callable[[Array, Array], Residual]
) -> dict[str, Any]:
    """Fewest iterations, up to ``maximum``, after which the residual is at most :data:`EQUAL`, by bisection, and their time.

    ``attempt(iterations)``: milliseconds and the point (x, u). Nothing when even ``maximum`` are not enough.
    """
    low, high, found = 0, maximum, attempt(maximum)
    if not measure(*found[1:]).largest <= EQUAL:
        return {}
    while high - low > 1:
        middle = (low + high) // 2
        tried = attempt(middle)
        if measure(*tried[1:]).largest <= EQUAL:
            high, found = middle, tried
        else:
            low = middle
    return {"equal_iterations": high, "equal_ms": found[0]}


def _child(queue: Any, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    silence = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):  # some peers print whatever their settings say
        os.dup2(silence, stream)
    try:
        queue.put(function(*arguments))
    except Exception as error:  # the parent reports it
        lines = str(error).splitlines() or [type(error).__name__]
        queue.put(lines[-1][:200])


def within(seconds: float, function: Callable[..., Any], *arguments: Any) -> Any:
    """``function(*arguments)`` in a child process; a message (str) when it fails, dies or takes too long."""
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_child, args=(queue, function, arguments), daemon=True)
    child.start()
    end = monotonic() + seconds
    try:
        while True:
            try:
                return queue.get(timeout=min(0.5, max(end - monotonic(), 0.01)))
            except Empty:
                if monotonic() >= end:
                    return f"no answer in {seconds:.0f} s"
                if not child.is_alive() and queue.empty():
                    return f"ended with exit status {child.exitcode}"
    finally:
        child.kill()
        child.join()


#: A peer that has not answered after this time [s] is stopped and reported so.
PEER_SECONDS = 20.0
#: The same for all its solves until the common measure is met [s].
EQUAL_SECONDS = 60.0
#: On the optimality conditions, as each solver measures them.
TOLERANCE = 1e-8
PEERS = ("fatrop", "ipopt")
_OPTIONS = {"print_time": False, "calc_lam_p": False, "calc_lam_x": False}


@dataclass(frozen=True)
class Prepared:
    """A program ready for the peers: functions by name, and the library with their compiled form or why there is none."""

    program: Program
    functions: dict[str, ca.Function]
    library: Path | str

    @property
    def how(self) -> str:
        """How the functions are evaluated, as a note."""
        if isinstance(self.library, Path):
            return "functions compiled, Gauss-Newton Hessian"
        return f"functions interpreted ({self.library})"


def prepare(problem: Problem, compile_functions: bool = True) -> Prepared:
    """The program of a problem, compiled if possible and asked for."""
    program = Program(problem.solver)
    functions = program.functions()
    library = compiled_library(functions) if compile_functions else "not asked for"
    return Prepared(program, functions, library)


def nlp_solver(name: str, prepared: Prepared, iterations: int, tolerance: float) -> ca.Function:
    """The peer with its program: at most ``iterations``, to ``tolerance``."""
    options: dict[str, Any] = dict(_OPTIONS)
    compiled = isinstance(prepared.library, Path)
    get = lambda f: ca.external(f, str(prepared.library)) if compiled else prepared.functions[f]
    if name == "fatrop":
        options |= {"structure_detection": "auto", "equality": prepared.program.equality().tolist()}
        options |= {"fatrop.print_level": 0, "fatrop.tolerance": tolerance, "fatrop.max_iter": iterations}
    else:
        options |= {"ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": tolerance, "ipopt.max_iter": iterations}
        options |= {"jac_g": get("nlp_jac_g"), "grad_f": get("grad_f"), "hess_lag": get("hess_lag")}
    return ca.nlpsol("peer", name, get("nlp"), options)


def _fastest(
    solver: ca.Function, guess: np.ndarray, x0: np.ndarray, above: np.ndarray, repeat: int
) -> tuple[float, Any]:
    """Least time [s] of ``repeat`` solves, of fewer once two seconds are spent, and what the last one found."""
    times: list[float] = []
    found = None
    while len(times) < repeat and sum(times) < 2.0:
        start = time.process_time()
        found = solver(x0=guess, p=x0, lbg=0.0, ubg=above)
        times.append(time.process_time() - start)
    return min(times), found


def _bounds(prepared: Prepared, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A guess as the program's unknowns, and the rows' upper bounds."""
    above = np.where(prepared.program.equality(), 0.0, np.inf)
    return np.concatenate([np.hstack([x[:-1], u]).ravel(), x[-1]]), above


def solve_with(
    name: str, prepared: Prepared, x0: np.ndarray, x: np.ndarray, u: np.ndarray, repeat: int = 5
) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Solve from a guess x (N + 1, nx), u (N, nu): states, inputs, and figures of the fastest of ``repeat`` solves.

    An iteration's time is that of the solve without that of one of no iterations: what CasADi needs to set up is not the
    peer's.
    """
    guess, above = _bounds(prepared, x, u)
    setup, _ = _fastest(nlp_solver(name, prepared, 0, TOLERANCE), guess, x0, above, repeat)
    solver = nlp_solver(name, prepared, 300, TOLERANCE)
    best, found = _fastest(solver, guess, x0, above, repeat)
    stats = solver.stats()
    steps = max(int(stats["iter_count"]), 1)
    functions = sum(v for k, v in stats.items() if k.startswith("t_proc_nlp_"))
    states, inputs = prepared.program.trajectory(np.array(found["x"]).ravel())
    return states, inputs, {
        "success": bool(stats["success"]),
        "iterations": steps,
        "total_ms": 1e3 * best,
        "setup_ms": 1e3 * setup,
        "iteration_ms": 1e3 * max(best - setup, 0.0) / steps,
        "functions_share": min(float(functions / best), 1.0),
        "how": prepared.how,
    }  # fmt: skip


def peer_statistics(name: str, prepared: Prepared, problem: Problem, measure: Measure | None = None) -> dict[str, Any]:
    """Figures from the common guess: the start, held, with the guess's first input. With ``measure``: by it, too."""
    n = prepared.program.n
    start = (np.tile(problem.x0, (n + 1, 1)), np.tile(problem.u0, (n, 1)))
    found = within(PEER_SECONDS, solve_with, name, prepared, problem.x0, *start)
    if isinstance(found, str):
        return {"success": False, "error": found}
    x, u, figures = found
    if measure is None:
        return dict(figures)
    equal = within(EQUAL_SECONDS, equal_statistics, name, prepared, problem.x0, start, figures, measure)
    return {**figures, "residual": measure(x, u, problem.x0).figure, **({} if isinstance(equal, str) else equal)}


def equal_statistics(
    name: str, prepared: Prepared, x0: np.ndarray, start: tuple[np.ndarray, np.ndarray], figures: dict[str, Any],
    measure: Measure,
) -> dict[str, Any]:  # fmt: skip
    """Iterations and time, without set-up, until the common measure is met; ``figures``: of the solve to the end."""
    guess, above = _bounds(prepared, *start)

    def attempt(iterations: int) -> tuple[float, np.ndarray, np.ndarray]:
        best, found = _fastest(nlp_solver(name, prepared, iterations, TOLERANCE), guess, x0, above, 3)
        return max(1e3 * best - figures["setup_ms"], 0.0), *prepared.program.trajectory(np.array(found["x"]).ravel())

    return to_equal_residual(attempt, figures["iterations"], lambda x, u: measure(x, u, x0))


def peer(
    name: str, prepared: Prepared, problem: Problem, x: np.ndarray, u: np.ndarray, measure: Measure
) -> dict[str, Any]:
    """Figures from the common guess; and from our solution with 1e-3 of noise, for the difference of the solutions."""
    figures = peer_statistics(name, prepared, problem, measure)
    if "error" in figures:
        return {**figures, "difference": None}
    rng = np.random.default_rng(0)
    near_x, near_u = x + 1e-3 * rng.normal(size=x.shape), u + 1e-3 * rng.normal(size=u.shape)
    near = within(PEER_SECONDS, solve_with, name, prepared, problem.x0, near_x, near_u)
    if isinstance(near, str) or not near[2]["success"]:
        return {**figures, "difference": None}
    difference = max(float(np.abs(near[0] - x).max()), float(np.abs(near[1] - u).max()))
    return {**figures, "from_nearby": near[2], "difference": difference}
