"""Types, values and signatures of translated functions, and what they are in LLVM IR."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, overload

import numpy as np
from numpy.typing import NDArray

from wbmpc.errors import KernelError

#: Types: number, integer, truth value, array of numbers, array of integers, nothing; several numbers are a tuple of these.
NUM, INT, BOOL, NUMS, INTS, NONE = "F", "I", "B", "M", "O", "V"
#: Vectors of numbers and of truth values, and how many are in one.
VEC, MASK, LANES = "X", "Y", 8
Type = str | tuple[str, ...]

#: Eight numbers, and eight truth values.
Vector = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Floats(Protocol):
    """A contiguous array of float64 in translated code: element ``m[i]``, vector ``m[i : i + LANES]``, address ``m.ctypes.data``."""

    @property
    def ctypes(self) -> Any: ...

    @overload
    def __getitem__(self, index: int, /) -> float: ...
    @overload
    def __getitem__(self, index: slice, /) -> Vector: ...
    @overload
    def __setitem__(self, index: int, value: float, /) -> None: ...
    @overload
    def __setitem__(self, index: slice, value: Vector | float, /) -> None: ...


class Integers(Protocol):
    """A contiguous array of int64 in translated code."""

    @property
    def ctypes(self) -> Any: ...

    def __getitem__(self, index: int, /) -> int: ...
    def __setitem__(self, index: int, value: int, /) -> None: ...


_ANNOTATIONS: dict[str, str] = {
    "float": NUM, "int": INT, "bool": BOOL, "Floats": NUMS, "Integers": INTS, "None": NONE, "Vector": VEC, "Mask": MASK,
}  # fmt: skip


def _annotated(function: Callable[..., Any], text: object) -> Type:
    name = text if isinstance(text, str) else getattr(text, "__name__", str(text))
    if name in _ANNOTATIONS:
        return _ANNOTATIONS[name]
    parts = [part.strip() for part in name.removeprefix("tuple[").removesuffix("]").split(",")]
    if not name.startswith("tuple[") or any(part not in _ANNOTATIONS for part in parts):
        valid = ", ".join(_ANNOTATIONS)
        raise KernelError(
            f"{function.__name__}: annotation {name!r} cannot be translated; valid: {valid}, or a tuple of these"
        )
    return tuple(_ANNOTATIONS[part] for part in parts)


_LLVM = {NUM: "double", INT: "i64", BOOL: "i1", NUMS: "ptr", INTS: "ptr", NONE: "void"}
_LLVM |= {VEC: f"<{LANES} x double>", MASK: f"<{LANES} x i1>"}

DECLARATIONS = "\n".join(
    f"declare double @llvm.{n}.f64(double{', double' if n == 'pow' else ''}) nounwind memory(none)"
    for n in ("sqrt", "log", "exp", "floor", "fabs", "pow", "sin", "cos")
)
DECLARATIONS += f"""
declare double @asin(double) nounwind memory(none)
declare double @atan2(double, double) nounwind memory(none)
declare {_LLVM[VEC]} @llvm.fabs.v{LANES}f64({_LLVM[VEC]}) nounwind memory(none)
declare {_LLVM[VEC]} @llvm.sqrt.v{LANES}f64({_LLVM[VEC]}) nounwind memory(none)
declare double @llvm.vector.reduce.fmax.v{LANES}f64({_LLVM[VEC]}) nounwind memory(none)
declare double @llvm.vector.reduce.fadd.v{LANES}f64(double, {_LLVM[VEC]}) nounwind memory(none)
declare i1 @llvm.vector.reduce.and.v{LANES}i1({_LLVM[MASK]}) nounwind memory(none)"""


def llvm_type(kind: Type) -> str:
    return _LLVM[kind] if isinstance(kind, str) else "{" + ", ".join(_LLVM[k] for k in kind) + "}"


def alignment(kind: Type) -> str:
    """Slices start anywhere, so vectors are only as aligned as numbers."""
    return ", align 8" if kind == VEC else ""


class Parameter(NamedTuple):
    """A parameter of a function, or a field of a record: its name, and its record, a ``NamedTuple`` of numbers, arrays and records, which
    is passed as one argument for each number and array in it; None for a value, which has a ``kind``."""

    name: str
    record: Callable[..., Any] | None
    fields: tuple[Parameter, ...] = ()
    kind: Type = NONE

    @classmethod
    def of(cls, function: Callable[..., Any], name: str, annotation: object, names: dict[str, Any]) -> Parameter:
        """From its annotation, of which ``names`` has the records."""
        text = getattr(annotation, "__forward_arg__", annotation)
        record = names.get(text) if isinstance(text, str) else text
        if not (isinstance(record, type) and issubclass(record, tuple) and hasattr(record, "_fields")):
            return cls(name, None, (), _annotated(function, text))
        own = vars(sys.modules[record.__module__])
        fields = (cls.of(function, field, record.__annotations__[field], own) for field in record._fields)
        return cls(name, record, tuple(fields))

    @property
    def values(self) -> list[Parameter]:
        """The parameter itself, or all numbers and arrays of its record."""
        return [value for field in self.fields for value in field.values] if self.record else [self]

    @property
    def places(self) -> list[str]:
        """What translated code calls its arguments."""
        inner = [place for field in self.fields for place in field.places]
        return [f"{self.name}.{place}" for place in inner] if self.record else [self.name]

    def structured(self, values: Iterator[Any]) -> Any:
        """The next of flat arguments as the function's source takes them."""
        return self.record(*[field.structured(values) for field in self.fields]) if self.record else next(values)

    def flat(self, value: Any) -> list[Any]:
        """Its arguments of machine code."""
        if self.record is None:
            return [value]
        return [v for field, part in zip(self.fields, value, strict=True) for v in field.flat(part)]


class Signature(NamedTuple):
    """LLVM name, result and parameters of a function that translated code may call, with the types and names of its arguments: those of
    a record are its numbers and arrays, by their own names."""

    symbol: str
    result: Type
    arguments: tuple[Type, ...]
    names: tuple[str, ...]
    parameters: tuple[Parameter, ...]

    @classmethod
    def of(cls, function: Callable[..., Any]) -> Signature:
        """The signature of a function of translated Python from its annotations (as text: ``from __future__ import annotations``)."""
        signature = inspect.signature(function)
        known = function.__globals__
        parameters = [Parameter.of(function, p.name, p.annotation, known) for p in signature.parameters.values()]
        values = [value for p in parameters for value in p.values]
        symbol = f"{function.__module__.rsplit('.', 1)[-1]}_{function.__name__}"
        result = _annotated(function, signature.return_annotation)
        kinds, names = tuple(v.kind for v in values), tuple(v.name for v in values)
        return cls(symbol, result, kinds, names, tuple(parameters))

    def structured(self, flat: Sequence[Any]) -> list[Any]:
        """Flat arguments as the function's source takes them."""
        values = iter(flat)
        return [p.structured(values) for p in self.parameters]

    def flat(self, structured: Sequence[Any]) -> list[Any]:
        """The arguments of machine code."""
        return [v for p, value in zip(self.parameters, structured, strict=True) for v in p.flat(value)]


class Lines:
    """LLVM IR of one function in the making: ``lines``, and how many values have a name."""

    lines: list[str]
    count: int

    def new(self, text: str) -> str:
        self.count += 1
        self.lines.append(f"%v{self.count} = {text}")
        return f"%v{self.count}"

    def address(self, array: str, offset: int) -> str:
        return self.new(f"getelementptr double, ptr %{array}, i64 {offset}")


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

        ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * self.count)(int(address))(*map(int, pointers))
