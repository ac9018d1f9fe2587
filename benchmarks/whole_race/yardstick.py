"""What a C compiler makes of the same functions and the same algorithm: `benchmarks/c` of the checkout, a yardstick."""

from __future__ import annotations

import ctypes
import hashlib
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from wbmpc.benchmark.problems import Problem
from wbmpc.benchmark.program import Program, Samples, compiler, library_folder, sampled
from wbmpc.benchmark.race import milliseconds, single_iteration
from wbmpc.kernel import Kernel
from wbmpc.kernel.cache import trusted_file
from wbmpc.kernel.compiled import output_maps
from wbmpc.kernel.riccati import RELATIVE_SOFTNESS
from wbmpc.ocp import Transcription
from whole_race.lq import LQProblem, eliminate, linearize, pack

SOURCE = Path(__file__).parents[1] / "c" / "iteration.c"
FLAGS = (
    "-O3",
    "-march=native",
    "-mprefer-vector-width=512",
    "-fno-math-errno",
    "-ffp-contract=fast",
    "-shared",
    "-fPIC",
)
#: Functions that the C code calls; CasADi's name, where it is another one.
FUNCTIONS = {
    "dynamics": "dynamics",
    "dynamics_jacobian": "dynamics_jacobian",
    "cost": "cost_value",
    "cost_quadratic": "cost_quadratic",
    "equality": "equality",
    "equality_jacobian": "equality_jacobian",
    "terminal": "terminal",
    "terminal_quadratic": "terminal_quadratic",
}


def _scatter(name: str, places: Sequence[Sequence[int]]) -> str:
    lines = [f"    m[{place}] = v[{i}];" for i, targets in enumerate(places) for place in targets]
    return "\n".join([f"static inline void scatter_{name}(const double *v, double *m) {{", *lines, "}"])


def generated(t: Transcription, kernel: Kernel, width: int, weights: int) -> str:
    """Sizes, CasADi's C code and tables: what comes before ``iteration.c``."""
    s, functions = kernel.sizes, {**t.values, **t.derivatives}
    generator = ca.CodeGenerator("functions.c", {"with_header": False, "verbose": False})
    for name, own in FUNCTIONS.items():
        generator.add(ca.Function(own, *_as_sx(functions[name])))
    sizes = {
        "N": t.ocp.intervals, "NX": s.nx, "NU": s.nu, "NG": s.ng, "NZ": s.nz, "LX": s.lx, "LZ": s.lz, "LG": s.lg,
        "NP": width, "NW": weights, "NB": len(t.path.barriers), "NBE": len(t.end.barriers),
        "BUFFER": max(f.nnz_out(i) for f in functions.values() for i in range(f.n_out())) + 1,
        "RELATIVE": RELATIVE_SOFTNESS,
    }  # fmt: skip
    maps = output_maps(functions, s)
    tables = [
        _scatter(f"{name}_{i}", maps[name][i])
        for name, outputs in (("dynamics_jacobian", (1,)), ("cost_quadratic", (1, 2)), ("terminal_quadratic", (1, 2)))
        for i in outputs
    ]
    if s.ng:
        tables += [_scatter(f"equality_jacobian_{i}", maps["equality_jacobian"][i]) for i in (0, 1)]
    rows: list[list[int]] = [[] for _ in range(s.nx)]
    for r, c in zip(*functions["dynamics_jacobian"].sparsity_out(1).get_triplet(), strict=True):
        if c < s.nx:
            rows[r].append(c)
    starts, flat = np.cumsum([0, *(len(r) for r in rows)]), [c for r in rows for c in r]
    numbers = lambda values: "{" + ", ".join(str(v) for v in [*values, 0]) + "}"
    tables.append(f"static const int pattern_start[] = {numbers(starts)}, pattern[] = {numbers(flat)};")
    return "\n".join([generator.dump(), *(f"#define {k} {v}" for k, v in sizes.items()), *tables])


def _as_sx(f: ca.Function) -> tuple[list[Any], list[Any]]:
    inputs = f.sx_in()
    return inputs, list(f.call(inputs))


def build(code: str, seconds: float = 300.0) -> ctypes.CDLL | str:
    """The shared library of the generated code with ``iteration.c``; a message when it cannot be made."""
    found = compiler()
    if found is None:
        return "no C compiler (cc, gcc) was found"
    if not SOURCE.exists():
        return "benchmarks/c is in a checkout only"
    text = code + "\n" + SOURCE.read_text()
    key = hashlib.sha256((text + found + " ".join(FLAGS)).encode()).hexdigest()[:32]
    folder = library_folder()
    library = folder / f"c-{key}.so"
    if not trusted_file(library):
        source, partial = library.with_suffix(".c"), library.with_suffix(".part.so")
        source.write_text(text)
        command = [found, *FLAGS, "-o", str(partial), str(source), "-lm"]
        try:
            subprocess.run(command, check=True, capture_output=True, text=True, timeout=seconds)
        except subprocess.TimeoutExpired:
            return f"the C compiler took more than {seconds:.0f} s"
        except subprocess.CalledProcessError as error:
            return f"the C compiler failed: {error.stderr[:200]}"
        partial.chmod(0o700)
        partial.replace(library)
    return ctypes.CDLL(str(library))


