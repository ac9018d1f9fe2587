"""A small subset of Python as LLVM IR: what the solver's driver is written in.

Numbers (float, int, bool), flat arrays of float64 and int64, tuples of numbers as results; assignments, ``for … in range``,
``while``, ``if``, arithmetic, comparisons, a few functions of NumPy, calls of other such functions (arguments by position or
name), calls by address. No allocation, no exceptions, no bounds checks. ``//`` and ``%`` are meant for non-negative integers.

Eight numbers at a time: ``m[i : i + LANES]`` is one vector, to read or to write; arithmetic and comparisons by element,
``np.full``, ``np.where``, ``np.maximum``, ``np.minimum``, ``np.sqrt``, ``abs``, ``&``, and ``np.max``, ``np.sum``, ``np.all``
of a vector.

Types are those of the annotations: ``float``, ``int``, ``bool``, :class:`~wbmpc.kernel.ir.Floats`, ``Integers``, ``Vector``, ``Mask``,
tuples of them. A parameter may be a record, a ``NamedTuple`` of numbers, arrays and records: its fields are read (``w.radius[i]``), it
is passed on as a whole or made in the call (``f(Wheel(radius, i))``), and an array of it may get a local name (``radius = w.radius``).
Constants are module-level numbers, members of an ``IntEnum`` (``State.BARRIER``: named entries of an array) and fields of a frozen
dataclass instance (settings of a component).

The same functions run as ordinary Python, which is how the interpreted twin and the tests use them (there a slice is a view:
read it before it is written to).
"""

from __future__ import annotations

import ast

from wbmpc.kernel.expressions import Expressions
from wbmpc.kernel.ir import INT, INTS, NONE, NUMS, VEC, Value, alignment, llvm_type

#: Functions of more instructions are compiled once, not where they are called: half as much code, seconds at the first start.
LARGE = 50


class Translator(Expressions):
    """Statements, and the whole function."""

    def translate(self) -> str:
        """The function as LLVM IR."""
        parameters = []
        names = [place for p in self.signature.parameters for place in p.places]
        if len(names) != len(self.signature.arguments):
            raise self.fail(self.tree, "the signature has another number of arguments")
        for name, kind in zip(names, self.signature.arguments, strict=True):
            parameters.append(f"{llvm_type(kind)}{' noalias' if kind in (NUMS, INTS) else ''} %a.{name}")
            if kind in (NUMS, INTS):
                self.slots[name] = (kind, f"%a.{name}")
            else:
                self.assign_name(name, Value(kind, f"%a.{name}"), self.tree)
        self.block(self.tree.body)
        self.lines.append("ret void" if self.signature.result == NONE else "unreachable")
        large = len(self.lines) > LARGE and VEC not in (*self.signature.arguments, *self.signature.result)
        rules = "nounwind noinline" if large else "nounwind"
        head = f"define {llvm_type(self.signature.result)} @{self.signature.symbol}({', '.join(parameters)}) {rules} {{"
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
            if value.kind in (NUMS, INTS):  # another name for the same array
                self.slots[name] = (value.kind, value.text)
                return
            self.slots[name] = (value.kind, self.slot(value.kind))
        kind, slot = self.slots[name]
        if kind in (NUMS, INTS):
            raise self.fail(node, "an array cannot be replaced")
        self.store(self.convert(value, kind, node), slot)

    def do_AugAssign(self, node: ast.AugAssign) -> None:
        if isinstance(node.target, ast.Subscript):
            pointer, kind = self.element(node.target)
            old = Value(kind, self.new(f"load {llvm_type(kind)}, ptr {pointer}{alignment(kind)}"))
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
        argument = call.args[2]
        step = self.names.get(argument.id) if isinstance(argument, ast.Name) else ast.literal_eval(argument)
        if not isinstance(step, int) or step == 0:
            raise self.fail(call, "the step must be a constant")
        return step

    def do_Continue(self, node: ast.Continue) -> None:
        self.jump(self.loops[-1][0])
        self.start(self.label())

    def do_Break(self, node: ast.Break) -> None:
        self.jump(self.loops[-1][1])
        self.start(self.label())
