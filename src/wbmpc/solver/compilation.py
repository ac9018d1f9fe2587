"""How the numba driver is compiled and how it calls machine code by address."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from wbmpc.kernel.cache import cache_directory, source_fingerprint

#: No assumption that numbers are finite: the driver must see a NaN.
FAST = {"contract", "reassoc", "arcp", "nsz"}


def _numba_directory() -> str | None:
    """A folder of its own for every version of the driver: numba does not survive a renamed type in its index."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return os.environ["NUMBA_CACHE_DIR"]
    directory = cache_directory() / f"numba-{source_fingerprint(('solver', 'kernel'))[:16]}"
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return str(directory) if os.access(directory, os.W_OK) else None


_DIRECTORY = _numba_directory()


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """``numba.njit`` without the interpreter lock, cached beside the kernels where that is possible."""
    if _DIRECTORY is not None:
        setattr(numba.config, "CACHE_DIR", _DIRECTORY)  # noqa: B010  numba does not declare it
    options: dict[str, Any] = {"nogil": True, "fastmath": FAST, "error_model": "numpy", "cache": _DIRECTORY is not None}
    return numba.njit(**options)(function)  # type: ignore[no-any-return]


def pointer_call(count: int) -> Any:
    """A callable for compiled code: ``call(address, p1 … pn)`` with ``count`` pointers given as integers."""

    @intrinsic
    def call(typing_context: Any, address: Any, *pointers: Any) -> Any:
        signature = types.void(types.int64, types.StarArgTuple([types.int64] * count))

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            byte = ir.IntType(8).as_pointer()
            kind = ir.FunctionType(ir.VoidType(), [byte] * count)
            target = builder.inttoptr(arguments[0], kind.as_pointer())
            given = [builder.inttoptr(builder.extract_value(arguments[1], i), byte) for i in range(count)]
            builder.call(target, given)
            return context.get_dummy_value()

        return signature, generate

    return call


call2, call5, call7 = pointer_call(2), pointer_call(5), pointer_call(7)
