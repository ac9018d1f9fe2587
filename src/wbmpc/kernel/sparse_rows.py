"""Kernels of general rows that know which states and inputs each row touches.

The rows' Jacobian J (rows of the extended node vector [x, 1, u], column 1 their residual) is kept with all columns; what is added and
multiplied are the columns with entries. Neighbors of a like pattern are one block: rows of a distance touch a few states, those of a
drive one input, and a dense product would do the work of all.
"""

from __future__ import annotations

from dataclasses import dataclass

from wbmpc.kernel import dense

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


def runs(numbers: set[int] | frozenset[int]) -> list[range]:
    """Neighboring numbers as ranges."""
    found: list[range] = []
    for n in sorted(numbers):
        if found and found[-1].stop == n:
            found[-1] = range(found[-1].start, n + 1)
        else:
            found.append(range(n, n + 1))
    return found


def emit_add_rows(pattern: list[set[int]], constant: int, lz: int, budget: int) -> str:
    """H += Aᵀ B for the rows A of the extended node vector and B, the same times their weights; arguments A, B, H."""
    products, calls = [], []
    for number, block in enumerate(row_blocks(pattern, constant)):
        for i, columns in enumerate(runs(block.columns)):
            for k, groups in enumerate(runs(block.groups)):
                name = f"k_rows{number}.{i}.{k}"
                rows = block.last - block.first
                products.append(dense.matrix_product(
                    name, len(groups), len(columns), rows, lz, 1, lz, lz, lz, False, budget
                ))  # fmt: skip
                offsets = {
                    "A": block.first * lz + 8 * groups.start,
                    "B": block.first * lz + columns.start,
                    "H": columns.start * lz + 8 * groups.start,
                }
                at = {}
                for array, offset in offsets.items():
                    at[array] = f"%{array.lower()}{number}.{i}.{k}"
                    calls.append(f"{at[array]} = getelementptr double, ptr %{array}, i64 {offset}")
                calls.append(f"call void @{name}(ptr {at['A']}, ptr {at['B']}, ptr {at['H']}, ptr {at['H']})")
    body = ["define void @add_rows(ptr %A, ptr %B, ptr %H) nounwind {", *calls, "ret void", "}"]
    return "\n".join([*products, *body])


def emit_row_products(pattern: list[set[int]], lz: int) -> str:
    """out = J z of rows of the extended node vector, without their residuals; arguments J, Z (with 0 for 1), OUT."""
    body = dense.Body("row_products", "J Z OUT")
    vector = {g: body.load("Z", 8 * g) for g in sorted({c // 8 for columns in pattern for c in columns})}
    for i, columns in enumerate(pattern):
        total = "zeroinitializer"
        for g in sorted({c // 8 for c in columns}):
            total = body.fma(body.load("J", i * lz + 8 * g), vector[g], total)
        sums = f"call reassoc double @llvm.vector.reduce.fadd.v8f64(double -0.0, {dense.V} {total})"
        body.store_scalar(body.new(sums), "OUT", i)
    return "\n".join([f"declare double @llvm.vector.reduce.fadd.v8f64(double, {dense.V})", body.text()])
