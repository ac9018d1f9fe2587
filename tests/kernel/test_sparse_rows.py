"""Kernels of rows that know their columns, for eight nodes. Truth: NumPy with all columns, node by node."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from toys import aligned_copy, call_pointers, compile_ir
from wbmpc.kernel import blocks, dense
from wbmpc.kernel.sparse_rows import (
    RowLayout,
    added_entries,
    emit_add_gradient,
    emit_add_rows,
    emit_node_rows,
    emit_pulled_rows,
    emit_row_products,
    hessian_entry,
    row_blocks,
)
from wbmpc.solver.workspace import aligned

EIGHT = 8


@pytest.mark.parametrize("width", [8, 4, 2])
@settings(max_examples=8, deadline=None)
@given(st.integers(1, 20), st.integers(1, 12), st.integers(1, 25), st.floats(0.0, 1.0), st.integers(0, 99))
def test_any_pattern_gives_what_all_columns_give(
    width: int, nx: int, nu: int, rows: int, share: float, seed: int
) -> None:
    """Of the Hessian the announced entries above the diagonal, and nothing else; entries that had no value count as zero."""
    r = np.random.default_rng(seed)
    nz = nx + 1 + nu
    lz = dense.pad(nz)
    touched = r.random((rows, nz)) < share
    touched[:, nx] = False
    layout = RowLayout.of([set(np.flatnonzero(row).tolist()) for row in touched])
    entries = sorted(added_entries(layout, lz))
    place, written = {e: i for i, e in enumerate(entries)}, set(range(0, len(entries), 2))
    text = [blocks.declarations(width), dense.FMA, emit_add_rows(layout, place, written, lz, width)]
    text += [emit_row_products(layout, nx, width), emit_node_rows(layout, lz), emit_pulled_rows(layout)]
    engine = compile_ir("\n".join([*text, emit_add_gradient(layout, nx, lz)]))
    call = lambda name, *arrays: call_pointers(engine.get_function_address(name), *arrays)

    jacobian = np.where(touched, r.normal(size=(EIGHT, rows, nz)), 0.0)
    lanes = aligned(EIGHT * max(len(layout.entries), 1)).reshape(-1, EIGHT)
    for (row, column), at in layout.places.items():
        lanes[at] = jacobian[:, row, column]
    x, u = r.normal(size=(nx, EIGHT)), r.normal(size=(nu, EIGHT))
    products = aligned_copy(r.normal(size=(rows, EIGHT)))
    call("row_products", lanes, aligned_copy(x), aligned_copy(u), products)
    z = np.vstack([x, np.zeros(EIGHT), u])
    np.testing.assert_allclose(products, np.einsum("kri,ik->rk", jacobian, z), rtol=1e-12, atol=1e-12)

    sigma, e, w = r.uniform(0.1, 10.0, (rows, EIGHT)), r.normal(size=(rows, EIGHT)), r.uniform(0.1, 1.0, EIGHT)
    before = r.normal(size=(max(len(entries), 1), EIGHT))
    hessian, gradient = aligned_copy(before), aligned_copy(r.normal(size=(nz, EIGHT)))
    call("add_rows", lanes, aligned_copy(sigma), aligned_copy(e), aligned_copy(w), hessian, gradient)
    added = np.einsum("kri,rk,krj->ijk", jacobian, w * sigma, jacobian)
    for a in range(nz):
        for b in range(a, nz):
            at = place.get(hessian_entry(a, b, lz))
            if at is None:
                assert not np.any(added[a, b])
            else:
                start = before[at] if at in written else 0.0
                np.testing.assert_allclose(hessian[at], start + added[a, b], rtol=1e-12, atol=1e-12)
    pull = np.einsum("kri,rk->ik", jacobian, w * sigma * e)

    for lane in (0, 5):
        own = lanes.reshape(-1)[lane:]
        matrix = r.normal(size=(nz, lz))
        found = aligned_copy(matrix)
        call("add_row_gradient", gradient.reshape(-1)[lane:], found)
        matrix[nx, :nx] += pull[:nx, lane]
        matrix[nx + 1 :, nx] += pull[nx + 1 :, lane]
        np.testing.assert_allclose(found, matrix, rtol=1e-12, atol=1e-12)
        whole = aligned(rows * lz).reshape(rows, lz)
        call("node_rows", own, whole)
        np.testing.assert_array_equal(whole[:, :nz], jacobian[lane])
        value, out = r.normal(size=rows), r.normal(size=lz)
        pulled = aligned_copy(out)
        call("pulled_rows", own, aligned_copy(value), pulled)
        out[:nz] += jacobian[lane].T @ value
        np.testing.assert_allclose(pulled, out, rtol=1e-12, atol=1e-12)


def test_neighbors_of_a_like_pattern_are_one_block() -> None:
    """Two groups of rows, of states and of inputs far from them, and one in between that touches almost the first's columns."""
    pattern = [{0, 1, 2}] * 10 + [{0, 1}] + [{30, 31}] * 10
    assert [(b.first, b.last) for b in row_blocks(pattern)] == [(0, 11), (11, 21)]
