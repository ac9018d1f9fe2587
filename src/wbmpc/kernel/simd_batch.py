"""CasADi SX functions as LLVM IR for eight nodes at a time: lane i is node k + i.

Every emitted function has the signature ``i32 name(double** arg, double** res)``. Numbers of eight nodes lie side by side:
entry j of an argument is the vector at ``arg[a] + 8 j``, and an output's non-zeros go to ``res[r] + 8 offset``. Arguments that
all nodes share are plain arrays. Code works on as many lanes as the target's registers have and passes over the eight in turn.

Sine and cosine are evaluated here (argument reduction by Cody and Waite in three parts, polynomials of FreeBSD's msun,
k_sin.c and k_cos.c, error below one unit in the last place); arguments beyond 1e5 and all other functions of the C library are
called lane by lane.
"""

from __future__ import annotations

import re
from collections.abc import Collection

import casadi as ca

from wbmpc.kernel.ir import LANES, Lines
from wbmpc.kernel.repeated_rows import Rows, Run, find_runs, nodes_of
from wbmpc.kernel.scalar import TWO, Emitter, OutputMap, identity_map, literal

#: Beyond it sine and cosine come from the C library: the reduction's products n π/2 are exact up to n = 2²⁰.
REACH = 1e5
_PARTS = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
_SINE = (
    -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04, 2.75573137070700676789e-06,
    -2.50507602534068634195e-08, 1.58969099521155010221e-10,
)  # fmt: skip
_COSINE = (
    4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05, -2.75573143513906633035e-07,
    2.08757232129817482790e-09, -1.13596475577881948265e-11,
)  # fmt: skip
_NATIVE = {
    "llvm.sqrt.f64": "sqrt", "llvm.fabs.f64": "fabs", "llvm.floor.f64": "floor", "llvm.ceil.f64": "ceil",
    "llvm.copysign.f64": "copysign", "fmin": "minnum", "fmax": "maxnum",
}  # fmt: skip


_SPLAT = "splat (double "


def _splat(value: float) -> str:
    return f"{_SPLAT}{literal(value)})"


