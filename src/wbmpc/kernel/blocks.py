"""Between matrices of single nodes and numbers of eight nodes side by side: transpositions, and the chain rule for eight nodes.

A group is eight neighboring entries of a node's matrix. Lanes beyond the last node of a block repeat it: they read and write
the same numbers at the same addresses, so that no mask is needed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from wbmpc.kernel.dense import FMA, Body, V, transposed
from wbmpc.kernel.ir import LANES, Lines


def _lane_pointers() -> list[str]:
    """%q0 … %q7: the eight nodes' addresses, ``%stride`` bytes apart; from lane ``%last`` on always the same."""
    lines = []
    for i in range(LANES):
        lines.append(f"%l{i} = call i64 @llvm.smin.i64(i64 {i}, i64 %last)")
        lines.append(f"%d{i} = mul i64 %l{i}, %stride")
        lines.append(f"%q{i} = getelementptr i8, ptr %node, i64 %d{i}")
    return lines


def _loop(body: list[str], count: str) -> list[str]:
    """``body`` for %g = 0 … count − 1."""
    head = ["br label %test", "test:", "%g = phi i64 [0, %entry], [%g1, %body]", f"%more = icmp slt i64 %g, {count}"]
    end = ["%g1 = add i64 %g, 1", "br label %test", "out:", "ret void", "}"]
    return [*head, "br i1 %more, label %body, label %out", "body:", *body, *end]


def pack() -> str:
    """``pack(node, stride [bytes], groups, lanes, last)``: entries of eight nodes side by side.

    Reads whole groups, so up to seven numbers beyond a node's.
    """
    body = ["%o = mul i64 %g, 8"]
    for i in range(LANES):
        body.append(f"%p{i} = getelementptr double, ptr %q{i}, i64 %o")
        body.append(f"%i{i} = load {V}, ptr %p{i}, align 8")
    found = transposed([f"%i{i}" for i in range(LANES)], body)
    body.append("%to = mul i64 %g, 64")
    for i in range(LANES):
        body.append(f"%o{i} = add i64 %to, {8 * i}")
        body.append(f"%w{i} = getelementptr double, ptr %lanes, i64 %o{i}")
        body.append(f"store {V} {found[i]}, ptr %w{i}, align 64")
    head = "define void @pack(ptr %node, i64 %stride, i64 %groups, ptr %lanes, i64 %last) nounwind {"
    return "\n".join([head, "entry:", *_lane_pointers(), *_loop(body, "%groups")])


def unpack(name: str, groups: Iterable[int], whole: bool = False) -> str:
    """``name(lanes, node, stride [bytes], last)``: the groups, one after the other in ``lanes``, to the nodes' matrices.

    ``groups``: where they start, in groups from the start of a node's matrix; ``whole``: ``lanes`` holds the other ones too.
    """
    starts = [8 * g for g in groups]
    head = f"define void @{name}(ptr %lanes, ptr %node, i64 %stride, i64 %last) nounwind {{"
    if not starts:
        return f"{head}\nret void\n}}"
    body = [f"%pg = getelementptr i64, ptr @{name}.groups, i64 %g", "%start = load i64, ptr %pg"]
    body.append("%from = mul i64 %start, 8" if whole else "%from = mul i64 %g, 64")
    for i in range(LANES):
        body.append(f"%o{i} = add i64 %from, {8 * i}")
        body.append(f"%p{i} = getelementptr double, ptr %lanes, i64 %o{i}")
        body.append(f"%i{i} = load {V}, ptr %p{i}, align 64")
    found = transposed([f"%i{i}" for i in range(LANES)], body)
    for i in range(LANES):
        body.append(f"%w{i} = getelementptr double, ptr %q{i}, i64 %start")
        body.append(f"store {V} {found[i]}, ptr %w{i}, align 64")
    table = ", ".join(f"i64 {s}" for s in starts)
    constant = f"@{name}.groups = private constant [{len(starts)} x i64] [{table}]"
    return "\n".join([constant, head, "entry:", *_lane_pointers(), *_loop(body, str(len(starts)))])


def unpack_values(name: str, count: int) -> str:
    """``name(lanes, node, stride [bytes], last)``: ``count`` vectors, one after the other in ``lanes``, to where each node has its numbers."""
    o = Body(name, "")
    o.lines = [f"define void @{name}(ptr %lanes, ptr %node, i64 %stride, i64 %last) nounwind {{", *_lane_pointers()]
    for first in range(0, count, LANES):
        own = range(first, min(first + LANES, count))
        vectors = [o.load("lanes", LANES * i) for i in own]
        for i, value in enumerate(o.transpose([*vectors, *["zeroinitializer"] * (LANES - len(own))])):
            o.store_some(value, len(own), f"q{i}", first)
    return o.text()


