"""Translation of expressions: names, elements of arrays, operators, comparisons, calls."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from enum import IntEnum
from typing import Any

from wbmpc.kernel.ir import (
    BOOL,
    INT,
    INTS,
    LANES,
    MASK,
    NONE,
    NUM,
    NUMS,
    VEC,
    Parameter,
    PointerCall,
    Signature,
    Value,
    alignment,
    llvm_type,
)
from wbmpc.kernel.scalar import literal
from wbmpc.kernel.vectors import ARITHMETIC, COMPARE, FAST, Vectors

_WHOLE: dict[type[ast.AST], str] = {ast.FloorDiv: "sdiv", ast.Mod: "srem"}
_NUMPY = {"sqrt": "llvm.sqrt.f64", "log": "llvm.log.f64", "exp": "llvm.exp.f64", "floor": "llvm.floor.f64"}
_NUMPY |= {"sin": "llvm.sin.f64", "cos": "llvm.cos.f64", "arcsin": "asin"}


def is_frozen(owner: object) -> bool:
    """Whether this is an instance of a frozen dataclass: its fields are constants of translated code."""
    parameters = getattr(type(owner), "__dataclass_params__", None)
    return parameters is not None and bool(parameters.frozen)


class Expressions(Vectors):
    """The value of every expression that can be translated."""

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
        return self.load(node.id)

    def load(self, place: str) -> Value:
        """The value of a local name, or of a record's field."""
        kind, slot = self.slots[place]
        if kind in (NUMS, INTS):
            return Value(kind, slot)
        return Value(kind, self.new(f"load {llvm_type(kind)}, ptr {slot}{alignment(kind)}"))

    def of_Attribute(self, node: ast.Attribute) -> Value:
        text = ast.unparse(node)
        if text in self.slots:
            return self.load(text)
        if text.endswith(".ctypes.data"):
            array = self.slots[text.removesuffix(".ctypes.data")]
            return Value(INT, self.new(f"ptrtoint ptr {array[1]} to i64"))
        if text in ("np.inf", "np.nan"):
            return Value(NUM, literal(float(text[3:])))
        owner = self.names.get(node.value.id) if isinstance(node.value, ast.Name) else None
        if isinstance(owner, type) and issubclass(owner, IntEnum):
            if node.attr not in owner.__members__:
                raise self.fail(node, f"{owner.__name__} has no member of this name")
            return Value(INT, str(int(owner[node.attr])))
        if is_frozen(owner):
            if not hasattr(owner, node.attr):
                raise self.fail(node, f"{type(owner).__name__} has no field of this name")
            return self.constant(getattr(owner, node.attr), node)
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
        return Value(kind, self.new(f"load {llvm_type(kind)}, ptr {pointer}{alignment(kind)}"))

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
            return Value(NUM, self.new(f"fmul {FAST} double {base.text}, {base.text}"))
        exponent = self.convert(self.value(node.right), NUM, node)
        return Value(NUM, self.new(f"call double @llvm.pow.f64(double {base.text}, double {exponent.text})"))

    def binary(self, op: ast.operator, a: Value, b: Value, node: ast.AST) -> Value:
        both = a.kind in (INT, BOOL) and b.kind in (INT, BOOL)
        if VEC in (a.kind, b.kind):
            return self.by_element(op, a, b, node)
        if isinstance(op, ast.BitAnd) and a.kind == b.kind == MASK:
            return Value(MASK, self.new(f"and {llvm_type(MASK)} {a.text}, {b.text}"))
        if type(op) in ARITHMETIC:
            word = ARITHMETIC[type(op)]
            if both:
                a, b = self.convert(a, INT, node), self.convert(b, INT, node)
                return Value(INT, self.new(f"{word} nsw i64 {a.text}, {b.text}"))
            a, b = self.convert(a, NUM, node), self.convert(b, NUM, node)
            return Value(NUM, self.new(f"f{word} {FAST} double {a.text}, {b.text}"))
        if type(op) in _WHOLE and both:
            return Value(INT, self.new(f"{_WHOLE[type(op)]} i64 {a.text}, {b.text}"))
        if isinstance(op, ast.Div):
            a, b = self.convert(a, NUM, node), self.convert(b, NUM, node)
            return Value(NUM, self.new(f"fdiv {FAST} double {a.text}, {b.text}"))
        raise self.fail(node, "this operator cannot be translated")

    def of_Compare(self, node: ast.Compare) -> Value:
        values = [self.value(e) for e in (node.left, *node.comparators)]
        if VEC in (v.kind for v in values):
            if len(values) != 2 or type(node.ops[0]) not in COMPARE:
                raise self.fail(node, "vectors are compared by one operator, two at a time")
            return self.compare_lanes(node.ops[0], values[0], values[1], node)
        result = ""
        for op, a, b in zip(node.ops, values[:-1], values[1:], strict=True):
            if type(op) not in COMPARE:
                raise self.fail(node, "this comparison cannot be translated")
            number, whole = COMPARE[type(op)]
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
        return Value(kind, self.new(f"load {llvm_type(kind)}, ptr {slot}{alignment(kind)}"))

    def is_number(self, node: ast.expr) -> bool:
        """Whether an expression is a float, found by translating it to nowhere."""
        saved = (list(self.head), list(self.lines), self.count)
        kind = self.value(node).kind
        self.head, self.lines, self.count = saved
        return kind == NUM

    def of_Call(self, node: ast.Call) -> Value:
        text = ast.unparse(node.func)
        signature = self.signatures(self.names.get(text))
        if signature is not None:
            return self.library_call(signature, node)
        if node.keywords:
            raise self.fail(node, "only a compiled function takes arguments by name")
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
        raise self.fail(node, "this function is not compiled")

    def in_order(self, parameters: Sequence[Parameter], node: ast.Call) -> list[ast.expr]:
        """What a call passes for each of the ``parameters``, in their order: by position first, then by name."""
        named, names = {k.arg or "": k.value for k in node.keywords}, [p.name for p in parameters]
        given = list(zip(names, node.args, strict=False))
        if sorted([*named, *(name for name, _ in given)]) != sorted(names) or len(given) != len(node.args):
            raise self.fail(node, f"needs each argument once; valid: {', '.join(names)}")
        named |= dict(given)
        return [named[name] for name in names]

    def passed(self, parameters: Sequence[Parameter], node: ast.Call) -> list[Value]:
        """The arguments that a call passes for ``parameters``: of a record its numbers and arrays."""
        pairs = zip(parameters, self.in_order(parameters, node), strict=True)
        return [v for p, given in pairs for v in (self.record(p, given) if p.record else [self.value(given)])]

    def record(self, parameter: Parameter, node: ast.expr) -> list[Value]:
        """The numbers and arrays of a record: of one of the same kind that the function has, or of one that is made here."""
        if isinstance(node, ast.Call) and self.names.get(ast.unparse(node.func)) is parameter.record:
            return self.passed(parameter.fields, node)
        first, *path = ast.unparse(node).split(".")
        own: Parameter | None = next((p for p in self.signature.parameters if p.name == first), None)
        for name in path:
            own = next((field for field in own.fields if field.name == name), None) if own else None
        if own is None or own.record is not parameter.record:
            kind = getattr(parameter.record, "__name__", "")
            raise self.fail(node, f"'{parameter.name}' needs a record of the kind {kind}")
        return [self.load(ast.unparse(node) + place.removeprefix(own.name)) for place in own.places]

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

    def numpy(self, name: str, node: ast.Call) -> Value:
        found = self.of_vectors(name, node)
        if found is not None:
            return found
        if name == "arctan2":
            y, x = (self.convert(self.value(a), NUM, node).text for a in node.args)
            return Value(NUM, self.new(f"call double @atan2(double {y}, double {x})"))
        value = self.value(node.args[0])
        if value.kind == VEC and name == "sqrt":
            t = llvm_type(VEC)
            return Value(VEC, self.new(f"call {t} @llvm.sqrt.v{LANES}f64({t} {value.text})"))
        if value.kind == VEC and name == "log":
            t = llvm_type(VEC)
            return Value(VEC, self.new(f"call {t} @vector_log({t} {value.text})"))
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
        address, *pointers = [self.new(f"inttoptr i64 {v} to ptr") for v in values]
        self.lines.append(f"call void {address}({', '.join(f'ptr {g}' for g in pointers)})")
        return Value(NONE, "")

    def library_call(self, signature: Signature, node: ast.Call) -> Value:
        values = self.passed(signature.parameters, node)
        arguments = [self.convert(v, k, node) for v, k in zip(values, signature.arguments, strict=True)]
        text = f"call {llvm_type(signature.result)} @{signature.symbol}("
        text += ", ".join(f"{llvm_type(g.kind)} {g.text}" for g in arguments) + ")"
        if signature.result == NONE:
            self.lines.append(text)
            return Value(NONE, "")
        return Value(signature.result, self.new(text))
