"""The library of the driver's compiled functions, and calls of the kernels by address."""

from __future__ import annotations

from wbmpc.kernel.ir import LANES, Floats, Integers, Mask, PointerCall, Vector
from wbmpc.kernel.library import Library

LIBRARY = Library("driver", packages=("solver", "kernel", "ocp"), modules=("wbmpc.solver.receding",))
compiled = LIBRARY.compiled
call2, call3, call4, call5, call6, call7 = (PointerCall(n) for n in (2, 3, 4, 5, 6, 7))

__all__ = [
    "LANES", "LIBRARY", "Floats", "Integers", "Mask", "Vector", "call2", "call3", "call4", "call5", "call6", "call7",
    "compiled",
]  # fmt: skip
