"""CasADi SX functions as LLVM IR: straight-line scalar code.

Every emitted function has the signature ``i32 name(double** arg, double** res)``. An output's non-zeros are stored at
the offsets that the caller gives, so that a Jacobian lands in its solver matrix without a scatter table.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import cache

import casadi as ca
import numpy as np

from wbmpc.errors import UnsupportedOperation
from wbmpc.kernel.ir import Lines

#: For every output: for every non-zero, the offsets [doubles] at which its value is stored.
OutputMap = Sequence[Sequence[Sequence[int]]]

_BINARY = {ca.OP_ADD: "fadd", ca.OP_SUB: "fsub", ca.OP_MUL: "fmul", ca.OP_DIV: "fdiv"}
_COMPARE = {ca.OP_LT: "olt", ca.OP_LE: "ole", ca.OP_EQ: "oeq", ca.OP_NE: "une"}
_CALL = {
    ca.OP_SIN: "sin", ca.OP_COS: "cos", ca.OP_TAN: "tan", ca.OP_ASIN: "asin", ca.OP_ACOS: "acos", ca.OP_ATAN: "atan",
    ca.OP_SINH: "sinh", ca.OP_COSH: "cosh", ca.OP_TANH: "tanh", ca.OP_EXP: "exp", ca.OP_LOG: "log",
    ca.OP_SQRT: "llvm.sqrt.f64", ca.OP_FABS: "llvm.fabs.f64", ca.OP_FLOOR: "llvm.floor.f64",
    ca.OP_CEIL: "llvm.ceil.f64", ca.OP_ATAN2: "atan2", ca.OP_POW: "pow", ca.OP_CONSTPOW: "pow", ca.OP_FMIN: "fmin",
    ca.OP_FMAX: "fmax", ca.OP_COPYSIGN: "llvm.copysign.f64", ca.OP_HYPOT: "hypot", ca.OP_ASINH: "asinh",
    ca.OP_ACOSH: "acosh", ca.OP_ATANH: "atanh", ca.OP_EXPM1: "expm1", ca.OP_LOG1P: "log1p", ca.OP_ERF: "erf",
    ca.OP_FMOD: "fmod", ca.OP_REMAINDER: "remainder",
}  # fmt: skip
#: Those of them with two arguments.
TWO = {"atan2", "pow", "fmin", "fmax", "llvm.copysign.f64", "hypot", "fmod", "remainder"}

DECLARATIONS = "\n".join(
    f"declare double @{name}({'double, double' if name in TWO else 'double'}) nounwind memory(none)"
    for name in sorted(set(_CALL.values()))
)


def supported_operations() -> set[int]:
    """The SX operations that can be emitted."""
    special = {ca.OP_NEG, ca.OP_SQ, ca.OP_TWICE, ca.OP_INV, ca.OP_NOT, ca.OP_AND, ca.OP_OR, ca.OP_SIGN}
    return {*_BINARY, *_COMPARE, *_CALL, *special, ca.OP_IF_ELSE_ZERO, ca.OP_ASSIGN, ca.OP_LIFT, ca.OP_ERFINV}


#: What reads, writes and holds numbers.
_PLUMBING = {ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT}


def unsupported_operation(function: ca.Function) -> str:
    """The name of the first SX operation that cannot be emitted; empty if there is none."""
    known = supported_operations() | _PLUMBING
    for k in range(function.n_instructions()):
        op = function.instruction_id(k)
        if op not in known:
            return operation_name(op)
    return ""


def operation_name(op: int) -> str:
    """What CasADi calls an operation, with what it stands for where the name does not say it."""
    name = next((n for n in dir(ca) if n.startswith("OP_") and getattr(ca, n) == op), str(op))
    return f"{name} (a function or lookup table that is called)" if op == ca.OP_CALL else name


@cache
def _inverse_error_function() -> ca.Function:
    """erf⁻¹ in operations that can be emitted: a rational guess of six digits, two steps of Newton's method."""
    x = ca.SX.sym("x")
    size = ca.fabs(x)
    q, z = size * size, ca.sqrt(-ca.log(0.5 * (1.0 - size)))
    near = size * (((-0.140543331 * q + 0.914624893) * q - 1.645349621) * q + 0.886226899)
    near /= (((0.012229801 * q - 0.329097515) * q + 1.442710462) * q - 2.118377725) * q + 1.0
    far = (((1.641345311 * z + 3.429567803) * z - 1.624906493) * z - 1.970840454) / (
        (1.637067800 * z + 3.543889200) * z + 1.0
    )
    y = ca.if_else(size < 0.7, near, far)
    for _ in range(2):
        y = y - (ca.erf(y) - size) / (2.0 / np.sqrt(np.pi) * ca.exp(-y * y))
    return ca.Function("erfinv", [x], [ca.copysign(ca.if_else(size == 1.0, ca.inf, y), x)])


def literal(value: float) -> str:
    """A double as an exact LLVM literal."""
    return "0x{:016X}".format(struct.unpack("<Q", struct.pack("<d", float(value)))[0])


def identity_map(function: ca.Function) -> list[list[list[int]]]:
    """Non-zeros one after the other."""
    return [[[i] for i in range(function.nnz_out(k))] for k in range(function.n_out())]


