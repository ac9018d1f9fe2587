"""Types, values and signatures of translated functions, and what they are in LLVM IR."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

#: Types: number, integer, truth value, array of numbers, array of integers, nothing; several numbers are a tuple of these.
NUM, INT, BOOL, NUMS, INTS, NONE = "F", "I", "B", "M", "O", "V"
#: Vectors of numbers and of truth values, and how many are in one.
VEC, MASK, LANES = "X", "Y", 8
NUM2, NUM3, NUM4, NUM6 = ((NUM,) * n for n in (2, 3, 4, 6))
INT2, INT3 = (INT,) * 2, (INT,) * 3
Type = str | tuple[str, ...]

_LLVM = {NUM: "double", INT: "i64", BOOL: "i1", NUMS: "ptr", INTS: "ptr", NONE: "void"}
_LLVM |= {VEC: f"<{LANES} x double>", MASK: f"<{LANES} x i1>"}

DECLARATIONS = "\n".join(
    f"declare double @llvm.{n}.f64(double{', double' if n == 'pow' else ''}) nounwind memory(none)"
    for n in ("sqrt", "log", "exp", "floor", "fabs", "pow")
)
DECLARATIONS += f"""
declare {_LLVM[VEC]} @llvm.fabs.v{LANES}f64({_LLVM[VEC]}) nounwind memory(none)
declare {_LLVM[VEC]} @llvm.sqrt.v{LANES}f64({_LLVM[VEC]}) nounwind memory(none)
declare double @llvm.vector.reduce.fmax.v{LANES}f64({_LLVM[VEC]}) nounwind memory(none)
declare double @llvm.vector.reduce.fadd.v{LANES}f64(double, {_LLVM[VEC]}) nounwind memory(none)
declare i1 @llvm.vector.reduce.and.v{LANES}i1({_LLVM[MASK]}) nounwind memory(none)"""


def llvm_type(kind: Type) -> str:
    """The LLVM type of a type."""
    return _LLVM[kind] if isinstance(kind, str) else "{" + ", ".join(_LLVM[k] for k in kind) + "}"


def alignment(kind: Type) -> str:
    """Slices start anywhere, so vectors are only as aligned as numbers."""
    return ", align 8" if kind == VEC else ""


class Signature(NamedTuple):
    """LLVM name, result and argument types of a function that translated code may call."""

    symbol: str
    result: Type
    arguments: tuple[Type, ...]


class Value(NamedTuple):
    """A typed LLVM value."""

    kind: Type
    text: str


@dataclass(frozen=True)
class PointerCall:
    """``call(address, p1 … pn)``: a compiled function that takes ``count`` pointers, all given as integers."""

    count: int

    def __call__(self, address: int, *pointers: int) -> None:
        import ctypes

        ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * self.count)(address)(*pointers)
