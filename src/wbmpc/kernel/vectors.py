"""Translation of what works on eight numbers at a time."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable, Mapping
from typing import Any

from wbmpc.errors import KernelError
from wbmpc.kernel.ir import BOOL, INT, LANES, MASK, NUM, VEC, Lines, Signature, Type, Value, alignment, llvm_type


class Builder(Lines):
    """One function. ``signatures`` finds the signature of another function of the library by its Python object."""

    def __init__(
        self, function: Callable[..., Any], signature: Signature, signatures: Callable[[Any], Signature | None]
    ) -> None:
        tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
        assert isinstance(tree, ast.FunctionDef)
        self.tree, self.signature, self.signatures = tree, signature, signatures
        self.names: Mapping[str, Any] = function.__globals__
        self.head: list[str] = []
        self.lines: list[str] = []
        self.slots: dict[str, tuple[Type, str]] = {}
        self.loops: list[tuple[str, str]] = []  # labels of continue and break
        self.count = 0

    def fail(self, node: ast.AST, text: str) -> KernelError:
        return KernelError(f"{self.tree.name}, line {getattr(node, 'lineno', 0)}: {text}: {ast.unparse(node)[:80]}")

    def label(self) -> str:
        self.count += 1
        return f"b{self.count}"

    def start(self, label: str) -> None:
        self.lines.append(f"{label}:")

    def jump(self, label: str) -> None:
        self.lines.append(f"br label %{label}")

    def branch(self, condition: str, yes: str, no: str) -> None:
        self.lines.append(f"br i1 {condition}, label %{yes}, label %{no}")

    def slot(self, kind: Type) -> str:
        self.count += 1
        self.head.append(f"%s{self.count} = alloca {llvm_type(kind)}")
        return f"%s{self.count}"

    def store(self, value: Value, slot: str) -> None:
        self.lines.append(f"store {llvm_type(value.kind)} {value.text}, ptr {slot}{alignment(value.kind)}")

    def convert(self, value: Value, kind: Type, node: ast.AST) -> Value:
        if value.kind == kind:
            return value
        if isinstance(kind, tuple) and isinstance(value.kind, tuple) and len(kind) == len(value.kind):
            parts = zip(self.unpack(value), kind, strict=True)
            return self.pack([self.convert(part, k, node) for part, k in parts])
        how = {
            (INT, NUM): "sitofp i64 {} to double",
            (BOOL, NUM): "uitofp i1 {} to double",
            (BOOL, INT): "zext i1 {} to i64",
        }
        if (value.kind, kind) in how:
            return Value(kind, self.new(how[value.kind, kind].format(value.text)))  # type: ignore[index]
        if kind == VEC:
            return self.spread(self.convert(value, NUM, node))
        if kind == BOOL and value.kind == INT:
            return Value(BOOL, self.new(f"icmp ne i64 {value.text}, 0"))
        raise self.fail(node, f"cannot make {value.kind} into {kind}")

    def spread(self, value: Value) -> Value:
        """A number in every lane."""
        t = llvm_type(VEC)
        one = self.new(f"insertelement {t} poison, double {value.text}, i32 0")
        return Value(VEC, self.new(f"shufflevector {t} {one}, {t} poison, <{LANES} x i32> zeroinitializer"))

    def pack(self, parts: list[Value]) -> Value:
        kind = tuple(str(p.kind) for p in parts)
        text = "poison"
        for i, part in enumerate(parts):
            element = f"{llvm_type(part.kind)} {part.text}"
            text = self.new(f"insertvalue {llvm_type(kind)} {text}, {element}, {i}")
        return Value(kind, text)

    def unpack(self, whole: Value) -> list[Value]:
        t = llvm_type(whole.kind)
        return [Value(k, self.new(f"extractvalue {t} {whole.text}, {i}")) for i, k in enumerate(whole.kind)]

    def value(self, node: ast.expr) -> Value:
        """The value of an expression, by the method ``of_…`` of its kind."""
        method = getattr(self, f"of_{type(node).__name__}", None)
        if method is None:
            raise self.fail(node, "this expression cannot be translated")
        return method(node)  # type: ignore[no-any-return]


#: No assumption that numbers are finite: the driver must see a NaN.
FAST = "reassoc nsz arcp contract"
ARITHMETIC: dict[type[ast.AST], str] = {ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul"}
COMPARE: dict[type[ast.AST], tuple[str, str]] = {
    ast.Lt: ("olt", "slt"), ast.LtE: ("ole", "sle"), ast.Gt: ("ogt", "sgt"), ast.GtE: ("oge", "sge"), ast.Eq: ("oeq", "eq"),
    ast.NotEq: ("une", "ne"),
}  # fmt: skip


class Vectors(Builder):
    """Arithmetic, comparisons and functions of vectors."""

    def by_element(self, op: ast.operator, a: Value, b: Value, node: ast.AST) -> Value:
        """Arithmetic of vectors; a number meets every lane."""
        word = "div" if isinstance(op, ast.Div) else ARITHMETIC.get(type(op))
        if word is None:
            raise self.fail(node, "this operator cannot be translated")
        a, b = self.convert(a, VEC, node), self.convert(b, VEC, node)
        return Value(VEC, self.new(f"f{word} {FAST} {llvm_type(VEC)} {a.text}, {b.text}"))

    def compare_lanes(self, op: ast.cmpop, a: Value, b: Value, node: ast.AST) -> Value:
        a, b = self.convert(a, VEC, node), self.convert(b, VEC, node)
        return Value(MASK, self.new(f"fcmp {COMPARE[type(op)][0]} {llvm_type(VEC)} {a.text}, {b.text}"))

    def select(self, mask: Value, yes: Value, no: Value, node: ast.AST) -> Value:
        if mask.kind != MASK:
            raise self.fail(node, "np.where needs a comparison of vectors")
        t, a, b = llvm_type(VEC), self.convert(yes, VEC, node), self.convert(no, VEC, node)
        return Value(VEC, self.new(f"select {llvm_type(MASK)} {mask.text}, {t} {a.text}, {t} {b.text}"))

    def of_vectors(self, name: str, node: ast.Call) -> Value | None:
        """Functions of NumPy that take or give vectors; None for another name."""
        t = llvm_type(VEC)
        if name == "where":
            mask, yes, no = (self.value(a) for a in node.args)
            return self.select(mask, yes, no, node)
        if name == "full":
            return self.convert(self.value(node.args[1]), VEC, node)
        if name in ("maximum", "minimum"):
            a, b = (self.convert(self.value(e), VEC, node) for e in node.args)
            return self.select(self.compare_lanes(ast.Gt() if name == "maximum" else ast.Lt(), b, a, node), b, a, node)
        if name == "max":
            whole = self.convert(self.value(node.args[0]), VEC, node)
            return Value(NUM, self.new(f"call double @llvm.vector.reduce.fmax.v{LANES}f64({t} {whole.text})"))
        if name == "sum":
            whole = self.convert(self.value(node.args[0]), VEC, node)
            start = f"double -0.0, {t} {whole.text}"
            return Value(NUM, self.new(f"call reassoc double @llvm.vector.reduce.fadd.v{LANES}f64({start})"))
        if name == "all":
            mask = self.value(node.args[0])
            return Value(BOOL, self.new(f"call i1 @llvm.vector.reduce.and.v{LANES}i1({llvm_type(MASK)} {mask.text})"))
        return None
