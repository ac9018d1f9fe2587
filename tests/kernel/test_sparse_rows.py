"""Kernels of rows that know their columns. Truth: NumPy with all columns."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from toys import aligned_copy, call_pointers, compile_ir
from wbmpc.kernel import dense
from wbmpc.kernel.sparse_rows import added_groups, emit_add_rows, emit_row_products, row_blocks
from wbmpc.solver.workspace import aligned


@settings(max_examples=10, deadline=None)
@given(
    st.integers(1, 20),
    st.integers(1, 12),
    st.integers(1, 25),
    st.floats(0.0, 1.0),
    st.sampled_from([3, 24]),
    st.integers(0, 99),
)
def test_any_pattern_gives_what_all_columns_give(
    nx: int, nu: int, rows: int, share: float, budget: int, seed: int
) -> None:
    """Of the Hessian what is above the diagonal, in the groups that are announced, and nothing else."""
    r = np.random.default_rng(seed)
    nz = nx + 1 + nu
    lz = dense.pad(nz)
    touched = r.random((rows, nz)) < share
    touched[:, nx] = False
    pattern = [set(np.flatnonzero(row).tolist()) for row in touched]
    text = [dense.FMA, emit_add_rows(pattern, nx, lz, budget), emit_row_products(pattern, lz)]
    engine = compile_ir("\n".join(text))
    jacobian, step, sigma = np.zeros((rows, lz)), np.zeros(lz), r.uniform(0.1, 10.0, (rows, 1))
    jacobian[:, :nz] = np.where(touched, r.normal(size=(rows, nz)), 0.0)
    step[:nz] = r.normal(size=nz)
    step[nx] = 0.0
    out = aligned(dense.pad(rows))
    call_pointers(engine.get_function_address("row_products"), aligned_copy(jacobian), aligned_copy(step), out)
    np.testing.assert_allclose(out[:rows], jacobian @ step, rtol=1e-12, atol=1e-12)
    jacobian[:, nx] = r.normal(size=rows)  # residuals, for the gradient
    hessian = r.normal(size=(nz, lz))
    found = aligned_copy(hessian)
    call_pointers(engine.get_function_address("add_rows"), aligned_copy(jacobian), aligned_copy(sigma), found)
    want = hessian + (jacobian.T @ (sigma * jacobian))[:nz]
    upper = np.arange(lz) <= np.arange(nz)[:, None]
    np.testing.assert_allclose(found[upper], want[upper], rtol=1e-12, atol=1e-12)
    others = np.ones(nz * lz // 8, dtype=bool)
    others[sorted(added_groups(pattern, nx, lz))] = False
    np.testing.assert_array_equal(found.reshape(-1, 8)[others], hessian.reshape(-1, 8)[others])


def test_neighbors_of_a_like_pattern_are_one_block() -> None:
    """Two groups of rows, of states and of inputs far from them, and one in between that touches almost the first's columns."""
    pattern = [{0, 1, 2}] * 10 + [{0, 1}] + [{30, 31}] * 10
    assert [(b.first, b.last) for b in row_blocks(pattern, 12)] == [(0, 11), (11, 21)]
