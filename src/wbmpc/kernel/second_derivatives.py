"""Machine code of second derivatives: part of a problem's kernel, or compiled when a solve comes to need the exact Hessian."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from wbmpc.kernel import cache
from wbmpc.kernel.codegen_target import compile_module, load_object, target_text
from wbmpc.kernel.scalar import DECLARATIONS, OutputMap, emit_function
from wbmpc.kernel.sizes import Sizes
from wbmpc.ocp import Transcription
from wbmpc.ocp.derivatives import exact_derivatives

#: The functions of second derivatives.
SECOND = ("lagrangian", "dynamics_hessian", "end_lagrangian")


def second_maps(functions: dict[str, ca.Function], lz: int, lx: int, nx: int) -> dict[str, OutputMap]:
    """Where their non-zeros go in matrices of the extended node vector with rows of ``lz`` (at the end ``lx``): both triangles."""
    maps: dict[str, OutputMap] = {}
    extended = lambda c: c if c < nx else c + 1
    for name, ld in zip(SECOND, (lz, lz, lx), strict=True):
        rows, columns = functions[name].sparsity_out(0).get_triplet()
        pairs = [(extended(r), extended(c)) for r, c in zip(rows, columns, strict=True)]
        maps[name] = [[sorted({c * ld + r, r * ld + c}) for r, c in pairs]]
    return maps


@dataclass(frozen=True)
class ExactHessian:
    """Machine code of the exact Hessian's functions: ``addresses`` in the order of :data:`SECOND`."""

    addresses: tuple[int, ...]
    _engine: Any = field(repr=False, default=None)


def build_exact_hessian(
    transcription: Transcription, sizes: Sizes, problem_key: str, use_cache: bool = True
) -> ExactHessian:
    """Compile what the exact Hessian needs beyond a problem's kernel, or load it from the cache.

    Raises :class:`wbmpc.errors.UnsupportedOperation` for an operation that cannot be compiled.
    """
    key = hashlib.sha256(f"exact Hessian {problem_key}".encode()).hexdigest()
    found = cache.load(key, target=target_text()) if use_cache else None
    if found is None:
        functions = exact_derivatives(transcription)
        maps = second_maps(functions, sizes.lz, sizes.lx, sizes.nx)
        parts = [emit_function(functions[name], f"w_{name}", maps[name]) for name in SECOND]
        code = compile_module("\n".join([DECLARATIONS, *parts]))
        if use_cache:
            cache.save(key, code, {"target": target_text()})
    else:
        code = found[0]
    engine = load_object(code)
    return ExactHessian(tuple(engine.get_function_address(f"w_{name}") for name in SECOND), engine)
