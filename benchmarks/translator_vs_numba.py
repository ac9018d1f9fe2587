"""Functions of the solver's driver, compiled by this project's translator and by Numba: start-up and time of a call.

``python benchmarks/translator_vs_numba.py --numba-python PYTHON``, where PYTHON has Numba and this project's dependencies (Numba is none
of them). Every case runs in a process of its own: first with an empty cache, then with what that left. Both compile the same Python
functions, with all that they call, and work on the same memory of a solver: that of a swerve base with an arm and hard limits, 100 intervals.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

#: By module and name: loops over numbers; the shift of a receding horizon; rows eight at a time.
FUNCTIONS = {
    "moved": ("wbmpc.solver.termination", ()),
    "shift": ("wbmpc.solver.receding", (1e-3,)),
    "rows_step": ("wbmpc.solver.inequalities", (0.995,)),
}
CALLS, REPEATS = 2000, 7


def closure(function: Any, found: dict[str, Any]) -> dict[str, Any]:
    """A function of the driver and all functions of the driver that it calls, by symbol."""
    from wbmpc.kernel.library import Function

    if function.signature.symbol not in found:
        found[function.signature.symbol] = function
        for name in function.python.__code__.co_names:
            called = function.python.__globals__.get(name)
            if isinstance(called, Function):
                closure(called, found)
    return found


def translated(function: Any) -> Callable[..., object]:
    """As a library of its own, called through ctypes as the solver calls its driver."""
    from wbmpc.kernel.library import Library

    library = Library(f"benchmark {function.signature.symbol}", packages=("solver", "kernel"))
    library.functions = list(closure(function, {}).values())
    library.build()
    function.library = library
    return function.__call__  # type: ignore[no-any-return]


def with_numba(function: Any, made: dict[int, Any] | None = None) -> Callable[..., object]:
    """The same source, decorated with ``numba.njit``; so are the functions that it calls."""
    import numba

    from wbmpc.kernel.library import Function

    made = {} if made is None else made
    if id(function) not in made:
        names = dict(function.python.__globals__)
        for name in function.python.__code__.co_names:
            called = names.get(name)
            names[name] = with_numba(called, made) if isinstance(called, Function) else called
        names = {name: value for name, value in names.items() if value is not None}
        copy = types.FunctionType(function.python.__code__, names, function.python.__name__)
        copy.__module__ = function.python.__module__
        made[id(function)] = numba.njit(copy, cache=True, fastmath={"contract", "reassoc", "arcp", "nsz"})
    return made[id(function)]  # type: ignore[no-any-return]


def measure(compiler: str, name: str, data: Path) -> dict[str, Any]:
    """Seconds until the first result, and microseconds of a call (least of several rounds)."""
    module, more = FUNCTIONS[name]
    start = time.perf_counter()
    if compiler == "numba":
        import numba  # noqa: F401
    else:
        import llvmlite.binding  # noqa: F401
    imported = time.perf_counter() - start
    function = getattr(__import__(module, fromlist=[name]), name)
    arrays = np.load(data)
    m, o = arrays["memory"], arrays["table"]
    start = time.perf_counter()
    try:
        call = with_numba(function) if compiler == "numba" else translated(function)
        result = call(m.copy(), o, *more)
    except Exception as error:  # what a compiler cannot do is a result
        return {"error": f"{type(error).__name__}: {str(error).strip().splitlines()[-1][:160]}"}
    first = time.perf_counter() - start
    after = m.copy()
    call(after, o, *more)
    rounds, work = [], m.copy()
    for _ in range(REPEATS):
        start = time.perf_counter()
        for _ in range(CALLS):
            call(work, o, *more)
        rounds.append(1e6 * (time.perf_counter() - start) / CALLS)
    check = float(np.abs(after[np.isfinite(after)]).sum()) + (float(result) if isinstance(result, float) else 0.0)  # type: ignore[arg-type]
    return {"import_s": imported, "first_s": first, "call_us": min(rounds), "check": check}


def save_memory(path: Path) -> None:
    """Memory and table of a solver after a few iterations."""
    from wbmpc.solver import SQP
    from wbmpc.studies.race.robots import swerve_bench

    problem = swerve_bench(100, SQP.real_time(3))
    problem.solver.iterate(problem.x0)
    np.savez(path, memory=problem.solver.ws.memory, table=problem.solver.ws.table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--numba-python", default=sys.executable, help="an interpreter with Numba")
    parser.add_argument("--measure", nargs=3, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.measure:
        print(json.dumps(measure(given.measure[0], given.measure[1], Path(given.measure[2]))))
        return
    print(
        "| function | compiler | import [s] | first call, cold [s] | first call, cached [s] | a call [µs] |\n|---|---|---|---|---|---|"
    )
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder, "memory.npz")
        save_memory(data)
        for name in FUNCTIONS:
            for compiler, python in (("translator", sys.executable), ("numba", given.numba_python)):
                cache = str(Path(folder, compiler, name))
                environment = {**os.environ, "WBMPC_CACHE_DIR": cache, "NUMBA_CACHE_DIR": cache}
                command = [python, __file__, "--measure", compiler, name, str(data)]
                cold, cached = (
                    json.loads(
                        subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout
                    )
                    for _ in range(2)
                )
                if "error" in cold:
                    print(f"| {name} | {compiler} | {cold['error']} | | | |")
                    continue
                figures = (cold["import_s"], cold["first_s"], cached["first_s"], cached["call_us"])
                print(
                    f"| {name} | {compiler} | {' | '.join(f'{f:.3g}' for f in figures)} | <!-- {cached['check']:.12g} -->",
                    flush=True,
                )


if __name__ == "__main__":
    main()
