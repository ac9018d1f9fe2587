"""CasADi SX functions as LLVM IR: straight-line scalar code.

Every emitted function has the signature ``i32 name(double** arg, double** res)``. An output's non-zeros are stored at
the places that the caller gives, so that a Jacobian lands in its solver matrix without a scatter table.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import casadi as ca

from wbmpc.errors import KernelError

#: For every output: for every non-zero, the offsets [doubles] at which its value is stored.
OutputMap = Sequence[Sequence[Sequence[int]]]

_BINARY = {ca.OP_ADD: "fadd", ca.OP_SUB: "fsub", ca.OP_MUL: "fmul", ca.OP_DIV: "fdiv"}
_COMPARE = {ca.OP_LT: "olt", ca.OP_LE: "ole", ca.OP_EQ: "oeq", ca.OP_NE: "une"}
_CALL = {
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    ca.OP_TAN: "tan",
    ca.OP_ASIN: "asin",
    ca.OP_ACOS: "acos",
    ca.OP_ATAN: "atan",
    ca.OP_SINH: "sinh",
    ca.OP_COSH: "cosh",
    ca.OP_TANH: "tanh",
    ca.OP_EXP: "exp",
    ca.OP_LOG: "log",
    ca.OP_SQRT: "llvm.sqrt.f64",
    ca.OP_FABS: "llvm.fabs.f64",
    ca.OP_FLOOR: "llvm.floor.f64",
    ca.OP_CEIL: "llvm.ceil.f64",
    ca.OP_ATAN2: "atan2",
    ca.OP_POW: "pow",
    ca.OP_CONSTPOW: "pow",
    ca.OP_FMIN: "fmin",
    ca.OP_FMAX: "fmax",
    ca.OP_COPYSIGN: "llvm.copysign.f64",
    ca.OP_HYPOT: "hypot",
}
_TWO = {"atan2", "pow", "fmin", "fmax", "llvm.copysign.f64", "hypot"}

DECLARATIONS = "\n".join(
    f"declare double @{name}({'double, double' if name in _TWO else 'double'}) nounwind memory(none)"
    for name in sorted(set(_CALL.values()))
)


def supported_operations() -> set[int]:
    """The SX operations that can be emitted."""
    special = {ca.OP_NEG, ca.OP_SQ, ca.OP_TWICE, ca.OP_INV, ca.OP_NOT, ca.OP_AND, ca.OP_OR, ca.OP_SIGN}
    return {*_BINARY, *_COMPARE, *_CALL, *special, ca.OP_IF_ELSE_ZERO, ca.OP_ASSIGN}


def literal(value: float) -> str:
    """A double as an exact LLVM literal."""
    return "0x{:016X}".format(struct.unpack("<Q", struct.pack("<d", float(value)))[0])


def identity_map(function: ca.Function) -> list[list[list[int]]]:
    """Non-zeros one after the other."""
    return [[[i] for i in range(function.nnz_out(k))] for k in range(function.n_out())]


class _Emitter:
    def __init__(self, function: ca.Function, name: str, outputs: OutputMap) -> None:
        self.f, self.name, self.outputs = function, name, outputs
        self.lines: list[str] = []
        self.count = 0
        self.environment: dict[int, str] = {}
        self.loaded: dict[tuple[int, int], str] = {}

    def new(self, text: str) -> str:
        self.count += 1
        self.lines.append(f"%v{self.count} = {text}")
        return f"%v{self.count}"

    def address(self, array: str, offset: int) -> str:
        return self.new(f"getelementptr double, ptr %{array}, i64 {offset}")

    def load(self, argument: int, index: int) -> str:
        key = (argument, index)
        if key not in self.loaded:
            self.loaded[key] = self.new(f"load double, ptr {self.address(f'a{argument}', index)}")
        return self.loaded[key]

    def truth(self, value: str) -> str:
        return self.new(f"fcmp une double {value}, {literal(0.0)}")

    def as_double(self, bit: str) -> str:
        return self.new(f"uitofp i1 {bit} to double")

    def operation(self, op: int, v: list[str]) -> str:
        if op in _BINARY:
            return self.new(f"{_BINARY[op]} contract double {v[0]}, {v[1]}")
        if op in _COMPARE:
            return self.as_double(self.new(f"fcmp {_COMPARE[op]} double {v[0]}, {v[1]}"))
        if op in _CALL:
            name = _CALL[op]
            given = ", ".join(f"double {a}" for a in (v[:2] if name in _TWO else v[:1]))
            return self.new(f"call double @{name}({given})")
        return self._special(op, v)

    def _special(self, op: int, v: list[str]) -> str:
        zero = literal(0.0)
        if op == ca.OP_ASSIGN:
            return v[0]
        if op == ca.OP_NEG:
            return self.new(f"fneg double {v[0]}")
        if op == ca.OP_SQ:
            return self.new(f"fmul contract double {v[0]}, {v[0]}")
        if op == ca.OP_TWICE:
            return self.new(f"fadd double {v[0]}, {v[0]}")
        if op == ca.OP_INV:
            return self.new(f"fdiv double {literal(1.0)}, {v[0]}")
        if op == ca.OP_NOT:
            return self.as_double(self.new(f"fcmp oeq double {v[0]}, {zero}"))
        if op in (ca.OP_AND, ca.OP_OR):
            word = "and" if op == ca.OP_AND else "or"
            return self.as_double(self.new(f"{word} i1 {self.truth(v[0])}, {self.truth(v[1])}"))
        if op == ca.OP_IF_ELSE_ZERO:
            return self.new(f"select i1 {self.truth(v[0])}, double {v[1]}, double {zero}")
        if op == ca.OP_SIGN:
            positive = self.new(f"fcmp ogt double {v[0]}, {zero}")
            negative = self.new(f"fcmp olt double {v[0]}, {zero}")
            low = self.new(f"select i1 {negative}, double {literal(-1.0)}, double {v[0]}")
            return self.new(f"select i1 {positive}, double {literal(1.0)}, double {low}")
        name = next((n for n in dir(ca) if n.startswith("OP_") and getattr(ca, n) == op), str(op))
        raise KernelError(f"function '{self.name}': the SX operation {name} cannot be compiled")

    def emit(self) -> str:
        f = self.f
        head = [f"define i32 @{self.name}(ptr noalias readonly %arg, ptr noalias readonly %res) nounwind {{"]
        for letter, array, n in (("a", "arg", f.n_in()), ("r", "res", f.n_out())):
            for i in range(n):
                head.append(f"%p{letter}{i} = getelementptr ptr, ptr %{array}, i64 {i}")
                head.append(f"%{letter}{i} = load ptr, ptr %p{letter}{i}")
        for k in range(f.n_instructions()):
            op, o = f.instruction_id(k), f.instruction_output(k)
            if op == ca.OP_CONST:
                self.environment[o[0]] = literal(f.instruction_constant(k))
            elif op == ca.OP_INPUT:
                argument, index = f.instruction_input(k)
                self.environment[o[0]] = self.load(argument, index)
            elif op == ca.OP_OUTPUT:
                value = self.environment[f.instruction_input(k)[0]]
                for offset in self.outputs[o[0]][o[1]]:
                    self.lines.append(f"store double {value}, ptr {self.address(f'r{o[0]}', offset)}")
            else:
                values = [self.environment[i] for i in f.instruction_input(k)]
                self.environment[o[0]] = self.operation(op, values)
        return "\n".join([*head, *self.lines, "ret i32 0", "}"])


def emit_function(function: ca.Function, name: str, outputs: OutputMap | None = None) -> str:
    """LLVM IR of one SX function. Structural zeros are not stored."""
    return _Emitter(function, name, identity_map(function) if outputs is None else outputs).emit()