class Emitter(Lines):
    """One function as straight-line code. The hooks are what numbers and vectors of numbers do differently."""

    number, bit = "double", "i1"

    def __init__(self, function: ca.Function, name: str, outputs: OutputMap) -> None:
        self.f, self.name, self.outputs = function, name, outputs
        self.lines: list[str] = []
        self.count = 0
        self.environment: dict[int, str] = {}
        self.loaded: dict[tuple[int, int], str] = {}

    # ------------------------------------------------------------------ hooks
    def constant(self, value: float) -> str:
        return literal(value)

    def fetch(self, argument: int, index: int) -> str:
        return self.new(f"load double, ptr {self.address(f'a{argument}', index)}")

    def put(self, value: str, result: int, offset: int) -> None:
        self.lines.append(f"store double {value}, ptr {self.address(f'r{result}', offset)}")

    def call(self, name: str, values: list[str]) -> str:
        return self.new(f"call double @{name}({', '.join(f'double {v}' for v in values)})")

    def opening(self) -> list[str]:
        return self.pointers()

    def closing(self) -> list[str]:
        return ["ret i32 0", "}"]

    # ------------------------------------------------------------------ plumbing
    def load(self, argument: int, index: int) -> str:
        key = (argument, index)
        if key not in self.loaded:
            self.loaded[key] = self.fetch(argument, index)
        return self.loaded[key]

    def pointers(self) -> list[str]:
        head = []
        for letter, array, n in (("a", "arg", self.f.n_in()), ("r", "res", self.f.n_out())):
            for i in range(n):
                head.append(f"%p{letter}{i} = getelementptr ptr, ptr %{array}, i64 {i}")
                head.append(f"%{letter}{i} = load ptr, ptr %p{letter}{i}")
        return head

    # ------------------------------------------------------------------ operations
    def truth(self, value: str) -> str:
        return self.new(f"fcmp une {self.number} {value}, {self.constant(0.0)}")

    def as_double(self, bit: str) -> str:
        return self.new(f"uitofp {self.bit} {bit} to {self.number}")

    def select(self, bit: str, yes: str, no: str) -> str:
        return self.new(f"select {self.bit} {bit}, {self.number} {yes}, {self.number} {no}")

    def operation(self, op: int, v: list[str]) -> str:
        if op in _BINARY:
            return self.new(f"{_BINARY[op]} contract {self.number} {v[0]}, {v[1]}")
        if op in _COMPARE:
            return self.as_double(self.new(f"fcmp {_COMPARE[op]} {self.number} {v[0]}, {v[1]}"))
        if op in _CALL:
            return self.call(_CALL[op], v[:2] if _CALL[op] in TWO else v[:1])
        return self._special(op, v)

    def _special(self, op: int, v: list[str]) -> str:
        t, zero = self.number, self.constant(0.0)
        if op in (ca.OP_ASSIGN, ca.OP_LIFT):
            return v[0]
        if op == ca.OP_ERFINV:
            return self._inline(_inverse_error_function(), v[0])
        if op == ca.OP_NEG:
            return self.new(f"fneg {t} {v[0]}")
        if op == ca.OP_SQ:
            return self.new(f"fmul contract {t} {v[0]}, {v[0]}")
        if op == ca.OP_TWICE:
            return self.new(f"fadd {t} {v[0]}, {v[0]}")
        if op == ca.OP_INV:
            return self.new(f"fdiv {t} {self.constant(1.0)}, {v[0]}")
        if op == ca.OP_NOT:
            return self.as_double(self.new(f"fcmp oeq {t} {v[0]}, {zero}"))
        if op in (ca.OP_AND, ca.OP_OR):
            word = "and" if op == ca.OP_AND else "or"
            return self.as_double(self.new(f"{word} {self.bit} {self.truth(v[0])}, {self.truth(v[1])}"))
        if op == ca.OP_IF_ELSE_ZERO:
            return self.select(self.truth(v[0]), v[1], zero)
        if op == ca.OP_SIGN:
            positive = self.new(f"fcmp ogt {t} {v[0]}, {zero}")
            negative = self.new(f"fcmp olt {t} {v[0]}, {zero}")
            return self.select(positive, self.constant(1.0), self.select(negative, self.constant(-1.0), v[0]))
        raise UnsupportedOperation(f"function '{self.name}': the SX operation {operation_name(op)} cannot be compiled")

    def _inline(self, function: ca.Function, value: str) -> str:
        """A function of one number, at this place."""
        found, last = dict[int, str](), ""
        for k in range(function.n_instructions()):
            op, o, i = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
            if op == ca.OP_CONST:
                found[o[0]] = self.constant(function.instruction_constant(k))
            elif op == ca.OP_INPUT:
                found[o[0]] = value
            elif op == ca.OP_OUTPUT:
                last = found[i[0]]
            else:
                found[o[0]] = self.operation(op, [found[j] for j in i])
        return last

    def emit(self) -> str:
        head = [f"define i32 @{self.name}(ptr noalias readonly %arg, ptr noalias readonly %res) nounwind {{"]
        head += self.opening()
        self.instructions()
        return "\n".join([*head, *self.lines, *self.closing()])

    def instructions(self) -> None:
        """All of them, one after the other."""
        for k in range(self.f.n_instructions()):
            self.instruction(k)

    def instruction(self, k: int) -> None:
        f = self.f
        op, o = f.instruction_id(k), f.instruction_output(k)
        if op == ca.OP_CONST:
            self.environment[o[0]] = self.constant(f.instruction_constant(k))
        elif op == ca.OP_INPUT:
            argument, index = f.instruction_input(k)
            self.environment[o[0]] = self.load(argument, index)
        elif op == ca.OP_OUTPUT:
            value = self.environment[f.instruction_input(k)[0]]
            for offset in self.outputs[o[0]][o[1]]:
                self.put(value, o[0], offset)
        else:
            values = [self.environment[i] for i in f.instruction_input(k)]
            self.environment[o[0]] = self.operation(op, values)


def emit_function(function: ca.Function, name: str, outputs: OutputMap | None = None) -> str:
    """LLVM IR of one SX function. Structural zeros are not stored."""
    return Emitter(function, name, identity_map(function) if outputs is None else outputs).emit()
