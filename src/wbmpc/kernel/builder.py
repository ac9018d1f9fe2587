"""LLVM IR of one function in the making: lines, labels, stack slots of variables, conversions."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable, Mapping
from typing import Any

from wbmpc.errors import KernelError
from wbmpc.kernel.ir import BOOL, INT, LANES, NUM, VEC, Signature, Type, Value, alignment, llvm_type


class Builder:
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

    def new(self, text: str) -> str:
        self.count += 1
        self.lines.append(f"%v{self.count} = {text}")
        return f"%v{self.count}"

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
