"""IPOPT and Fatrop of CasADi's wheel on the same program, with the same Gauss-Newton Hessian.

Where there is a C compiler the program's functions are compiled; else they run in CasADi's interpreter, and Fatrop, to
whose interface no Hessian can be handed then, takes the exact one.
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
from typing import Any

import casadi as ca
import numpy as np

from wbmpc.benchmark.problems import Problem
from wbmpc.benchmark.program import Program, compiled_library
from wbmpc.benchmark.residual import Measure, to_equal_residual


def _child(queue: Any, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    silence = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):  # some peers print whatever they are reported
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
    name: str,
    prepared: Prepared,
    x0: np.ndarray,
    start: tuple[np.ndarray, np.ndarray],
    figures: dict[str, Any],
    measure: Measure,
) -> dict[str, Any]:
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
