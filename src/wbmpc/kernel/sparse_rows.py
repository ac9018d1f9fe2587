"""Kernels of general rows for eight nodes at a time that know which states and inputs each row touches.

The Jacobian J of the rows, by [x, 1, u], lies side by side for eight nodes: a vector for each entry, the entries of one row after those of the
one before. Neighbors of a like pattern are one block, whose rows hold all columns that any of them touches: rows of a distance touch a few
states, those of a drive one input, and a product with all columns would do the work of all.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from wbmpc.kernel.blocks import LaneBody
from wbmpc.kernel.dense import Body
from wbmpc.kernel.ir import LANES

#: What a block costs beyond its rows, as so many rows: its part of the Hessian is loaded and stored.
OVERHEAD = 2


@dataclass(frozen=True)
class Block:
    """Rows ``first`` … ``last`` − 1 and all columns that any of them touches."""

    first: int
    last: int
    columns: frozenset[int]

    @property
    def cost(self) -> int:
        """Of adding JᵀJ, in products."""
        n = len(self.columns)
        return n * (n + 3) // 2 * (self.last - self.first + OVERHEAD)

    def joined(self, other: Block) -> Block:
        """With the block that follows."""
        return Block(self.first, other.last, self.columns | other.columns)


def row_blocks(pattern: Sequence[set[int]]) -> list[Block]:
    """Blocks of neighbors, from the columns of each row."""
    blocks: list[Block] = []
    for i, columns in enumerate(pattern):
        blocks.append(Block(i, i + 1, frozenset(columns)))
        while len(blocks) > 1 and blocks[-2].joined(blocks[-1]).cost <= blocks[-2].cost + blocks[-1].cost:
            last = blocks.pop()
            blocks[-1] = blocks[-1].joined(last)
    return blocks


@dataclass(frozen=True)
class RowLayout:
    """Where the entries of rows with these columns (their ``pattern``) are."""

    pattern: tuple[frozenset[int], ...]

    @classmethod
    def of(cls, pattern: Sequence[set[int]]) -> RowLayout:
        return cls(tuple(frozenset(columns) for columns in pattern))

    @cached_property
    def blocks(self) -> list[Block]:
        return row_blocks([set(columns) for columns in self.pattern])

    @cached_property
    def entries(self) -> list[tuple[int, int]]:
        """(row, column) of every entry."""
        return [(r, c) for b in self.blocks for r in range(b.first, b.last) for c in sorted(b.columns)]

    @cached_property
    def places(self) -> dict[tuple[int, int], int]:
        """The number of the vector of each entry."""
        return {entry: i for i, entry in enumerate(self.entries)}

    @property
    def columns(self) -> list[int]:
        """All columns that any row touches."""
        return sorted(set[int]().union(*self.pattern))

    def starts(self) -> Iterator[tuple[int, Block, list[int]]]:
        """Every block with columns: the number of its first vector, itself, its columns."""
        start = 0
        for block in self.blocks:
            if block.columns:
                yield start, block, sorted(block.columns)
            start += len(block.columns) * (block.last - block.first)


def hessian_entry(a: int, b: int, lz: int) -> int:
    """Where the product of two columns goes in a matrix of the extended node vector: above the diagonal."""
    return max(a, b) * lz + min(a, b)


def added_entries(layout: RowLayout, lz: int) -> set[int]:
    """The entries of a node's Hessian that :func:`emit_add_rows` adds to."""
    return {hessian_entry(a, b, lz) for block in layout.blocks for a in block.columns for b in block.columns}


def _tiles(columns: int, size: int) -> Iterator[list[tuple[int, int]]]:
    """Pairs p ≤ q of columns, with one more "column" for the residual, as squares whose sums fit into the registers."""
    starts = range(0, columns + 1, size)
    for i in starts:
        for j in (s for s in starts if s >= i):
            found = [
                (p, q) for p in range(i, min(i + size, columns)) for q in range(max(j, p), min(j + size, columns + 1))
            ]
            if found:
                yield found


