"""Products of matrices of fixed size as LLVM IR, also with a matrix whose entries are known to be few: [A b B] of a robot that is moved by
speeds is little more than a unit matrix beside a diagonal one, and an equality holds a few inputs.

Storage is that of :mod:`wbmpc.kernel.dense`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from wbmpc.kernel.dense import ALIGN, Body, V, pad

#: Vectors and columns of a product that are added up at once.
Tile = tuple[Sequence[int], Sequence[int]]
#: lda, bj, bk, ldc, ldi of a product.
Strides = tuple[int, int, int, int, int | None]
#: Runs of fewer columns are written out one by one.
SHORT = 4
#: A transposition of eight vectors of eight costs about as much as so many sums.
TRANSPOSITION = 24


def matrix_product(
    name: str, blocks: int, n: int, inner: int, lda: int, bj: int, bk: int, ldc: int, ldi: int | None, negative: bool,
    budget: int = 24, diagonal: int | None = None,
) -> str:  # fmt: skip
    """C[:, j] = I[:, j] ± Σ_k A[:, k] B[j bj + k bk] for j < n, k < inner; arguments A, B, C, I.

    ``blocks``: vectors of eight per column; ``ldi`` None: no I; ``budget``: vectors of eight that the registers can add up.
    ``diagonal``: C is symmetric with the diagonal of column j in row ``diagonal + j``; vectors below it are left out.
    """
    if n == 0 or inner == 0:
        raise ValueError("empty product")
    found = [tile for tall, columns in _heights(blocks, n, diagonal) for tile in tiles(range(tall), columns, budget)]
    strides = lda, bj, bk, ldc, ldi
    o = [f"define void @{name}(ptr %A, ptr %B, ptr %C, ptr %I) nounwind {{", "entry:", "br label %b0"]
    for number, (rows, columns) in enumerate(found):
        o += _tile(f"b{number}", rows, columns, inner, strides, negative)
        o.append(f"br label %b{number + 1}" if number + 1 < len(found) else "ret void")
    return "\n".join([*o, "}"])


def height(blocks: int, diagonal: int | None, j: int) -> int:
    """How many of a column's vectors are above its diagonal or hold it: see :func:`matrix_product`."""
    return blocks if diagonal is None else min(blocks, (diagonal + j) // 8 + 1)


def _heights(blocks: int, n: int, diagonal: int | None) -> list[tuple[int, range]]:
    """Neighboring columns of one height."""
    found: dict[int, list[int]] = {}
    for j in range(n):
        found.setdefault(height(blocks, diagonal, j), []).append(j)
    return [(tall, range(columns[0], columns[-1] + 1)) for tall, columns in found.items()]


def tiles(rows: Sequence[int], columns: Sequence[int], budget: int) -> list[Tile]:
    """Vectors and columns of tiles of nearly the same size whose sums fit into the registers."""
    tall = min(len(rows), budget)
    count = -(-len(columns) // max(1, min(8, budget // tall)))
    parts = [columns[a:b] for a, b in pairwise(len(columns) * i // count for i in range(count + 1))]
    return [(rows[i : i + tall], part) for i in range(0, len(rows), tall) for part in parts]


def _tile(
    p: str, rows: Sequence[int], columns: Sequence[int], inner: int, strides: Strides, negative: bool
) -> list[str]:
    """One tile of a product: all of its sums stay in registers."""
    lda, bj, bk, ldc, ldi = strides
    cells = [(q, i) for q in columns for i in rows]
    o = [f"{p}:"]
    initial = {}
    for q, i in cells:
        if ldi is None:
            initial[q, i] = "zeroinitializer"
            continue
        o.append(f"%{p}.pi{q}.{i} = getelementptr double, ptr %I, i64 {q * ldi + 8 * i}")
        o.append(f"%{p}.i{q}.{i} = load {V}, ptr %{p}.pi{q}.{i}, align {ALIGN}")
        initial[q, i] = f"%{p}.i{q}.{i}"
    o += [f"br label %{p}l", f"{p}l:", f"%{p}.k = phi i64 [0, %{p}], [%{p}.k1, %{p}l]"]
    o += [f"%{p}.a{q}.{i} = phi {V} [{initial[q, i]}, %{p}], [%{p}.n{q}.{i}, %{p}l]" for q, i in cells]
    o.append(f"%{p}.ka = mul i64 %{p}.k, {lda}")
    for i in rows:
        o.append(f"%{p}.oa{i} = add i64 %{p}.ka, {8 * i}")
        o.append(f"%{p}.pa{i} = getelementptr double, ptr %A, i64 %{p}.oa{i}")
        o.append(f"%{p}.av{i} = load {V}, ptr %{p}.pa{i}, align {ALIGN}")
    o.append(f"%{p}.kb = mul i64 %{p}.k, {bk}")
    for q in columns:
        o.append(f"%{p}.ob{q} = add i64 %{p}.kb, {q * bj}")
        o.append(f"%{p}.pb{q} = getelementptr double, ptr %B, i64 %{p}.ob{q}")
        o.append(f"%{p}.s{q} = load double, ptr %{p}.pb{q}")
        if negative:
            o.append(f"%{p}.t{q} = fneg double %{p}.s{q}")
        scalar = f"%{p}.{'t' if negative else 's'}{q}"
        o.append(f"%{p}.e{q} = insertelement {V} poison, double {scalar}, i32 0")
        o.append(f"%{p}.v{q} = shufflevector {V} %{p}.e{q}, {V} poison, <8 x i32> zeroinitializer")
        for i in rows:
            operands = f"{V} %{p}.av{i}, {V} %{p}.v{q}, {V} %{p}.a{q}.{i}"
            o.append(f"%{p}.n{q}.{i} = call {V} @llvm.fmuladd.v8f64({operands})")
    o += [f"%{p}.k1 = add i64 %{p}.k, 1", f"%{p}.c = icmp eq i64 %{p}.k1, {inner}"]
    o += [f"br i1 %{p}.c, label %{p}x, label %{p}l", f"{p}x:"]
    for q, i in cells:
        o.append(f"%{p}.po{q}.{i} = getelementptr double, ptr %C, i64 {q * ldc + 8 * i}")
        o.append(f"store {V} %{p}.n{q}.{i}, ptr %{p}.po{q}.{i}, align {ALIGN}")
    return o


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