def _address(array: np.ndarray) -> ctypes.c_void_p:
    assert array.flags.c_contiguous
    return ctypes.c_void_p(array.ctypes.data)


def _prepare(library: ctypes.CDLL, t: Transcription, samples: Samples, lg: int) -> None:
    extended = lambda place: place + (place >= t.nx)
    table = lambda rows: np.array([[extended(b.variable), *b[1:]] for b in rows] or [[0.0] * 5])
    grid = np.concatenate([[0.0], np.cumsum(samples.h)])
    eps = np.zeros(lg)
    eps[: t.equality.shape[0]] = t.softness + 1e-14
    p = samples.p if samples.p.shape[1] else np.zeros((grid.size, 1))
    w = samples.w if samples.w.size else np.zeros(1)
    arrays = [np.ascontiguousarray(a, float) for a in (grid, p, w, eps, table(t.path.barriers), table(t.end.barriers))]
    library.setup(*(_address(a) for a in arrays))


def yardstick(problem: Problem, repeat: int = 200, rounds: int = 5) -> dict[str, Any]:
    """Milliseconds of one iteration and of the backward pass alone, ours and C's, in turn; the least of all rounds.

    ``difference``: largest between the trajectories after one iteration from a disturbed solution.
    """
    solver, t = problem.solver, problem.solver.problem
    kernel = solver.kernel
    assert kernel is not None
    if t.path.rows or t.end.rows or t.ocp.integrator != "rk2" or t.ocp.dynamics.unit_quaternions or t.jumps:
        return {"problem": problem.name, "success": False, "error": "only rk2 with relaxed barriers is written in C"}
    samples = sampled(solver)
    width, weights = max(samples.p.shape[1], 1), max(samples.w.size, 1)
    library = build(generated(t, kernel, width, weights))
    if isinstance(library, str):
        return {"problem": problem.name, "success": False, "error": library}
    library.iterate.restype = ctypes.c_double
    _prepare(library, t, samples, kernel.sizes.lg)
    solver.warm_start(problem.x0, problem.u0)
    solution, rng = solver.solve(problem.x0), np.random.default_rng(0)
    x0, x = np.ascontiguousarray(problem.x0), np.ascontiguousarray(solution.x)
    u = solution.u + 1e-3 * rng.normal(size=solution.u.shape)  # the states stay: rows of parallel wheels are consistent
    library.guess(_address(x), _address(u))
    library.iterate(_address(x0))
    after_x, after_u = np.empty_like(x), np.empty_like(u)
    library.trajectory(_address(after_x), _address(after_u))
    single = single_iteration(solver, x, u)
    single.iterate(x0)
    ours = single.trajectory(copy=False)
    difference = max(np.abs(ours.x - after_x).max(), np.abs(ours.u - after_u).max())
    lq = linearize(Program(solver), solution.x, solution.u, problem.x0)
    times = _race(library, single, lq, kernel, t, x0, repeat, rounds)
    return {
        "problem": problem.name,
        "success": True,
        **times,
        "ratio": times["ours_ms"] / times["c_ms"],
        "riccati_ratio": times["ours_riccati_ms"] / times["c_riccati_ms"],
        "difference": float(difference),
    }


def _race(
    library: ctypes.CDLL, single: Any, lq: LQProblem, kernel: Kernel, t: Transcription, x0: np.ndarray, repeat: int,
    rounds: int,
) -> dict[str, float]:  # fmt: skip
    packed = pack(kernel, lq, t.softness)
    node = ctypes.c_long(packed.e[0].size)
    given = [_address(a) for a in (packed.ab, packed.h, packed.e)]
    start = _address(x0)
    calls = {
        "ours_ms": lambda: single.iterate(x0),
        "c_ms": lambda: library.iterate(start),
        "ours_riccati_ms": lambda: eliminate(packed),
        "c_riccati_ms": lambda: library.eliminate(*given, node, _address(packed.end), _address(packed.k)),
    }
    best = dict.fromkeys(calls, np.inf)
    for _ in range(rounds):
        for name, call in calls.items():
            best[name] = min(best[name], float(milliseconds(call, repeat).min()))
    return best
