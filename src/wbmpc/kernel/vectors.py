"""Translation of what works on eight numbers at a time."""

from __future__ import annotations

import ast

from wbmpc.kernel.builder import Builder
from wbmpc.kernel.ir import BOOL, LANES, MASK, NUM, VEC, Value, llvm_type

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
