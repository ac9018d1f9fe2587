"""Dense kernels. Truth: NumPy, and the KKT system of one step of the recursion."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from effort import draws
from toys import aligned_copy, call_pointers, compile_ir
from wbmpc.kernel import dense
from wbmpc.kernel.products import matrix_product
from wbmpc.kernel.riccati import emit_curvature_node, emit_riccati_node, emit_step_node
from wbmpc.kernel.scalar import DECLARATIONS
from wbmpc.kernel.sizes import Sizes
from wbmpc.solver.workspace import aligned


def compile_kernel(text: str, name: str) -> tuple[object, int]:
    engine = compile_ir("\n".join([DECLARATIONS, dense.FMA, dense.ABSOLUTE, text]))
    return engine, engine.get_function_address(name)


@pytest.mark.parametrize("diagonal", [0, 3, 13])
def test_product_above_a_diagonal(diagonal: int) -> None:
    """Vectors with an entry on or above the diagonal are those of the whole product; the others stay as they are."""
    r, n, inner = np.random.default_rng(diagonal), 19, 7
    a, b = r.normal(size=(inner, 40)), r.normal(size=(n, inner))
    text = matrix_product("k", 5, n, inner, 40, inner, 1, 40, None, False, diagonal=diagonal)
    _engine, address = compile_kernel(text, "k")
    out = aligned(n * 40).reshape(n, -1)
    call_pointers(address, aligned_copy(a), aligned_copy(b), out, out)
    made = np.arange(40) // 8 <= (diagonal + np.arange(n)[:, None]) // 8
    np.testing.assert_allclose(out, np.where(made, b @ a, 0.0), rtol=1e-12, atol=1e-13)


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 9), st.integers(1, 9), st.integers(1, 9), st.booleans(), st.booleans(), st.integers(0, 99))
def test_matrix_product(rows: int, n: int, inner: int, negative: bool, initial: bool, seed: int) -> None:
    r = np.random.default_rng(seed)
    blocks = dense.pad(rows) // 8
    a, b = r.normal(size=(inner, 8 * blocks)), r.normal(size=(n, inner))
    start = r.normal(size=(n, 8 * blocks))
    ldi = 8 * blocks if initial else None
    text = matrix_product("k", blocks, n, inner, 8 * blocks, inner, 1, 8 * blocks, ldi, negative)
    _engine, address = compile_kernel(text, "k")
    out = aligned(n * 8 * blocks).reshape(n, -1)
    call_pointers(address, aligned_copy(a), aligned_copy(b), out, aligned_copy(start))
    want = (-1 if negative else 1) * b @ a + (start if initial else 0)
    np.testing.assert_allclose(out, want, rtol=1e-12, atol=1e-13)


def test_empty_product_is_rejected() -> None:
    with pytest.raises(ValueError, match="empty"):
        matrix_product("k", 1, 0, 3, 8, 1, 1, 8, None, False)


def random_node(s: Sizes, seed: int) -> tuple[np.ndarray, ...]:
    """A, b, B, H (symmetric), gradient, C, D, e, P (with slope) of one node."""
    r = np.random.default_rng(seed)
    nx, nu, ng = s.nx, s.nu, s.ng
    h = r.normal(size=(nx + nu, nx + nu + 2))
    p = r.normal(size=(nx, nx + 2))
    # well-conditioned rows, or the answer depends on the kernel's small softness
    turn = np.linalg.qr(r.normal(size=(nu, nu)))[0][:, :ng].T * r.uniform(0.5, 2.0, (ng, 1))
    return (
        r.normal(size=(nx, nx)), r.normal(size=nx), r.normal(size=(nx, nu)), h @ h.T, r.normal(size=nx + nu),
        r.normal(size=(ng, nx)), turn, r.normal(size=ng), p @ p.T, r.normal(size=nx),
    )  # fmt: skip


def thinned(s: Sizes, node: tuple[np.ndarray, ...], seed: int) -> tuple[np.ndarray, ...]:
    """The node with few entries in A and B, some of their columns full and some empty, and equalities that hold an input each."""
    r = np.random.default_rng(seed)
    a, b, bu, h, g, c, d, e, p, slope = node
    share = r.choice([0.0, 0.1, 1.0], size=s.nx + s.nu, p=[0.1, 0.7, 0.2])
    kept = r.uniform(size=(s.nx, s.nx + s.nu)) < share
    single = np.zeros_like(d)
    single[np.arange(s.ng), r.permutation(s.nu)[: s.ng]] = r.uniform(0.5, 2.0, s.ng)
    return a * kept[:, : s.nx], b, bu * kept[:, s.nx :], h, g, c, single, e, p, slope


def run_node(s: Sizes, node: tuple[np.ndarray, ...], known: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Gains (nu, nx + 1) and value function (nx + 1, nx + 1) of the compiled step; ``known``: it knows which entries are zero."""
    a, b, bu, h, g, c, d, e, p, slope = node
    nx, nu, ng, first = s.nx, s.nu, s.ng, s.first
    ab, hm = np.zeros((nx + 1, s.lz)), np.zeros((s.nz, s.lz))
    ab[:nx, :nx], ab[:nx, nx], ab[:nx, first : first + nu], ab[nx, nx] = a, b, bu, 1.0
    index = [*range(nx), *range(first, first + nu)]
    hm[np.ix_(index, index)] = h
    # what is read: the rows above and at an input's diagonal, and all of the state's block
    hm[:nx, first:] = 0.0
    hm[index, nx] = g
    hm[nx, :nx] = g[:nx]
    rows = np.zeros(max(s.equality_buffer(), 8))
    table = rows[: ng * s.lz].reshape(ng, s.lz)
    table[:, :nx], table[:, nx], table[:, first : first + nu] = c, e, d
    rows[ng * s.lz : ng * s.lz + nu * s.lg].reshape(nu, s.lg)[:, :ng] = d.T
    value = aligned((nx + 1) * s.lx).reshape(nx + 1, s.lx)
    value[:nx, :nx], value[:nx, nx], value[nx, :nx] = p, slope, slope
    gain = aligned(nu * s.lx).reshape(nu, s.lx)
    step = np.zeros((nx + 1, s.nz), dtype=bool)
    step[:nx], step[:, nx] = ab[:nx, : s.nz] != 0.0, True
    held = [[int(j) for j in np.flatnonzero(row)] for row in d]
    text = emit_riccati_node(s, step, held) if known else emit_riccati_node(s)
    _engine, address = compile_kernel(text, "riccati_node")
    eps, scratch = aligned(s.lg), aligned(s.scratch()["total"])
    call_pointers(address, aligned_copy(ab), aligned_copy(hm), aligned_copy(rows), eps, value, gain, scratch)
    return gain[:, : nx + 1], value[: nx + 1, : nx + 1]