def declarations(width: int) -> str:
    """What the functions of this module need besides :data:`wbmpc.kernel.dense.FMA`."""
    text = "declare i64 @llvm.smin.i64(i64, i64) nounwind memory(none)"
    return text if width == 8 else text + "\n" + FMA.replace("8 x", f"{width} x").replace("v8", f"v{width}")


class LaneBody(Lines):
    """Code of a function of eight nodes: in each pass as many of them as the target's registers hold. An entry is a vector of eight nodes."""

    def __init__(self, name: str, arguments: str, width: int) -> None:
        self.t, self.width, self.count, self.label = f"<{width} x double>", width, 0, "pass"
        parameters = ", ".join(f"ptr noalias %{a}" for a in arguments.split())
        self.lines = [f"define void @{name}({parameters}) nounwind {{", "entry:", "br label %pass", "pass:"]
        self.lines.append("%lane = phi i64 [0, %entry], [%next, %again]")
        self.lines += [f"%own{a} = getelementptr double, ptr %{a}, i64 %lane" for a in arguments.split()]
        self.sums: list[tuple[int, str]] = []

    def at(self, array: str, entry: str | int) -> str:
        """Address of an entry's vector."""
        offset = LANES * entry if isinstance(entry, int) else self.new(f"mul i64 {entry}, {LANES}")
        return self.new(f"getelementptr double, ptr %own{array}, i64 {offset}")

    def load(self, array: str, entry: str | int) -> str:
        return self.new(f"load {self.t}, ptr {self.at(array, entry)}")

    def store(self, value: str, array: str, entry: str | int) -> None:
        self.lines.append(f"store {self.t} {value}, ptr {self.at(array, entry)}")

    def scale(self, a: str, b: str) -> str:
        return self.new(f"fmul {self.t} {a}, {b}")

    def fma(self, a: str, b: str, c: str) -> str:
        return self.new(f"call {self.t} @llvm.fmuladd.v{self.width}f64({self.t} {a}, {self.t} {b}, {self.t} {c})")

    def loop(self, count: int, initial: Sequence[str]) -> tuple[str, list[str]]:
        """Begin a loop without branches: its index, and vectors that start as ``initial`` and go on as :meth:`end_loop` says."""
        before, self.label = self.label, f"loop{self.count}"
        self.lines += [f"br label %{self.label}", f"{self.label}:"]
        self.bound, self.index = count, f"%{self.label}.i"
        self.lines.append(f"{self.index} = phi i64 [0, %{before}], [{self.index}.next, %{self.label}]")
        self.sums = []
        for i, value in enumerate(initial):
            self.sums.append((len(self.lines), f"%{self.label}.s{i} = phi {self.t} [{value}, %{before}], "))
            self.lines.append("")
        return self.index, [text.split(" ")[0] for _, text in self.sums]

    def end_loop(self, following: Sequence[str]) -> None:
        """End the loop that was begun last; ``following``: its vectors in the next turn, and after the last one."""
        for (line, text), value in zip(self.sums, following, strict=True):
            self.lines[line] = f"{text}[{value}, %{self.label}]"
        self.lines += [f"{self.index}.next = add i64 {self.index}, 1"]
        self.lines.append(f"{self.index}.c = icmp eq i64 {self.index}.next, {self.bound}")
        self.lines += [f"br i1 {self.index}.c, label %after.{self.label}, label %{self.label}", f"after.{self.label}:"]
        self.label = f"after.{self.label}"

    def text(self) -> str:
        """The whole function."""
        end = [
            f"%next = add i64 %lane, {self.width}",
            f"%done = icmp eq i64 %next, {LANES}",
            "br label %again",
            "again:",
        ]
        return "\n".join([*self.lines, *end, "br i1 %done, label %out, label %pass", "out:", "ret void", "}"])


