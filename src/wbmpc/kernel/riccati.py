"""One backward step of the Riccati recursion as LLVM IR, for a problem's sizes and the entries that its matrices can have.

The letters are those of docs/explanation/solver.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from wbmpc.kernel import dense
from wbmpc.kernel.codegen_target import vector_budget
from wbmpc.kernel.products import matrix_product, sparse_product, transposed_product
from wbmpc.kernel.sizes import Sizes

#: ε of the equality rows, relative to the diagonal of their Schur complement.
RELATIVE_SOFTNESS = 1e-12


def _columns(pattern: np.ndarray) -> list[list[int]]:
    """Of every column the rows with entries."""
    return [[int(k) for k in np.flatnonzero(column)] for column in pattern.T]


def _parts(s: Sizes, columns: list[list[int]], held: Sequence[Sequence[int]], touched: int) -> list[str]:
    """The functions that a step calls, those of equalities included. ``touched``: the inputs from there on are in no equality."""
    nx1, nu, ng, lx, lz, lg, first, budget = s.nx + 1, s.nu, s.ng, s.lx, s.lz, s.lg, s.first, vector_budget()
    xb, zb, gb = lx // 8, lz // 8, lg // 8
    product = partial(matrix_product, budget=budget)
    parts = [
        transposed_product("k_w", columns, nx1, lz, lx, lz, budget),
        sparse_product("k_m", zb, columns, nx1, (lz, 1, lz, lz, lz), budget, 0),
        dense.reverse_cholesky("k_chol", nu, first, lz, touched, gb, lg, budget),
        product("k_p", xb, nx1, nu, lz, 1, lz, lx, lz, True, diagonal=0),
        dense.gains("k_gains", nu, first, lz, xb, lx, touched, lx, budget), dense.mirror("k_mirror", nx1, lx),
    ]  # fmt: skip
    if s.ng:
        parts += [
            product("k_ch", xb, ng, touched, lz, 1, lg, lx, lz, True),
            product("k_s", gb, ng, touched, lg, 1, lg, lg, None, False),
            dense.schur_factor("k_factor", ng, lg, lx, RELATIVE_SOFTNESS, budget),
            product("k_pz", xb, nx1, ng, lx, 1, lx, lx, lx, False, diagonal=0),
            dense.schur_back("k_back", ng, lg, lx, budget),
            product("k_t", xb, touched, ng, lx, lg, 1, lx, lz, False),
            sparse_product("k_left", xb, held, touched, (lx, lz, 1, lx, lz), budget), dense.soften("k_soft", ng, lx),
            dense.schur_forward("k_forth", ng, lg, lx, budget),
            product("k_more", xb, touched, ng, lx, lg, 1, lx, lx, False),
        ]  # fmt: skip
    return parts


def emit_riccati_node(s: Sizes, pattern: np.ndarray | None = None, held: Sequence[Sequence[int]] | None = None) -> str:
    """One backward step; arguments AB, H, E (equality rows), EPS, P, K, X (scratch).

    ``pattern`` (nx + 1, nz): where [A b B; 0 1 0] can differ from zero; ``held``: of every equality the inputs in it; None: everywhere.
    """
    pattern = np.ones((s.nx + 1, s.nz), dtype=bool) if pattern is None else pattern
    held = [list(range(s.nu))] * s.ng if held is None else held
    touched = max((j + 1 for inputs in held for j in inputs), default=min(s.ng, 1))
    o, lz, nx1 = s.scratch(), s.lz, s.nx + 1
    body = dense.Body("riccati_node", "AB H E EPS P K X")
    body.lines = [body.lines[0].replace("noalias ", "")]
    at = body.address

    def call(name: str, *pointers: str) -> None:
        body.lines.append(f"call void @{name}({', '.join(f'ptr {p}' for p in pointers)})")

    w, m, d, t, r, z = (at("X", o[name]) for name in "WMDTRZ")
    mu = at("X", o["M"] + lz * nx1)
    call("k_w", "%AB", "%P", w)
    call("k_m", w, "%AB", m, "%H")
    call("k_chol", mu, d, at("E", s.ng * lz), r)
    call("k_p", mu, mu, "%P", m)
    if s.ng:
        sc, inverse, left = at("X", o["S"]), at("X", o["I"]), at("X", o["Y"])
        call("k_ch", mu, r, z, "%E")
        call("k_s", r, r, sc, sc)
        call("k_factor", sc, z, "%EPS", inverse)
        call("k_pz", z, z, "%P", "%P")
        call("k_back", sc, inverse, z)
        call("k_t", z, r, t, mu)
        call("k_gains", mu, d, t, "%K")
        # once more for what the rows still lack: a saturated input makes the Schur complement ill-conditioned
        call("k_left", "%K", at("E", s.first), left, "%E")
        call("k_soft", left, z, "%EPS")
        call("k_forth", sc, inverse, left)
        call("k_back", sc, inverse, left)
        call("k_more", left, r, t, t)
    call("k_gains", mu, d, t, "%K")
    call("k_mirror", "%P")
    return "\n".join([*_parts(s, _columns(pattern), held, touched), body.text()])


def emit_step_node(s: Sizes, pattern: np.ndarray | None = None) -> str:
    """One forward step: U = K X, and [A b B; 0 1 0] [X; U] behind X; arguments AB, K, X, U, G (gradient), Z (scratch, lz + 8), S.

    S: two vectors, onto which slope and largest component go lane by lane. ``pattern``: as of :func:`emit_riccati_node`.
    """
    pattern = np.ones((s.nx + 1, s.nz), dtype=bool) if pattern is None else pattern
    nx, nu, lx, lz, b = s.nx, s.nu, s.lx, s.lz, dense.Body("step_node", "AB K X U G Z S")

    def product(array: str, row: int, groups: Sequence[int], vectors: Sequence[str]) -> str:
        total = "zeroinitializer"
        for g in groups:
            total = b.fma(b.load(array, row + 8 * g), vectors[g], total)
        return total

    x = [b.load("X", i) for i in range(0, lx, 8)]
    largest = b.load("S", 8)
    for i, vector in enumerate(x):
        b.store(vector, "Z", 8 * i)
    for first in range(0, nu, 8):
        u = b.sums([product("K", j * lx, range(lx // 8), x) for j in range(first, min(first + 8, nu))])
        largest = b.larger(largest, b.absolute(u))
        b.store_some(u, min(8, nu - first), "U", first)
        b.store_some(u, 8, "Z", nx + 1 + first)
    z, slope = [b.load("Z", i) for i in range(0, lz, 8)], b.load("S", 0)
    for i, vector in enumerate(z):
        slope = b.fma(vector, b.load("G", 8 * i), slope)
    b.store(slope, "S", 0)
    for first in range(0, lx, 8):
        rows = range(first, min(first + 8, nx + 1))
        groups = {r: sorted({int(c) // 8 for c in np.flatnonzero(pattern[r])}) for r in rows}
        following = b.sums([product("AB", r * lz, groups[r], z) for r in rows])
        b.store(following, "X", lx + first)
        states = b.shuffle(following, "zeroinitializer", [q if first + q < nx else 8 for q in range(8)])
        largest = b.larger(largest, b.absolute(states))
    b.store(largest, "S", 8)
    return b.text()


def emit_curvature_node(s: Sizes) -> str:
    """y = H z of a node's step z = [X, 0, U], by what of H is above the diagonal; arguments H, X, U, PULLED, SHIFT, Z (scratch, lz + 8), S.

    S: two vectors, onto which z y and the largest |y − SHIFT z − PULLED| go lane by lane, the constant's left out.
    """
    nx, nz, b = s.nx, s.nz, dense.Body("curvature_node", "H X U PULLED SHIFT Z S")
    groups = range(s.lz // 8)
    kept = lambda vector, group, keep: b.shuffle(
        vector, "zeroinitializer", [q if keep(8 * group + q) else 8 for q in range(8)]
    )
    for g in range(s.lx // 8):
        b.store(kept(b.load("X", 8 * g), g, lambda i: i < nx), "Z", 8 * g)
    for first in range(0, s.nu, 8):
        count = min(8, s.nu - first)
        b.store_some(b.load_unaligned("U", first), count, "Z", nx + 1 + first)
    z = [kept(b.load("Z", 8 * g), g, lambda i: i < nz) for g in groups]
    y = ["zeroinitializer"] * len(groups)
    for own in groups:
        dots = []
        for j in range(8 * own, min(8 * own + 8, nz)):
            by, total = b.spread(z[own], j - 8 * own), "zeroinitializer"
            for g in range(own + 1):
                column = b.load("H", j * s.lz + 8 * g)
                above = column if g < own else kept(column, g, lambda i, j=j: i < j)
                y[g] = b.fma(column if g < own else kept(column, g, lambda i, j=j: i <= j), by, y[g])
                total = b.fma(above, z[g], total)
            dots.append(total)
        y[own] = b.add(y[own], b.sums(dots))
    products, largest, shift = b.load("S", 0), b.load("S", 8), b.negate(b.spread_from("SHIFT", 0))
    for g in groups:
        found = kept(y[g], g, lambda i: i != nx)
        products = b.fma(found, z[g], products)
        left = b.subtract(b.fma(shift, z[g], found), kept(b.load("PULLED", 8 * g), g, lambda i: i != nx))
        largest = b.larger(largest, b.absolute(left))
    b.store(products, "S", 0)
    b.store(largest, "S", 8)
    return b.text()