class _Lanes(Emitter):
    def __init__(
        self,
        function: ca.Function,
        name: str,
        outputs: OutputMap,
        width: int,
        shared: Collection[int],
        rows: Rows | None,
    ) -> None:
        super().__init__(function, name, outputs)
        self.width, self.shared = width, shared
        self.number, self.bit = f"<{width} x double>", f"<{width} x i1>"
        self.angles: dict[str, tuple[str, str]] = {}
        #: of every result the literals that are stored, and where
        self.constants: dict[int, list[tuple[str, int]]] = {}
        self.label = "entry" if width == LANES else "pass"
        nodes = None if rows is None else nodes_of(function, outputs)
        self.nodes = nodes or []
        self.runs = [] if rows is None or nodes is None else find_runs(function, nodes, rows, tuple(shared))

    def constant(self, value: float) -> str:
        return _splat(value)

    def fetch(self, argument: int, index: int) -> str:
        if argument not in self.shared:
            pointer = self.address(f"b{argument}", LANES * index)
            return self.new(f"load {self.number}, ptr {pointer}, align {8 * self.width}")
        one = self.new(f"load double, ptr {self.address(f'a{argument}', index)}")
        first = self.new(f"insertelement {self.number} poison, double {one}, i32 0")
        return self.new(
            f"shufflevector {self.number} {first}, {self.number} poison, <{self.width} x i32> zeroinitializer"
        )

    def put(self, value: str, result: int, offset: int) -> None:
        if value.startswith(_SPLAT):
            self.constants.setdefault(result, []).append((value[len(_SPLAT) : -1], offset))
            return
        pointer = self.address(f"s{result}", LANES * offset)
        self.lines.append(f"store {self.number} {value}, ptr {pointer}, align {8 * self.width}")

    def call(self, name: str, values: list[str]) -> str:
        t = self.number
        arguments = ", ".join(f"{t} {v}" for v in values)
        if name in _NATIVE:
            return self.new(f"call {t} @llvm.{_NATIVE[name]}.v{self.width}f64({arguments})")
        if name in ("sin", "cos"):
            return self.angle(values[0])[name == "cos"]
        return self.new(f"call {t} @each_{name}({arguments})")

    def angle(self, value: str) -> tuple[str, str]:
        """Sine and cosine of a value, both at once."""
        if value not in self.angles:
            pair = f"{{{self.number}, {self.number}}}"
            both = self.new(f"call {pair} @both_sincos({self.number} {value})")
            parts = [self.new(f"extractvalue {pair} {both}, {i}") for i in (0, 1)]
            self.angles[value] = parts[0], parts[1]
        return self.angles[value]

    def opening(self) -> list[str]:
        own = [("a", "b", i) for i in range(self.f.n_in()) if i not in self.shared]
        own += [("r", "s", i) for i in range(self.f.n_out())]
        head, lane = ["entry:", *self.pointers()], "0"
        if self.width < LANES:  # in a loop of one pass the constants of all operations would be spilled to the stack
            lane = "%lane"
            head += ["br label %pass", "pass:", "%lane = phi i64 [0, %entry], [%next, %again]"]
        return head + [f"%{b}{i} = getelementptr double, ptr %{a}{i}, i64 {lane}" for a, b, i in own]

    def closing(self) -> list[str]:
        lines, before = [], self.label
        for result, found in self.constants.items():
            lines += self._put_constants(result, len(found), before)
            before = f"after{result}"
        if self.width == LANES:
            return [*lines, *super().closing()]
        end = [f"%next = add i64 %lane, {self.width}", f"%done = icmp eq i64 %next, {LANES}", "br label %again"]
        return [*lines, *end, "again:", "br i1 %done, label %out, label %pass", "out:", "ret i32 0", "}"]

    def _put_constants(self, r: int, count: int, before: str) -> list[str]:
        """A loop over the constants of a result: as operands of operations, too, they would be spilled to the stack until they are stored."""
        t, w = self.number, self.width
        return [
            f"br label %put{r}",
            f"put{r}:",
            f"%i{r} = phi i64 [0, %{before}], [%j{r}, %put{r}]",
            f"%pc{r} = getelementptr double, ptr @{self.name}.constants{r}, i64 %i{r}",
            f"%c{r} = load double, ptr %pc{r}",
            f"%pp{r} = getelementptr i64, ptr @{self.name}.places{r}, i64 %i{r}",
            f"%place{r} = load i64, ptr %pp{r}",
            f"%first{r} = insertelement {t} poison, double %c{r}, i32 0",
            f"%all{r} = shufflevector {t} %first{r}, {t} poison, <{w} x i32> zeroinitializer",
            f"%to{r} = getelementptr double, ptr %s{r}, i64 %place{r}",
            f"store {t} %all{r}, ptr %to{r}, align {8 * w}",
            f"%j{r} = add i64 %i{r}, 1",
            f"%c{r}.done = icmp eq i64 %j{r}, {count}",
            f"br i1 %c{r}.done, label %after{r}, label %put{r}",
            f"after{r}:",
        ]

    def instructions(self) -> None:
        """Rows that are alike in loops, each when what its first row needs is known."""
        last = {run.own[-1]: run for run in self.runs}
        done = {k for run in self.runs for row in run.rows for k in row}
        values: dict[int, str] = {}
        for k in range(self.f.n_instructions()):
            if k in last:
                self._loop(last[k], values)
            elif k not in done:
                self.instruction(k)
                if self.nodes and self.nodes[k].op != ca.OP_OUTPUT:
                    values[k] = self.environment[self.f.instruction_output(k)[0]]

    def _loop(self, run: Run, values: dict[int, str]) -> None:
        """``values``: of the instructions before."""
        name, angles, moved = f"row{run.own[0]}", dict(self.angles), dict[tuple[str, int, int], str]()
        values = dict(values)
        self.lines += [f"br label %{name}", f"{name}:"]
        self.lines.append(f"%{name}.i = phi i64 [0, %{self.label}], [%{name}.j, %{name}]")

        def place(array: str, k: int) -> str:
            (which, index), stride = self.nodes[k].place, run.strides[k]
            key = array, which, stride
            if key not in moved:
                by = self.new(f"mul i64 %{name}.i, {LANES * stride}")
                moved[key] = self.new(f"getelementptr double, ptr %{array}{which}, i64 {by}")
            return self.new(f"getelementptr double, ptr {moved[key]}, i64 {LANES * index}")

        align = f"align {8 * self.width}"
        for k in run.own:
            node = self.nodes[k]
            if node.op == ca.OP_INPUT:
                values[k] = self.new(f"load {self.number}, ptr {place('b', k)}, {align}")
            elif node.op == ca.OP_OUTPUT:
                self.lines.append(f"store {self.number} {values[node.operands[0]]}, ptr {place('s', k)}, {align}")
            else:
                values[k] = self.operation(node.op, [values[i] for i in node.operands])
        self.lines += [f"%{name}.j = add i64 %{name}.i, 1", f"%{name}.c = icmp eq i64 %{name}.j, {len(run.rows)}"]
        self.lines += [f"br i1 %{name}.c, label %after.{name}, label %{name}", f"after.{name}:"]
        self.label, self.angles = f"after.{name}", angles

    def emit(self) -> str:
        text = super().emit()
        tables = []
        for r, unordered in self.constants.items():
            found = sorted(unordered, key=lambda one: one[1])
            numbers, places = (
                ", ".join(p) for p in zip(*((f"double {c}", f"i64 {LANES * at}") for c, at in found), strict=True)
            )
            tables.append(f"@{self.name}.constants{r} = private constant [{len(found)} x double] [{numbers}]")
            tables.append(f"@{self.name}.places{r} = private constant [{len(found)} x i64] [{places}]")
        return "\n".join([*tables, text])