@settings(max_examples=draws(12, 40), deadline=None, derandomize=True)
@given(st.integers(1, 20), st.integers(1, 12), st.booleans(), st.data())
def test_riccati_node_against_its_kkt_system(nx: int, nu: int, known: bool, data: st.DataObject) -> None:
    s = Sizes(nx, nu, data.draw(st.integers(0, min(10, nu))), 0, 0)
    node = random_node(s, data.draw(st.integers(0, 99)))
    node = thinned(s, node, data.draw(st.integers(0, 99))) if known else node
    a, b, bu, h, g, c, d, e, p, slope = node
    gain, value = run_node(s, node, known)
    # minimize over u the quadratic of (x, u) plus the next value, for every state and for the constant
    ab, ng = np.hstack([a, bu]), s.ng
    m, q = h + ab.T @ p @ ab, g + ab.T @ (slope + p @ b)
    left = np.block([[m[nx:, nx:], d.T], [d, np.zeros((ng, ng))]])
    right = -np.vstack([np.column_stack([m[nx:, :nx], q[nx:]]), np.column_stack([c, e])])
    want = np.linalg.solve(left, right)[:nu]
    scale = 1.0 + np.abs(want).max()
    assert np.abs(gain - want).max() < 1e-6 * scale * max(1.0, np.linalg.cond(left) * 1e-6)
    full = np.vstack([np.eye(nx), want[:, :nx]])
    feed = np.concatenate([np.zeros(nx), want[:, nx]])
    next_p, next_slope = full.T @ m @ full, full.T @ (q + m @ feed)
    size = 1.0 + np.abs(next_p).max() + np.abs(next_slope).max()
    tolerance = 1e-6 * size * max(1.0, np.linalg.cond(left) * 1e-6)
    assert np.abs(value[:nx, :nx] - next_p).max() < tolerance
    assert np.abs(value[:nx, nx] - next_slope).max() < tolerance
    np.testing.assert_array_equal(value, value.T)


