"""Products with a matrix whose entries are known to be few: [A b B] of a robot that is moved by speeds is little more than a unit matrix
beside a diagonal one, and an equality holds a few inputs."""

from __future__ import annotations

from collections.abc import Sequence

from wbmpc.kernel.dense import Body, height, matrix_product, pad

#: Runs of fewer columns are written out one by one.
SHORT = 4
#: A transposition of eight vectors of eight costs about as much as so many sums.
TRANSPOSITION = 24


def sparse_product(
    name: str, blocks: int, columns: Sequence[Sequence[int]], inner: int, strides: tuple[int, int, int, int, int],
    budget: int = 24, diagonal: int | None = None,
) -> str:  # fmt: skip
    """As :func:`matrix_product` with I, where column j of B has entries at k in ``columns[j]`` only; ``strides``: lda, bj, bk, ldc, ldi.

    Columns with few entries are written out one by one; runs of others are dense products.
    """
    lda, bj, bk, ldc, ldi = strides
    b, products = Body(name, "A B C I"), []
    for run, full in _runs([3 * len(column) > inner for column in columns]):
        if full and len(run) >= SHORT:
            j, own = run.start, f"{name}.{run.start}"
            first = None if diagonal is None else diagonal + j
            products.append(matrix_product(own, blocks, len(run), inner, lda, bj, bk, ldc, ldi, False, budget, first))
            places = (("A", 0), ("B", j * bj), ("C", j * ldc), ("I", j * ldi))
            b.lines.append(f"call void @{own}({', '.join(f'ptr {b.address(*place)}' for place in places)})")
            continue
        for j in run:
            rows = range(height(blocks, diagonal, j))
            total = [b.load("I", j * ldi + 8 * i) for i in rows]
            for k in columns[j]:
                factor = b.spread_from("B", j * bj + k * bk)
                total = [b.fma(b.load("A", k * lda + 8 * i), factor, total[i]) for i in rows]
            for i in rows:
                b.store(total[i], "C", j * ldc + 8 * i)
    b.lines[0] = b.lines[0].replace("noalias ", "")
    return "\n".join([*products, b.text()])


def _runs(values: Sequence[bool]) -> list[tuple[range, bool]]:
    """Neighbors of the same value."""
    edges = [i for i in range(len(values)) if i == 0 or values[i] != values[i - 1]]
    return [(range(a, b), values[a]) for a, b in zip(edges, [*edges[1:], len(values)], strict=True)]


def transposed_product(
    name: str, columns: Sequence[Sequence[int]], inner: int, ldb: int, ldp: int, ldw: int, budget: int = 24
) -> str:
    """W = (P B)ᵀ for a symmetric P (inner, inner), where column j of B has entries at k in ``columns[j]`` only.

    Arguments B (row k at k ``ldb``), P, W (row i of P B at i ``ldw``). Eight columns of B with few entries make eight columns of P B, which are
    transposed; others make rows of W as a dense product.
    """
    groups = [columns[j : j + 8] for j in range(0, len(columns), 8)]
    tall = pad(inner) // 8
    few = [tall * (sum(map(len, group)) + TRANSPOSITION) < inner * inner for group in groups]
    b, products = Body(name, "B P W"), []
    for run, sparse in _runs(few):
        if not sparse:
            own, at = f"{name}.{run.start}", 8 * run.start
            products.append(matrix_product(own, len(run), inner, inner, ldb, ldp, 1, ldw, None, False, budget))
            places = ", ".join(f"ptr {b.address(*place)}" for place in (("B", at), ("P", 0), ("W", at), ("W", at)))
            b.lines.append(f"call void @{own}({places})")
            continue
        for g in run:
            for i in range(tall):
                made = [_column_of_product(b, column, 8 * g + q, 8 * i, ldb, ldp) for q, column in enumerate(groups[g])]
                rows = b.transpose([*made, *["zeroinitializer"] * (8 - len(made))])
                for r in range(8 * i, min(8 * i + 8, inner)):
                    b.store(rows[r - 8 * i], "W", r * ldw + 8 * g)
    return "\n".join([*products, b.text()])


def _column_of_product(b: Body, column: Sequence[int], j: int, row: int, ldb: int, ldp: int) -> str:
    """Eight rows of column j of P B."""
    total = "zeroinitializer"
    for k in column:
        total = b.fma(b.load("P", k * ldp + row), b.spread_from("B", k * ldb + j), total)
    return total