def emit_lanes(
    function: ca.Function, name: str, width: int, outputs: OutputMap | None = None, shared: Collection[int] = (),
    rows: Rows | None = None,
) -> str:  # fmt: skip
    """LLVM IR of one SX function for eight nodes, ``width`` of them at once; ``shared``: arguments that all nodes share. ``rows``: those of its
    results, of which like ones become loops."""
    outputs = identity_map(function) if outputs is None else outputs
    return _Lanes(function, name, outputs, width, shared, rows).emit()


class _Helper(Lines):
    """Lines of a helper function; names count up."""

    def __init__(self, width: int) -> None:
        self.t, self.width, self.lines, self.count = f"<{width} x double>", width, list[str](), 0

    def op(self, word: str, a: str, b: str | float, contract: bool = False) -> str:
        right = b if isinstance(b, str) else _splat(b)
        return self.new(f"{word}{' contract' if contract else ''} {self.t} {a}, {right}")

    def polynomial(self, z: str, coefficients: tuple[float, ...]) -> str:
        total = self.op("fmul", z, coefficients[-1], contract=True)
        for c in reversed(coefficients[1:-1]):
            total = self.op("fmul", self.op("fadd", total, c, contract=True), z, contract=True)
        return self.op("fadd", total, coefficients[0], contract=True)


def _each(name: str, width: int) -> str:
    """A function of the C library, lane by lane."""
    h, arguments = _Helper(width), ["a", "b"] if name in TWO else ["a"]
    result = "poison"
    for i in range(width):
        lanes = [h.new(f"extractelement {h.t} %{a}, i32 {i}") for a in arguments]
        one = h.new(f"call double @{name}({', '.join(f'double {g}' for g in lanes)})")
        result = h.new(f"insertelement {h.t} {result}, double {one}, i32 {i}")
    head = f"define internal {h.t} @each_{name}({', '.join(f'{h.t} %{a}' for a in arguments)}) nounwind {{"
    return "\n".join([head, *h.lines, f"ret {h.t} {result}", "}"])


def _reduced(h: _Helper) -> tuple[str, str, str]:
    """(y0, y1, quadrant) of %x: y0 + y1 = x − n π/2 to 118 bits."""
    magic = (
        6755399441055744.0  # 2^52 + 2^51: its sum with a small number rounds to an integer, which its last bits hold
    )
    shifted = h.op("fadd", h.op("fmul", "%x", 0.63661977236758134308), magic)
    n = h.op("fsub", shifted, magic)
    quadrant = h.new(f"bitcast {h.t} {shifted} to <{h.width} x i64>")
    t = h.op("fsub", "%x", h.op("fmul", n, _PARTS[0]))
    w = h.op("fmul", n, _PARTS[1])
    r = h.op("fsub", t, w)
    rest = h.op("fsub", h.op("fmul", n, _PARTS[2]), h.op("fsub", h.op("fsub", t, r), w))
    y0 = h.op("fsub", r, rest)
    return y0, h.op("fsub", h.op("fsub", r, y0), rest), quadrant