class _Chain(LaneBody):
    """Code of one stage's sensitivities."""

    def __init__(self, name: str, width: int, ld: int, start: float | None) -> None:
        super().__init__(name, "J S T A C", width)
        self.ld, self.start = ld, start
        self.c, self.w = self.load("C", 0), self.load("C", 1)

    def factors(self, r: int, states: Iterable[int]) -> dict[int, str]:
        """c Jx of row r."""
        return {s: self.new(f"fmul {self.t} {self.c}, {self.load('J', r * self.ld + s)}") for s in states}

    def entry(self, at: str | int, slope: str, unit: bool) -> None:
        """T and A of an entry whose slope is known."""
        if self.start is None:
            self.store(slope, "T", at)
            total = self.load("A", at)
        else:
            total = splat(1.0) if unit else "zeroinitializer"
            if self.start > 0.0:
                self.store(slope, "T", at)
                slope = self.fma(self.load("S", at), splat(self.start), slope)
        self.store(self.fma(slope, self.w, total), "A", at)

    def full_row(self, r: int, factors: dict[int, str], nz: int) -> None:
        """All entries of a row in a loop."""
        z, _ = self.loop(nz, [])
        place = lambda row: self.new(f"add i64 {z}, {row * self.ld}")
        slope = self.load("J", place(r))
        for s, factor in factors.items():
            slope = self.fma(self.load("S", place(s)), factor, slope)
        self.entry(place(r), slope, False)
        self.end_loop([])
        if self.start is not None:
            unit = self.new(f"fadd {self.t} {self.load('A', r * self.ld + r)}, {splat(1.0)}")
            self.store(unit, "A", r * self.ld + r)

    def few_entries(
        self, r: int, factors: dict[int, str], columns: Iterable[int], own: np.ndarray, slopes: np.ndarray
    ) -> None:
        """Those entries of a row, one by one."""
        for c in columns:
            at, slope = r * self.ld + c, ""
            if own[r, c]:
                slope = self.load("J", at)
            for s, factor in factors.items():
                if slopes[s, c]:
                    slope = self.fma(self.load("S", s * self.ld + c), factor, slope or "zeroinitializer")
            if slope:
                self.entry(at, slope, c == r)
            elif self.start is not None:
                self.store(splat(1.0) if c == r else "zeroinitializer", "A", at)


def splat(value: float) -> str:
    """The same number in every lane."""
    return f"splat (double {value!r})"


def chain(
    name: str, jacobian: np.ndarray, step: np.ndarray, stages: int, ld: int, width: int, start: float | None
) -> str:
    """One Runge-Kutta stage's sensitivity for eight nodes: T = J + c Jx S, A += w T; arguments J, S, T, A, C = (c, w).

    J, S, T, A: (states, ld) vectors of eight nodes. ``jacobian``, ``step`` (nx, nz): where J and the step's derivative can differ from
    zero. ``start``: A begins with I + w ``start`` S; T is left out where no stage follows, which ``start`` 0 says.
    """
    (nx, nz), slopes = step.shape, slope_pattern(jacobian, stages)
    o = _Chain(name, width, ld, start)
    for r in range(nx):
        columns, factors = np.flatnonzero(step[r] | slopes[r]), o.factors(r, np.flatnonzero(jacobian[r, :nx]))
        if 2 * len(columns) > nz:
            o.full_row(r, factors, nz)
        else:
            o.few_entries(r, factors, map(int, columns), jacobian, slopes)
    return o.text()


def groups_of(offsets: Iterable[int]) -> list[int]:
    """The groups that hold these offsets of a matrix."""
    return sorted({o // LANES for o in offsets})


def compact(offsets: Sequence[Sequence[int]], groups: list[int]) -> list[list[int]]:
    """Offsets in a matrix as offsets among its groups, one group after the other."""
    rank = {g: i for i, g in enumerate(groups)}
    return [[LANES * rank[o // LANES] + o % LANES for o in row] for row in offsets]


def slope_pattern(jacobian: np.ndarray, stages: int) -> np.ndarray:
    """Where the derivative of a Runge-Kutta stage's slope can differ from zero; ``jacobian`` (nx, …): where that of ẋ by (x, …) can."""
    nx, found = len(jacobian), jacobian.copy()
    for _ in range(stages - 1):
        found |= (jacobian[:, :nx].astype(int) @ found.astype(int)) > 0
    return found


def sensitivity_pattern(jacobian: np.ndarray, stages: int, quaternions: Iterable[int]) -> np.ndarray:
    """Where the derivative of a Runge-Kutta step can differ from zero; ``jacobian`` (nx, nx + nu): where that of ẋ can.

    ``quaternions``: where unit quaternions start, which the step makes one long again.
    """
    nx, found = len(jacobian), slope_pattern(jacobian, stages)
    found[:, :nx] |= np.eye(nx, dtype=bool)
    for q in quaternions:
        found[q : q + 4] = found[q : q + 4].any(axis=0)
    return found