@settings(max_examples=draws(8, 30), deadline=None, derandomize=True)
@given(st.integers(1, 20), st.integers(1, 12), st.booleans(), st.integers(0, 99))
def test_step_node(nx: int, nu: int, known: bool, seed: int) -> None:
    """Input, next state, slope and largest component of a step."""
    s, r = Sizes(nx, nu, 0, 0, 0), np.random.default_rng(seed)
    a, b, bu, *_ = thinned(s, random_node(s, seed), seed) if known else random_node(s, seed)
    ab, k, g = np.zeros((nx + 1, s.lz)), np.zeros((nu, s.lx)), np.zeros(s.lz)
    ab[:nx, :nx], ab[:nx, nx], ab[:nx, s.first : s.nz], ab[nx, nx] = a, b, bu, 1.0
    k[:, : nx + 1], g[:nx], g[s.first : s.nz] = r.normal(size=(nu, nx + 1)), r.normal(size=nx), r.normal(size=nu)
    x, u, sums = aligned(2 * s.lx), np.full(nu + 8, 7.0), aligned(16)
    x[:nx], x[nx] = r.normal(size=nx), 1.0
    text = emit_step_node(s, np.vstack([ab[:nx, : s.nz], ab[nx, : s.nz]]) != 0.0 if known else None)
    _engine, address = compile_kernel(text, "step_node")
    call_pointers(address, aligned_copy(ab), aligned_copy(k), x, u, aligned_copy(g), aligned(s.lz + 8), sums)
    want = k[:, : nx + 1] @ x[: nx + 1]
    following = a @ x[:nx] + b + bu @ want
    np.testing.assert_allclose(u[:nu], want, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(u[nu:], 7.0)
    np.testing.assert_allclose(x[s.lx :], [*following, 1.0, *[0.0] * (s.lx - nx - 1)], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(sums[:8].sum(), g[:nx] @ x[:nx] + g[s.first : s.nz] @ want, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(sums[8:].max(), np.abs([*want, *following]).max(), rtol=1e-12)


@settings(max_examples=draws(8, 30), deadline=None, derandomize=True)
@given(st.integers(1, 20), st.integers(1, 12), st.integers(0, 99))
def test_curvature_node(nx: int, nu: int, seed: int) -> None:
    """Only what is above the diagonal is read, and nothing of the constant's entries counts."""
    s, r = Sizes(nx, nu, 0, 0, 0), np.random.default_rng(seed)
    h, x, u, pulled, shift = r.normal(size=(s.nz, s.lz)), aligned(s.lx), r.normal(size=nu + 8), aligned(s.lz), 0.3
    x[: nx + 1], pulled[: s.nz] = [*r.normal(size=nx), 1.0], r.normal(size=s.nz)
    pulled[nx], h[:, nx] = 1e6, np.where(np.arange(s.nz) >= nx, 1e6, h[:, nx])
    sums = aligned(16)
    _engine, address = compile_kernel(emit_curvature_node(s), "curvature_node")
    call_pointers(address, aligned_copy(h), x, u, pulled, np.array([shift]), aligned(s.lz + 8), sums)
    upper = np.triu(h[:, : s.nz].T)
    index = [i for i in range(s.nz) if i != nx]
    symmetric = (upper + upper.T - np.diag(np.diag(upper)))[np.ix_(index, index)]
    z = np.concatenate([x[:nx], u[:nu]])
    y = symmetric @ z
    np.testing.assert_allclose(sums[:8].sum(), z @ y, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(sums[8:].max(), np.abs(y - shift * z - pulled[index]).max(), rtol=1e-12)
