"""Kernels of general rows that know which states and inputs each row touches.

The rows' Jacobian J (rows of the extended node vector [x, 1, u], column 1 their residual) is kept with all columns; what is added and
multiplied are the columns with entries. Neighbors of a like pattern are one block: rows of a distance touch a few states, those of a
drive one input, and a dense product would do the work of all.
"""

from __future__ import annotations

from dataclasses import dataclass

from wbmpc.kernel import dense
from wbmpc.kernel.products import Tile, product_of_tiles, tiles

#: What a block costs beyond its rows, as so many rows: its part of the Hessian is loaded and stored.
OVERHEAD = 2


@dataclass(frozen=True)
class Block:
    """Rows ``first`` … ``last`` − 1 and all columns that any of them touches, the residual's included."""

    first: int
    last: int
    columns: frozenset[int]

    @property
    def groups(self) -> set[int]:
        """The groups of eight columns with entries."""
        return {c // 8 for c in self.columns}

    @property
    def cost(self) -> int:
        """Of adding JᵀJ, in vectors."""
        return len(self.columns) * len(self.groups) * (self.last - self.first + OVERHEAD)

    def joined(self, other: Block) -> Block:
        """With the block that follows."""
        return Block(self.first, other.last, self.columns | other.columns)


def row_blocks(pattern: list[set[int]], constant: int) -> list[Block]:
    """Blocks of neighbors, from the columns of each row; ``constant``: the column of the residuals."""
    blocks: list[Block] = []
    for i, columns in enumerate(pattern):
        blocks.append(Block(i, i + 1, frozenset(columns | {constant})))
        while len(blocks) > 1 and blocks[-2].joined(blocks[-1]).cost <= blocks[-2].cost + blocks[-1].cost:
            last = blocks.pop()
            blocks[-1] = blocks[-1].joined(last)
    return blocks


def upper_columns(block: Block) -> dict[int, list[int]]:
    """A block's columns by the group that holds their diagonals."""
    found: dict[int, list[int]] = {}
    for c in sorted(block.columns):
        found.setdefault(c // 8, []).append(c)
    return found


def added_groups(pattern: list[set[int]], constant: int, lz: int) -> set[int]:
    """The groups of eight of a node's Hessian that :func:`emit_add_rows` adds to."""
    found = set()
    for block in row_blocks(pattern, constant):
        for own, columns in upper_columns(block).items():
            found |= {c * lz // 8 + g for c in columns for g in block.groups if g <= own}
    return found


def emit_add_rows(pattern: list[set[int]], constant: int, lz: int, budget: int) -> str:
    """H += Jᵀ diag(W) J, what is above the diagonal, for rows J of the extended node vector; arguments J, W, H."""
    parts, calls = [], []
    for number, block in enumerate(row_blocks(pattern, constant)):
        name, first, found = f"k_rows{number}", block.first, list[Tile]()
        for own, columns in upper_columns(block).items():
            found += tiles(sorted(g for g in block.groups if g <= own), columns, budget)
        parts.append(product_of_tiles(name, found, block.last - first, (lz, 1, lz, lz, lz), weighted=True))
        calls.append(f"%j{number} = getelementptr double, ptr %J, i64 {first * lz}")
        calls.append(f"%w{number} = getelementptr double, ptr %W, i64 {first}")
        calls.append(f"call void @{name}(ptr %j{number}, ptr %j{number}, ptr %H, ptr %H, ptr %w{number})")
    body = ["define void @add_rows(ptr %J, ptr %W, ptr %H) nounwind {", *calls, "ret void", "}"]
    return "\n".join([*parts, *body])


def emit_row_products(pattern: list[set[int]], lz: int) -> str:
    """out = J z of rows of the extended node vector, without their residuals; arguments J, Z (with 0 for 1), OUT."""
    body = dense.Body("row_products", "J Z OUT")
    vector = {g: body.load("Z", 8 * g) for g in sorted({c // 8 for columns in pattern for c in columns})}
    for first in range(0, len(pattern), 8):
        found = []
        for i in range(first, min(first + 8, len(pattern))):
            total = "zeroinitializer"
            for g in sorted({c // 8 for c in pattern[i]}):
                total = body.fma(body.load("J", i * lz + 8 * g), vector[g], total)
            found.append(total)
        body.store_some(body.sums(found), len(found), "OUT", first)
    return body.text()
