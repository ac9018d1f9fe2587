"""How fast this core multiplies matrices: what figures of speed are measured on."""

from __future__ import annotations

from functools import cache

import numpy as np

from wbmpc.benchmark.ours import milliseconds
from wbmpc.kernel import dense
from wbmpc.kernel.codegen_target import compile_module, load_object, vector_budget
from wbmpc.kernel.ir import Floats, PointerCall
from wbmpc.kernel.library import Library
from wbmpc.solver.workspace import aligned

LIBRARY = Library("machine speed")
call4 = PointerCall(4)


compiled = LIBRARY.compiled


@compiled
def repeat_product(address: int, a: Floats, b: Floats, c: Floats, count: int) -> None:
    """One matrix product many times."""
    for _ in range(count):
        call4(address, a.ctypes.data, b.ctypes.data, c.ctypes.data, c.ctypes.data)


@cache
def peak_gflops(inner: int = 48) -> float:
    """GFLOP/s of one core on products (24 × ``inner``)(``inner`` × 48) in the first-level cache, by our own kernel."""
    ir = dense.FMA + "\n" + dense.matrix_product("peak", 3, 48, inner, 24, inner, 1, 24, None, False, vector_budget())
    engine = load_object(compile_module(ir))
    a, b, c = aligned(24 * inner), aligned(48 * inner), aligned(24 * 48)
    a[:], b[:], count = 1.0, 1.0, 1000
    address = engine.get_function_address("peak")
    times = milliseconds(lambda: repeat_product(address, a, b, c, count), 20)
    return float(2 * 24 * 48 * inner * count / times.min() / 1e6)


def matrix_product_speed() -> float:
    """GFLOP/s of one core on products of 512 x 512 matrices by NumPy's BLAS."""
    a = np.random.default_rng(0).normal(size=(512, 512))
    return float(2 * 512**3 / milliseconds(lambda: a @ a, 5).min() / 1e6)