def _fast(h: _Helper) -> tuple[str, str]:
    """Sine and cosine of %x, |x| within reach."""
    y0, y1, quadrant = _reduced(h)
    z = h.op("fmul", y0, y0)
    v = h.op("fmul", z, y0)
    bend = h.op("fmul", v, h.polynomial(z, _SINE[1:]))
    inner = h.op("fsub", h.op("fmul", z, h.op("fsub", h.op("fmul", y1, 0.5), bend)), y1)
    sine = h.op("fsub", y0, h.op("fsub", inner, h.op("fmul", v, _SINE[0])))
    r = h.op("fmul", h.polynomial(z, _COSINE), z)
    half = h.op("fmul", z, 0.5)
    one = h.new(f"fsub {h.t} {_splat(1.0)}, {half}")
    left = h.op("fsub", h.new(f"fsub {h.t} {_splat(1.0)}, {one}"), half)
    small = h.op("fsub", h.op("fmul", z, r), h.op("fmul", y0, y1))
    cosine = h.op("fadd", one, h.op("fadd", left, small))
    ints, bits = f"<{h.width} x i64>", f"<{h.width} x i1>"

    def bit(value: str, which: int) -> str:
        found = h.new(f"and {ints} {value}, splat (i64 {which})")
        return h.new(f"icmp ne {ints} {found}, zeroinitializer")

    def signed(value: str, negative: str) -> str:
        other = h.new(f"fneg {h.t} {value}")
        return h.new(f"select {bits} {negative}, {h.t} {other}, {h.t} {value}")

    swap = bit(quadrant, 1)
    first = h.new(f"select {bits} {swap}, {h.t} {cosine}, {h.t} {sine}")
    second = h.new(f"select {bits} {swap}, {h.t} {sine}, {h.t} {cosine}")
    after = h.new(f"add {ints} {quadrant}, splat (i64 1)")
    return signed(first, bit(quadrant, 2)), signed(second, bit(after, 2))


def _sincos(width: int) -> str:
    h = _Helper(width)
    t, pair = h.t, f"{{{h.t}, {h.t}}}"
    size = h.new(f"call {t} @llvm.fabs.v{width}f64({t} %x)")
    far = h.new(f"fcmp ugt {t} {size}, {_splat(REACH)}")
    some = h.new(f"call i1 @llvm.vector.reduce.or.v{width}i1(<{width} x i1> {far})")
    h.lines += [f"br i1 {some}, label %slow, label %fast", "fast:"]
    found = [_fast(h)]
    h.lines += ["br label %end", "slow:"]
    found.append((h.new(f"call {t} @each_sin({t} %x)"), h.new(f"call {t} @each_cos({t} %x)")))
    h.lines += ["br label %end", "end:"]
    parts = [h.new(f"phi {t} [{found[0][i]}, %fast], [{found[1][i]}, %slow]") for i in (0, 1)]
    first = h.new(f"insertvalue {pair} poison, {t} {parts[0]}, 0")
    both = h.new(f"insertvalue {pair} {first}, {t} {parts[1]}, 1")
    head = f"define internal {pair} @both_sincos({t} %x) nounwind {{"
    return "\n".join([head, *h.lines, f"ret {pair} {both}", "}"])


def helpers(ir: str, width: int) -> str:
    """Declarations, and the helper functions that ``ir`` calls; those of the C library must be declared."""
    t = f"<{width} x double>"
    one = ("sqrt", "floor", "ceil") if width == LANES else ("sqrt", "fabs", "floor", "ceil")
    parts = [f"declare {t} @llvm.{n}.v{width}f64({t}) nounwind memory(none)" for n in one]
    two = ("copysign", "minnum", "maxnum")
    parts += [f"declare {t} @llvm.{n}.v{width}f64({t}, {t}) nounwind memory(none)" for n in two]
    parts.append(f"declare i1 @llvm.vector.reduce.or.v{width}i1(<{width} x i1>) nounwind memory(none)")
    called = set(re.findall(r"@each_(\w+)\(", ir))
    if "@both_sincos(" in ir:
        parts.append(_sincos(width))
        called |= {"sin", "cos"}
    return "\n".join([*parts, *(_each(n, width) for n in sorted(called))])