def emit_add_rows(layout: RowLayout, place: dict[int, int], written: set[int], lz: int, width: int) -> str:
    """H += Jᵀ w σ J, above the diagonal, and G = Jᵀ w σ e by the layout's columns; arguments J, S (σ), E, W, H, G, all of eight nodes.

    ``place``: the number of an entry's vector in H; ``written``: the vectors of H that have a value before, the others count as zero.
    """
    b = LaneBody("add_rows", "J S E W H G", width)
    weight, order = b.load("W", 0), {c: i for i, c in enumerate(layout.columns)}
    begun = {("H", at) for at in written}
    for start, block, columns in layout.starts():
        n = len(columns)
        for pairs in _tiles(n, 4 if width == LANES else 3):
            targets = [
                ("H", place[hessian_entry(columns[p], columns[q], lz)]) if q < n else ("G", order[columns[p]])
                for p, q in pairs
            ]
            initial = [b.load(*at) if at in begun else "zeroinitializer" for at in targets]
            begun |= set(targets)
            row, sums = b.loop(block.last - block.first, initial)
            at = b.new(f"mul i64 {row}, {n}")
            of_row = b.new(f"add i64 {row}, {block.first}")
            scale = b.scale(weight, b.load("S", of_row))
            entry = {
                p: b.load("J", b.new(f"add i64 {at}, {start + p}"))
                for p in {i for pair in pairs for i in pair}
                if p < n
            }
            if any(q == n for _, q in pairs):
                entry[n] = b.load("E", of_row)
            scaled = {p: b.scale(scale, entry[p]) for p in {p for p, _ in pairs}}
            done = [b.fma(scaled[p], entry[q], total) for (p, q), total in zip(pairs, sums, strict=True)]
            b.end_loop(done)
            for value, target in zip(done, targets, strict=True):
                b.store(value, *target)
    return b.text()


def emit_row_products(layout: RowLayout, nx: int, width: int) -> str:
    """OUT = J z by rows; arguments J, X, U (z is made of), OUT, all of eight nodes."""
    b = LaneBody("row_products", "J X U OUT", width)
    for start, block, columns in layout.starts():
        z = [b.load("X", c) if c < nx else b.load("U", c - nx - 1) for c in columns]
        row, _ = b.loop(block.last - block.first, [])
        at, total = b.new(f"mul i64 {row}, {len(columns)}"), "zeroinitializer"
        for i, value in enumerate(z):
            total = b.fma(b.load("J", b.new(f"add i64 {at}, {start + i}")), value, total)
        b.store(total, "OUT", b.new(f"add i64 {row}, {block.first}"))
        b.end_loop([])
    for block in layout.blocks:
        for r in range(block.first, block.last) if not block.columns else ():
            b.store("zeroinitializer", "OUT", r)
    return b.text()


def emit_add_gradient(layout: RowLayout, nx: int, lz: int) -> str:
    """What :func:`emit_add_rows` leaves in G onto one node's Hessian, with the constant; arguments G (from the node's lane on), H."""
    b = Body("add_row_gradient", "G H")
    for i, c in enumerate(layout.columns):
        at = hessian_entry(c, nx, lz)
        total = b.new(f"fadd double {b.load_scalar('G', LANES * i)}, {b.load_scalar('H', at)}")
        b.store_scalar(total, "H", at)
    return b.text()


def _entry_loop(name: str, arguments: str, tables: dict[str, list[int]], body: list[str]) -> str:
    """``body`` for every entry %g of one node's Jacobian, with its numbers of the ``tables``."""
    parameters = ", ".join(f"ptr noalias %{a}" for a in arguments.split())
    head = f"define void @{name}({parameters}) nounwind {{"
    count = len(next(iter(tables.values())))
    if not count:
        return f"{head}\nret void\n}}"
    constants = [
        f"@{name}.{t} = private constant [{count} x i64] [{', '.join(f'i64 {v}' for v in values)}]"
        for t, values in tables.items()
    ]
    lines = [head, "entry:", "br label %body", "body:", "%g = phi i64 [0, %entry], [%g1, %body]"]
    for t in tables:
        lines += [f"%p{t} = getelementptr i64, ptr @{name}.{t}, i64 %g", f"%{t} = load i64, ptr %p{t}"]
    lines += [f"%o = mul i64 %g, {LANES}", "%pj = getelementptr double, ptr %J, i64 %o", "%j = load double, ptr %pj"]
    end = ["%g1 = add i64 %g, 1", f"%c = icmp eq i64 %g1, {count}", "br i1 %c, label %out, label %body"]
    return "\n".join([*constants, *lines, *body, *end, "out:", "ret void", "}"])


def emit_node_rows(layout: RowLayout, lz: int) -> str:
    """J of one node with all columns, what is zero left out; arguments J (from the node's lane on), OUT (rows, lz)."""
    body = ["%to = getelementptr double, ptr %OUT, i64 %place", "store double %j, ptr %to"]
    return _entry_loop("node_rows", "J OUT", {"place": [r * lz + c for r, c in layout.entries]}, body)


def emit_pulled_rows(layout: RowLayout) -> str:
    """OUT += Jᵀ v of one node by [x, 1, u]; arguments J (from the node's lane on), V, OUT."""
    body = ["%pv = getelementptr double, ptr %V, i64 %row", "%v = load double, ptr %pv"]
    body += ["%to = getelementptr double, ptr %OUT, i64 %column", "%old = load double, ptr %to"]
    body += [
        "%part = fmul contract double %j, %v",
        "%new = fadd contract double %old, %part",
        "store double %new, ptr %to",
    ]
    rows, columns = ([entry[i] for entry in layout.entries] for i in (0, 1))
    return _entry_loop("pulled_rows", "J V OUT", {"row": rows, "column": columns}, body)
