"""Between matrices of single nodes and numbers of eight nodes side by side: transpositions, and the chain rule for eight nodes.

A group is eight neighboring entries of a node's matrix. Lanes beyond the last node of a block repeat it: they read and write
the same numbers at the same addresses, so that no mask is needed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from wbmpc.kernel.dense import FMA, V
from wbmpc.kernel.ir import LANES

#: Where eight vectors of a square meet: even and odd entries, then pairs, then halves.
_MIXES = (
    ((0, 8, 2, 10, 4, 12, 6, 14), (1, 9, 3, 11, 5, 13, 7, 15), 1),
    ((0, 1, 8, 9, 4, 5, 12, 13), (2, 3, 10, 11, 6, 7, 14, 15), 2),
    ((0, 1, 2, 3, 8, 9, 10, 11), (4, 5, 6, 7, 12, 13, 14, 15), 4),
)


def _transposed(names: list[str], lines: list[str]) -> list[str]:
    """Eight vectors as the columns of a square, transposed."""
    for number, (low, high, distance) in enumerate(_MIXES):
        result = list(names)
        for i in (i for i in range(LANES) if not i & distance):
            for target, order in ((i, low), (i + distance, high)):
                indices = ", ".join(f"i32 {q}" for q in order)
                lines.append(
                    f"%t{number}.{target} = shufflevector {V} {names[i]}, {V} {names[i + distance]}, <8 x i32> <{indices}>"
                )
                result[target] = f"%t{number}.{target}"
        names = result
    return names


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
    found = _transposed([f"%i{i}" for i in range(LANES)], body)
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
    found = _transposed([f"%i{i}" for i in range(LANES)], body)
    for i in range(LANES):
        body.append(f"%w{i} = getelementptr double, ptr %q{i}, i64 %start")
        body.append(f"store {V} {found[i]}, ptr %w{i}, align 64")
    table = ", ".join(f"i64 {s}" for s in starts)
    constant = f"@{name}.groups = private constant [{len(starts)} x i64] [{table}]"
    return "\n".join([constant, head, "entry:", *_lane_pointers(), *_loop(body, str(len(starts)))])


def declarations(width: int) -> str:
    """What the functions of this module need besides :data:`wbmpc.kernel.dense.FMA`."""
    text = "declare i64 @llvm.smin.i64(i64, i64) nounwind memory(none)"
    return text if width == 8 else text + "\n" + FMA.replace("8 x", f"{width} x").replace("v8", f"v{width}")


def chain(pattern: list[list[int]], nz: int, ld: int, width: int) -> str:
    """One Runge-Kutta stage's sensitivity for eight nodes: T = J + c Jx S, A += w T; arguments J, S, T, A, C = (c, w).

    J, S, T, A: (states, ld) vectors of eight nodes; ``pattern[r]``: the states that row r of J depends on.
    """
    t = f"<{width} x double>"
    o = ["define void @chain_lanes(ptr noalias %J, ptr noalias %S, ptr noalias %T, ptr noalias %A, ptr %C) nounwind {"]
    o += ["entry:", "br label %pass", "pass:", f"%lane = phi i64 [0, %entry], [%next, %x{len(pattern) - 1}]"]
    o += [f"%{a.lower()} = getelementptr double, ptr %{a}, i64 %lane" for a in "JSTA"]
    o += ["%pc = getelementptr double, ptr %C, i64 %lane", f"%pw = getelementptr double, ptr %pc, i64 {LANES}"]
    o += [f"%c = load {t}, ptr %pc", f"%w = load {t}, ptr %pw"]
    o.append("br label %h0")
    for r, states in enumerate(pattern):
        o.append(f"h{r}:")
        for s in states:
            o.append(f"%pf{r}.{s} = getelementptr double, ptr %j, i64 {LANES * (r * ld + s)}")
            o.append(f"%lf{r}.{s} = load {t}, ptr %pf{r}.{s}")
            o.append(f"%f{r}.{s} = fmul {t} %c, %lf{r}.{s}")
        o += [f"br label %b{r}", f"b{r}:", f"%z{r} = phi i64 [0, %h{r}], [%n{r}, %b{r}]"]
        o += [f"%v{r} = mul i64 %z{r}, {LANES}", f"%o{r} = add i64 %v{r}, {LANES * r * ld}"]
        for a in "jta":
            o.append(f"%p{a}{r} = getelementptr double, ptr %{a}, i64 %o{r}")
        o.append(f"%s{r}.0 = load {t}, ptr %pj{r}")
        for i, s in enumerate(states):
            o.append(f"%os{r}.{s} = add i64 %v{r}, {LANES * s * ld}")
            o.append(f"%ps{r}.{s} = getelementptr double, ptr %s, i64 %os{r}.{s}")
            o.append(f"%ls{r}.{s} = load {t}, ptr %ps{r}.{s}")
            arguments = f"{t} %ls{r}.{s}, {t} %f{r}.{s}, {t} %s{r}.{i}"
            o.append(f"%s{r}.{i + 1} = call {t} @llvm.fmuladd.v{width}f64({arguments})")
        total = f"%s{r}.{len(states)}"
        o += [f"store {t} {total}, ptr %pt{r}", f"%la{r} = load {t}, ptr %pa{r}"]
        o.append(f"%na{r} = call {t} @llvm.fmuladd.v{width}f64({t} {total}, {t} %w, {t} %la{r})")
        o += [f"store {t} %na{r}, ptr %pa{r}", f"%n{r} = add i64 %z{r}, 1", f"%d{r} = icmp eq i64 %n{r}, {nz}"]
        o += [f"br i1 %d{r}, label %x{r}, label %b{r}", f"x{r}:"]
        if r + 1 < len(pattern):
            o.append(f"br label %h{r + 1}")
    o += [f"%next = add i64 %lane, {width}", f"%done = icmp eq i64 %next, {LANES}"]
    return "\n".join([*o, "br i1 %done, label %out, label %pass", "out:", "ret void", "}"])


def groups_of(offsets: Iterable[int]) -> list[int]:
    """The groups that hold these offsets of a matrix."""
    return sorted({o // LANES for o in offsets})


def compact(offsets: Sequence[Sequence[int]], groups: list[int]) -> list[list[int]]:
    """Offsets in a matrix as offsets among its groups, one group after the other."""
    rank = {g: i for i, g in enumerate(groups)}
    return [[LANES * rank[o // LANES] + o % LANES for o in row] for row in offsets]


def sensitivity_pattern(jacobian: np.ndarray, stages: int, quaternions: Iterable[int]) -> np.ndarray:
    """Where the derivative of a Runge-Kutta step can differ from zero; ``jacobian`` (nx, nx + nu): where that of ẋ can.

    ``quaternions``: where unit quaternions start, which the step makes one long again.
    """
    nx = len(jacobian)
    found = jacobian.copy()
    for _ in range(stages - 1):
        found |= (jacobian[:, :nx].astype(int) @ found.astype(int)) > 0
    found[:, :nx] |= np.eye(nx, dtype=bool)
    for q in quaternions:
        found[q : q + 4] = found[q : q + 4].any(axis=0)
    return found
