"""A small subset of Python as LLVM IR: what the solver's driver is written in.

Numbers (float, int, bool), flat arrays of float64 and int64, tuples of numbers as results; assignments, ``for … in range``,
``while``, ``if``, arithmetic, comparisons, a few functions of NumPy, calls of other such functions, calls by address. No
allocation, no exceptions, no bounds checks. ``//`` and ``%`` are meant for non-negative integers.

Eight numbers at a time: ``m[i : i + LANES]`` is one vector, to read or to write; arithmetic and comparisons by element,
``np.full``, ``np.where``, ``np.maximum``, ``np.minimum``, ``np.sqrt``, ``abs``, ``&``, and ``np.max``, ``np.sum``, ``np.all``
of a vector.

The same functions run as ordinary Python, which is how the interpreted twin and the tests use them (there a slice is a view:
read it before it is written to).
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from wbmpc.errors import KernelError
from wbmpc.kernel.scalar import literal

#: Types: number, integer, truth value, array of numbers, array of integers, nothing; several numbers are a tuple of these.
NUM, INT, BOOL, NUMS, INTS, NONE = "F", "I", "B", "M", "O", "V"
#: Vectors of numbers and of truth values, and how many are in one.
VEC, MASK, LANES = "X", "Y", 8
NUM2, NUM3, NUM4, NUM6 = ((NUM,) * n for n in (2, 3, 4, 6))
INT2, INT3 = (INT,) * 2, (INT,) * 3
Type = str | tuple[str, ...]

#: Functions of more instructions are compiled once, not where they are called: half as much code, seconds at the first start.
LARGE = 50

_LLVM = {NUM: "double", INT: "i64", BOOL: "i1", NUMS: "ptr", INTS: "ptr", NONE: "void"}
_LLVM |= {VEC: f"<{LANES} x double>", MASK: f"<{LANES} x i1>"}
#: No assumption that numbers are finite: the driver must see a NaN.
_FAST = "reassoc nsz arcp contract"
_ARITHMETIC: dict[type[ast.AST], str] = {ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul"}
_WHOLE: dict[type[ast.AST], str] = {ast.FloorDiv: "sdiv", ast.Mod: "srem"}
_COMPARE: dict[type[ast.AST], tuple[str, str]] = {
    ast.Lt: ("olt", "slt"), ast.LtE: ("ole", "sle"), ast.Gt: ("ogt", "sgt"), ast.GtE: ("oge", "sge"), ast.Eq: ("oeq", "eq"),
    ast.NotEq: ("une", "ne"),
}  # fmt: skip
_NUMPY = {"sqrt": "llvm.sqrt.f64", "log": "llvm.log.f64", "exp": "llvm.exp.f64", "floor": "llvm.floor.f64"}

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


def _alignment(kind: Type) -> str:
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


class Translator:
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

    # ------------------------------------------------------------------ plumbing
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
        self.lines.append(f"store {llvm_type(value.kind)} {value.text}, ptr {slot}{_alignment(value.kind)}")

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

    # ------------------------------------------------------------------ statements
    def translate(self) -> str:
        """The function as LLVM IR."""
        given = []
        names = [a.arg for a in self.tree.args.args]
        if len(names) != len(self.signature.arguments):
            raise self.fail(self.tree, "the signature has another number of arguments")
        for name, kind in zip(names, self.signature.arguments, strict=True):
            given.append(f"{llvm_type(kind)}{' noalias' if kind in (NUMS, INTS) else ''} %a.{name}")
            if kind in (NUMS, INTS):
                self.slots[name] = (kind, f"%a.{name}")
            else:
                self.assign_name(name, Value(kind, f"%a.{name}"), self.tree)
        self.block(self.tree.body)
        self.lines.append("ret void" if self.signature.result == NONE else "unreachable")
        large = len(self.lines) > LARGE and VEC not in (*self.signature.arguments, *self.signature.result)
        rules = "nounwind noinline" if large else "nounwind"
        head = f"define {llvm_type(self.signature.result)} @{self.signature.symbol}({', '.join(given)}) {rules} {{"
        return "\n".join([head, *self.head, *self.lines, "}"])

    def block(self, body: list[ast.stmt]) -> None:
        for statement in body:
            method = getattr(self, f"do_{type(statement).__name__}", None)
            if method is None:
                raise self.fail(statement, "this statement cannot be translated")
            method(statement)

    def do_Expr(self, node: ast.Expr) -> None:
        if not isinstance(node.value, ast.Constant):
            self.value(node.value)

    def do_Pass(self, node: ast.Pass) -> None:
        pass

    def do_Return(self, node: ast.Return) -> None:
        result = self.signature.result
        if node.value is None:
            self.lines.append("ret void")
        else:
            value = self.convert(self.value(node.value), result, node)
            self.lines.append(f"ret {llvm_type(result)} {value.text}")
        self.start(self.label())

    def pack(self, parts: list[Value]) -> Value:
        kind = tuple(str(p.kind) for p in parts)
        text = "poison"
        for i, part in enumerate(parts):
            given = f"{llvm_type(part.kind)} {part.text}"
            text = self.new(f"insertvalue {llvm_type(kind)} {text}, {given}, {i}")
        return Value(kind, text)

    def unpack(self, whole: Value) -> list[Value]:
        t = llvm_type(whole.kind)
        return [Value(k, self.new(f"extractvalue {t} {whole.text}, {i}")) for i, k in enumerate(whole.kind)]

    def do_Assign(self, node: ast.Assign) -> None:
        if len(node.targets) != 1:
            raise self.fail(node, "one target only")
        target = node.targets[0]
        if isinstance(target, ast.Tuple):
            if isinstance(node.value, ast.Tuple):
                values = [self.value(e) for e in node.value.elts]
            else:
                whole = self.value(node.value)
                if not isinstance(whole.kind, tuple):
                    raise self.fail(node, "one value for several targets")
                values = self.unpack(whole)
            if len(values) != len(target.elts):
                raise self.fail(node, "another number of values than targets")
            for one, value in zip(target.elts, values, strict=True):
                self.assign(one, value, node)
        else:
            self.assign(target, self.value(node.value), node)

    def assign(self, target: ast.expr, value: Value, node: ast.AST) -> None:
        if isinstance(target, ast.Name):
            self.assign_name(target.id, value, node)
        elif isinstance(target, ast.Subscript):
            pointer, kind = self.element(target)
            self.store(self.convert(value, kind, node), pointer)
        else:
            raise self.fail(node, "cannot assign to this")

    def assign_name(self, name: str, value: Value, node: ast.AST) -> None:
        if name not in self.slots:
            self.slots[name] = (value.kind, self.slot(value.kind))
        kind, slot = self.slots[name]
        if kind in (NUMS, INTS):
            raise self.fail(node, "an array cannot be replaced")
        self.store(self.convert(value, kind, node), slot)

    def do_AugAssign(self, node: ast.AugAssign) -> None:
        if isinstance(node.target, ast.Subscript):
            pointer, kind = self.element(node.target)
            old = Value(kind, self.new(f"load {llvm_type(kind)}, ptr {pointer}{_alignment(kind)}"))
            result = self.binary(node.op, old, self.value(node.value), node)
            self.store(self.convert(result, kind, node), pointer)
        else:
            assert isinstance(node.target, ast.Name)
            result = self.binary(node.op, self.name(node.target), self.value(node.value), node)
            self.assign_name(node.target.id, result, node)

    def do_If(self, node: ast.If) -> None:
        yes, no, after = self.label(), self.label(), self.label()
        self.branch(self.truth(node.test), yes, no)
        self.start(yes)
        self.block(node.body)
        self.jump(after)
        self.start(no)
        self.block(node.orelse)
        self.jump(after)
        self.start(after)

    def do_While(self, node: ast.While) -> None:
        test, body, after = self.label(), self.label(), self.label()
        self.jump(test)
        self.start(test)
        self.branch(self.truth(node.test), body, after)
        self.start(body)
        self.loops.append((test, after))
        self.block(node.body)
        self.loops.pop()
        self.jump(test)
        self.start(after)

    def do_For(self, node: ast.For) -> None:
        call = node.iter
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "range"):
            raise self.fail(node, "only range can be iterated")
        bounds = [self.convert(self.value(a), INT, node) for a in call.args]
        low, high = (Value(INT, "0"), bounds[0]) if len(bounds) == 1 else bounds[:2]
        step = self.constant_step(call)
        assert isinstance(node.target, ast.Name)
        counter = self.slot(INT)
        self.store(low, counter)
        test, body, following, after = (self.label() for _ in range(4))
        self.jump(test)
        self.start(test)
        now = self.new(f"load i64, ptr {counter}")
        self.branch(self.new(f"icmp {'slt' if step > 0 else 'sgt'} i64 {now}, {high.text}"), body, after)
        self.start(body)
        self.assign_name(node.target.id, Value(INT, now), node)
        self.loops.append((following, after))
        self.block(node.body)
        self.loops.pop()
        self.jump(following)
        self.start(following)
        self.store(Value(INT, self.new(f"add nsw i64 {now}, {step}")), counter)
        self.jump(test)
        self.start(after)

    def constant_step(self, call: ast.Call) -> int:
        if len(call.args) < 3:
            return 1
        given = call.args[2]
        step = self.names.get(given.id) if isinstance(given, ast.Name) else ast.literal_eval(given)
        if not isinstance(step, int) or step == 0:
            raise self.fail(call, "the step must be a constant")
        return step

    def do_Continue(self, node: ast.Continue) -> None:
        self.jump(self.loops[-1][0])
        self.start(self.label())

    def do_Break(self, node: ast.Break) -> None:
        self.jump(self.loops[-1][1])
        self.start(self.label())

    # ------------------------------------------------------------------ expressions
    def value(self, node: ast.expr) -> Value:
        method = getattr(self, f"of_{type(node).__name__}", None)
        if method is None:
            raise self.fail(node, "this expression cannot be translated")
        return method(node)  # type: ignore[no-any-return]

    def truth(self, node: ast.expr) -> str:
        return self.convert(self.value(node), BOOL, node).text

    def constant(self, value: Any, node: ast.AST) -> Value:
        if isinstance(value, bool):
            return Value(BOOL, str(value).lower())
        if isinstance(value, int):
            return Value(INT, str(int(value)))
        if isinstance(value, float):
            return Value(NUM, literal(value))
        raise self.fail(node, "neither a local name nor a constant number")

    def of_Constant(self, node: ast.Constant) -> Value:
        return self.constant(node.value, node)

    def of_Name(self, node: ast.Name) -> Value:
        return self.name(node)

    def name(self, node: ast.Name) -> Value:
        if node.id not in self.slots:
            return self.constant(self.names.get(node.id), node)
        kind, slot = self.slots[node.id]
        if kind in (NUMS, INTS):
            return Value(kind, slot)
        return Value(kind, self.new(f"load {llvm_type(kind)}, ptr {slot}{_alignment(kind)}"))

    def of_Attribute(self, node: ast.Attribute) -> Value:
        text = ast.unparse(node)
        if text.endswith(".ctypes.data"):
            array = self.slots[text.removesuffix(".ctypes.data")]
            return Value(INT, self.new(f"ptrtoint ptr {array[1]} to i64"))
        if text in ("np.inf", "np.nan"):
            return Value(NUM, literal(float(text[3:])))
        raise self.fail(node, "unknown attribute")

    def of_Tuple(self, node: ast.Tuple) -> Value:
        return self.pack([self.value(e) for e in node.elts])

    def element(self, node: ast.Subscript) -> tuple[str, str]:
        """(pointer, type) of an array's element, or of eight elements."""
        array, index = self.value(node.value), self.convert(self.value(self.start_of(node)), INT, node)
        if array.kind not in (NUMS, INTS):
            raise self.fail(node, "only arrays have elements")
        kind = NUM if array.kind == NUMS else INT
        pointer = self.new(f"getelementptr {llvm_type(kind)}, ptr {array.text}, i64 {index.text}")
        if not isinstance(node.slice, ast.Slice):
            return pointer, kind
        if kind != NUM:
            raise self.fail(node, "only numbers come as vectors")
        return pointer, VEC

    def start_of(self, node: ast.Subscript) -> ast.expr:
        """The index of an element, or of the first element of a slice ``start : start + LANES``."""
        part = node.slice
        if not isinstance(part, ast.Slice):
            return part
        if part.lower is None or part.upper is None or ast.unparse(part.upper) != f"{ast.unparse(part.lower)} + LANES":
            raise self.fail(node, "a slice must be 'start : start + LANES'")
        return part.lower

    def of_Subscript(self, node: ast.Subscript) -> Value:
        pointer, kind = self.element(node)
        return Value(kind, self.new(f"load {llvm_type(kind)}, ptr {pointer}{_alignment(kind)}"))

    def of_UnaryOp(self, node: ast.UnaryOp) -> Value:
        if isinstance(node.op, ast.Not):
            return Value(BOOL, self.new(f"xor i1 {self.truth(node.operand)}, true"))
        value = self.value(node.operand)
        if not isinstance(node.op, ast.USub):
            raise self.fail(node, "this operator cannot be translated")
        if value.kind == VEC:
            return Value(VEC, self.new(f"fneg {llvm_type(VEC)} {value.text}"))
        if value.kind == INT:
            return Value(INT, self.new(f"sub nsw i64 0, {value.text}"))
        return Value(NUM, self.new(f"fneg double {self.convert(value, NUM, node).text}"))

    def of_BinOp(self, node: ast.BinOp) -> Value:
        if isinstance(node.op, ast.Pow):
            return self.power(node)
        return self.binary(node.op, self.value(node.left), self.value(node.right), node)

    def power(self, node: ast.BinOp) -> Value:
        base = self.convert(self.value(node.left), NUM, node)
        if isinstance(node.right, ast.Constant) and node.right.value == 2:
            return Value(NUM, self.new(f"fmul {_FAST} double {base.text}, {base.text}"))
        exponent = self.convert(self.value(node.right), NUM, node)
        return Value(NUM, self.new(f"call double @llvm.pow.f64(double {base.text}, double {exponent.text})"))

    def binary(self, op: ast.operator, a: Value, b: Value, node: ast.AST) -> Value:
        both = a.kind in (INT, BOOL) and b.kind in (INT, BOOL)
        if VEC in (a.kind, b.kind):
            return self.by_element(op, a, b, node)
        if isinstance(op, ast.BitAnd) and a.kind == b.kind == MASK:
            return Value(MASK, self.new(f"and {llvm_type(MASK)} {a.text}, {b.text}"))
        if type(op) in _ARITHMETIC:
            word = _ARITHMETIC[type(op)]
            if both:
                a, b = self.convert(a, INT, node), self.convert(b, INT, node)
                return Value(INT, self.new(f"{word} nsw i64 {a.text}, {b.text}"))
            a, b = self.convert(a, NUM, node), self.convert(b, NUM, node)
            return Value(NUM, self.new(f"f{word} {_FAST} double {a.text}, {b.text}"))
        if type(op) in _WHOLE and both:
            return Value(INT, self.new(f"{_WHOLE[type(op)]} i64 {a.text}, {b.text}"))
        if isinstance(op, ast.Div):
            a, b = self.convert(a, NUM, node), self.convert(b, NUM, node)
            return Value(NUM, self.new(f"fdiv {_FAST} double {a.text}, {b.text}"))
        raise self.fail(node, "this operator cannot be translated")

    def by_element(self, op: ast.operator, a: Value, b: Value, node: ast.AST) -> Value:
        """Arithmetic of vectors; a number meets every lane."""
        word = "div" if isinstance(op, ast.Div) else _ARITHMETIC.get(type(op))
        if word is None:
            raise self.fail(node, "this operator cannot be translated")
        a, b = self.convert(a, VEC, node), self.convert(b, VEC, node)
        return Value(VEC, self.new(f"f{word} {_FAST} {llvm_type(VEC)} {a.text}, {b.text}"))

    def compare_lanes(self, op: ast.cmpop, a: Value, b: Value, node: ast.AST) -> Value:
        a, b = self.convert(a, VEC, node), self.convert(b, VEC, node)
        return Value(MASK, self.new(f"fcmp {_COMPARE[type(op)][0]} {llvm_type(VEC)} {a.text}, {b.text}"))

    def of_Compare(self, node: ast.Compare) -> Value:
        values = [self.value(e) for e in (node.left, *node.comparators)]
        if VEC in (v.kind for v in values):
            if len(values) != 2 or type(node.ops[0]) not in _COMPARE:
                raise self.fail(node, "vectors are compared by one operator, two at a time")
            return self.compare_lanes(node.ops[0], values[0], values[1], node)
        result = ""
        for op, a, b in zip(node.ops, values[:-1], values[1:], strict=True):
            if type(op) not in _COMPARE:
                raise self.fail(node, "this comparison cannot be translated")
            number, whole = _COMPARE[type(op)]
            if NUM in (a.kind, b.kind):
                one = self.new(
                    f"fcmp {number} double {self.convert(a, NUM, node).text}, {self.convert(b, NUM, node).text}"
                )
            else:
                one = self.new(f"icmp {whole} i64 {self.convert(a, INT, node).text}, {self.convert(b, INT, node).text}")
            result = self.new(f"and i1 {result}, {one}") if result else one
        return Value(BOOL, result)

    def of_BoolOp(self, node: ast.BoolOp) -> Value:
        slot, after = self.slot(BOOL), self.label()
        for i, part in enumerate(node.values):
            value = self.truth(part)
            self.store(Value(BOOL, value), slot)
            if i + 1 < len(node.values):
                more = self.label()
                yes, no = (more, after) if isinstance(node.op, ast.And) else (after, more)
                self.branch(value, yes, no)
                self.start(more)
        self.jump(after)
        self.start(after)
        return Value(BOOL, self.new(f"load i1, ptr {slot}"))

    def of_IfExp(self, node: ast.IfExp) -> Value:
        yes, no, after = self.label(), self.label(), self.label()
        self.branch(self.truth(node.test), yes, no)
        self.start(yes)
        first = self.value(node.body)
        kind = NUM if first.kind in (NUM, INT) and self.is_number(node.orelse) else first.kind
        slot = self.slot(kind)
        self.store(self.convert(first, kind, node), slot)
        self.jump(after)
        self.start(no)
        self.store(self.convert(self.value(node.orelse), kind, node), slot)
        self.jump(after)
        self.start(after)
        return Value(kind, self.new(f"load {llvm_type(kind)}, ptr {slot}{_alignment(kind)}"))

    def is_number(self, node: ast.expr) -> bool:
        """Whether an expression is a float, found by translating it to nowhere."""
        saved = (list(self.head), list(self.lines), self.count)
        kind = self.value(node).kind
        self.head, self.lines, self.count = saved
        return kind == NUM

    def of_Call(self, node: ast.Call) -> Value:
        text = ast.unparse(node.func)
        if text in ("min", "max"):
            return self.extreme(text, node)
        if text == "abs":
            return self.absolute(self.value(node.args[0]), node)
        if text == "int":
            value = self.value(node.args[0])
            return value if value.kind == INT else Value(INT, self.new(f"fptosi double {value.text} to i64"))
        if text == "float":
            return self.convert(self.value(node.args[0]), NUM, node)
        if text.startswith("np."):
            return self.numpy(text[3:], node)
        target = self.names.get(text)
        if isinstance(target, PointerCall):
            return self.pointer_call(target, node)
        signature = self.signatures(target)
        if signature is None:
            raise self.fail(node, "this function is not compiled")
        return self.library_call(signature, node)

    def extreme(self, word: str, node: ast.Call) -> Value:
        result = self.value(node.args[0])
        for argument in node.args[1:]:
            other = self.value(argument)
            kind = NUM if NUM in (result.kind, other.kind) else INT
            a, b = self.convert(result, kind, node), self.convert(other, kind, node)
            if kind == NUM:
                better = self.new(f"fcmp {'olt' if word == 'min' else 'ogt'} double {b.text}, {a.text}")
            else:
                better = self.new(f"icmp {'slt' if word == 'min' else 'sgt'} i64 {b.text}, {a.text}")
            t = llvm_type(kind)
            result = Value(kind, self.new(f"select i1 {better}, {t} {b.text}, {t} {a.text}"))
        return result

    def absolute(self, value: Value, node: ast.AST) -> Value:
        if value.kind == VEC:
            t = llvm_type(VEC)
            return Value(VEC, self.new(f"call {t} @llvm.fabs.v{LANES}f64({t} {value.text})"))
        number = self.convert(value, NUM, node)
        return Value(NUM, self.new(f"call double @llvm.fabs.f64(double {number.text})"))

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

    def numpy(self, name: str, node: ast.Call) -> Value:
        found = self.of_vectors(name, node)
        if found is not None:
            return found
        value = self.value(node.args[0])
        if value.kind == VEC and name == "sqrt":
            t = llvm_type(VEC)
            return Value(VEC, self.new(f"call {t} @llvm.sqrt.v{LANES}f64({t} {value.text})"))
        value = self.convert(value, NUM, node)
        if name in _NUMPY:
            return Value(NUM, self.new(f"call double @{_NUMPY[name]}(double {value.text})"))
        if name in ("isfinite", "isinf"):
            size = self.absolute(value, node).text
            return Value(
                BOOL, self.new(f"fcmp {'olt' if name == 'isfinite' else 'oeq'} double {size}, {literal(float('inf'))}")
            )
        raise self.fail(node, "unknown function of NumPy")

    def pointer_call(self, target: PointerCall, node: ast.Call) -> Value:
        if len(node.args) != target.count + 1:
            raise self.fail(node, f"an address and {target.count} pointers are needed")
        values = [self.convert(self.value(a), INT, node).text for a in node.args]
        address, *given = [self.new(f"inttoptr i64 {v} to ptr") for v in values]
        self.lines.append(f"call void {address}({', '.join(f'ptr {g}' for g in given)})")
        return Value(NONE, "")

    def library_call(self, signature: Signature, node: ast.Call) -> Value:
        if len(node.args) != len(signature.arguments):
            raise self.fail(node, f"{len(signature.arguments)} arguments are needed")
        given = [self.convert(self.value(a), k, node) for a, k in zip(node.args, signature.arguments, strict=True)]
        text = f"call {llvm_type(signature.result)} @{signature.symbol}("
        text += ", ".join(f"{llvm_type(g.kind)} {g.text}" for g in given) + ")"
        if signature.result == NONE:
            self.lines.append(text)
            return Value(NONE, "")
        return Value(signature.result, self.new(text))
