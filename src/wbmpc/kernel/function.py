"""A CasADi function as machine code that is evaluated for many arguments in one call."""

from __future__ import annotations

import hashlib
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from wbmpc.kernel import cache
from wbmpc.kernel.codegen_target import compile_module, load_object, target_text
from wbmpc.kernel.ir import Floats, Integers, PointerCall
from wbmpc.kernel.library import Library
from wbmpc.kernel.scalar import DECLARATIONS, emit_function
from wbmpc.kernel.step import bind

LIBRARY = Library("functions", packages=("kernel",))
call2 = PointerCall(2)


@LIBRARY.step
def evaluate(
    n: int, address: int, columns: int, rows: int, arguments: Floats, results: Floats, table: Integers
) -> None:
    """Results (n, rows) of ``arguments`` (n, columns) by the function at ``address``."""
    for k in range(n):
        table[0] = arguments.ctypes.data + 8 * k * columns
        table[1] = results.ctypes.data + 8 * k * rows
        call2(address, table.ctypes.data, table.ctypes.data + 8)


class CompiledFunction:
    """``function(arguments)`` (n, columns) are results (n, rows) of an SX function of one vector with one dense vector as its result.

    Compiled, or loaded from the cache, when it is made. Raises :class:`~wbmpc.errors.UnsupportedOperation` for an operation that cannot
    be compiled. ``shape``: (columns, rows).
    """

    def __init__(self, function: ca.Function) -> None:
        self._function, self.shape = function, (function.numel_in(0), function.numel_out(0))
        text = f"function {function.serialize()} {cache.source_fingerprint(('kernel',))} {target_text()}"
        key = hashlib.sha256(text.encode())
        found = cache.load(key.hexdigest(), target=target_text())
        if found is None:
            code = compile_module("\n".join([DECLARATIONS, emit_function(function, "w_function")]))
            cache.save(key.hexdigest(), code, {"target": target_text()})
        else:
            code = found[0]
        self._engine = load_object(code)
        #: of its code, as :class:`PointerCall` calls it
        self.address = int(self._engine.get_function_address("w_function"))
        self._table = np.zeros(2, np.int64)

    def __call__(self, arguments: NDArray[np.float64]) -> NDArray[np.float64]:
        given, (columns, rows) = np.ascontiguousarray(arguments, float), self.shape
        results = np.zeros((len(given), rows))
        evaluate(len(given), self.address, columns, rows, given.reshape(-1), results.reshape(-1), self._table)
        return results

    def evaluator(self, capacity: int) -> Evaluator:
        """The function with memory of its own for up to ``capacity`` arguments, for one thread: a call costs microseconds less."""
        return Evaluator(self, capacity)

    def __reduce__(self) -> Any:
        """Machine code does not leave its process: a copy compiles, or loads, its own."""
        return CompiledFunction, (self._function,)


class Evaluator:
    """``evaluator(n)`` are the results (n, rows) of the first n rows of its ``arguments`` (capacity, columns): views, which the next call
    changes."""

    def __init__(self, function: CompiledFunction, capacity: int) -> None:
        self._function, self._capacity = function, capacity
        columns, rows = function.shape
        flat: dict[str, NDArray[Any]] = {
            "arguments": np.zeros(capacity * columns),
            "results": np.zeros(capacity * rows),
            "table": np.zeros(2, np.int64),
        }
        self.arguments = flat["arguments"].reshape(capacity, columns)
        self._results = flat["results"].reshape(capacity, rows)
        self._evaluate = bind(evaluate, flat, address=function.address, columns=columns, rows=rows)

    def __call__(self, n: int) -> NDArray[np.float64]:
        self._evaluate(n)
        return self._results[:n]

    def __reduce__(self) -> Any:
        return Evaluator, (self._function, self._capacity)
