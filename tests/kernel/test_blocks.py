"""Transpositions and the chain rule of eight nodes. Truth: NumPy, node by node."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from toys import aligned_copy, call_pointers, compile_ir
from wbmpc.kernel import blocks, dense
from wbmpc.solver.workspace import aligned


def compiled(text: str, width: int = 8) -> object:
    return compile_ir("\n".join([blocks.declarations(width), dense.FMA, text]))


def call(engine: object, name: str, *arguments: object) -> None:
    """Pointers and integers."""
    given = [a.ctypes.data if isinstance(a, np.ndarray) else a for a in arguments]
    address = engine.get_function_address(name)  # type: ignore[attr-defined]
    ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * len(given))(address)(*given)


@pytest.mark.parametrize("count", range(1, 9))
def test_pack(count: int) -> None:
    engine, r = compiled(blocks.pack()), np.random.default_rng(count)
    for width in (1, 5, 8, 13, 16):
        nodes, groups = r.normal(size=(count, width)), dense.pad(width) // 8
        memory = np.concatenate([nodes.ravel(), np.zeros(8)])
        out = aligned(groups * 64).reshape(-1, 8)
        call(engine, "pack", memory, 8 * width, groups, out, count - 1)
        np.testing.assert_array_equal(out[:width], nodes[np.minimum(np.arange(8), count - 1)].T)


@pytest.mark.parametrize("count", range(1, 9))
@pytest.mark.parametrize("size", [1, 7, 8, 9, 20])
def test_unpack_values(size: int, count: int) -> None:
    """Also to places that are not multiples of eight; nothing beside a node's numbers changes."""
    engine, r, stride = compiled(blocks.unpack_values("unpack", size)), np.random.default_rng(count), size + 5
    nodes, before = r.normal(size=(count, size)), r.normal(size=3 + count * stride)
    found = aligned_copy(before)
    call(engine, "unpack", aligned_copy(nodes[np.minimum(np.arange(8), count - 1)].T), found[3:], 8 * stride, count - 1)
    for k in range(count):
        before[3 + k * stride : 3 + k * stride + size] = nodes[k]
    np.testing.assert_array_equal(found, before)


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("count", range(1, 9))
def test_unpack(count: int, whole: bool) -> None:
    """Groups arrive, everything else stays as it is."""
    groups, size, r = [0, 2, 3, 7], 72, np.random.default_rng(count)
    engine = compiled(blocks.unpack("back", groups, whole))
    lanes = r.normal(size=(9 if whole else len(groups), 8, 8))  # group, entry, node
    lanes[..., count:] = lanes[..., count - 1 : count]  # what lanes beyond the last node hold
    out = aligned(10 * size).reshape(10, size)
    out[:] = -1.0
    want = out.copy()
    for node in range(count):
        for place, g in enumerate(groups):
            want[node, 8 * g : 8 * g + 8] = lanes[g if whole else place, :, node]
    call(engine, "back", aligned_copy(lanes), out, 8 * size, count - 1)
    np.testing.assert_array_equal(out, want)


def test_unpack_of_nothing() -> None:
    out = aligned(8)
    call(compiled(blocks.unpack("back", [])), "back", aligned(64), out, 64, 7)
    assert not out.any()


@pytest.mark.parametrize("width", [2, 4, 8])
@pytest.mark.parametrize("start", [None, 0.0, 0.5])
@settings(max_examples=6, deadline=None)
@given(st.integers(1, 9), st.integers(1, 9), st.sampled_from([0.05, 0.6]), st.integers(0, 99))
def test_chain(width: int, start: float | None, nx: int, nu: int, share: float, seed: int) -> None:
    """Few entries in a row, and many; what cannot differ from zero stays as it is."""
    r = np.random.default_rng(seed)
    nz, lz = nx + 1 + nu, dense.pad(nx + 1 + nu)
    own = r.uniform(size=(nx, nz)) < share
    own[:, nx] = False
    step = blocks.sensitivity_pattern(own, 2, ())
    j, s, a = (np.zeros((8, nx, lz)) for _ in range(3))
    j[:, :, :nz], s[:, :, :nz] = r.normal(size=(8, nx, nz)) * own, r.normal(size=(8, nx, nz)) * own
    a[:, :, :nz] = r.normal(size=(8, nx, nz)) * step
    c, w = r.normal(size=8), r.normal(size=8)
    engine = compiled(blocks.chain("chain", own, step, 2, lz, width, start), width)
    lanes = lambda m: aligned_copy(np.ascontiguousarray(m.transpose(1, 2, 0)))
    t, total = lanes(np.zeros_like(j)), lanes(a)
    address = engine.get_function_address("chain")  # type: ignore[attr-defined]
    call_pointers(address, lanes(j), lanes(s), t, total, aligned_copy(np.array([c, w])))
    want, by = j + c[:, None, None] * (j[:, :, :nx] @ s), w[:, None, None]
    base = a if start is None else np.eye(nx, lz) + by * start * s
    np.testing.assert_allclose(total.transpose(2, 0, 1), base + by * want, rtol=1e-12, atol=1e-13)
    if start != 0.0:
        np.testing.assert_allclose(t.transpose(2, 0, 1), want, rtol=1e-12, atol=1e-13)


def test_groups() -> None:
    offsets = [[3, 17], [8], [40]]
    groups = blocks.groups_of(o for places in offsets for o in places)
    assert groups == [0, 1, 2, 5]
    assert blocks.compact(offsets, groups) == [[3, 17], [8], [24]]


@pytest.mark.parametrize("stages", [2, 4])
def test_sensitivity_pattern(stages: int) -> None:
    """Against powers of a random matrix with that pattern: every entry of the series' sum that is not zero is foreseen."""
    r = np.random.default_rng(stages)
    for _ in range(20):
        given = r.uniform(size=(7, 10)) < 0.15
        a, total = np.where(given, r.uniform(1.0, 2.0, given.shape), 0.0), np.hstack([np.eye(7), np.zeros((7, 3))])
        term = a
        for _ in range(stages):
            total, term = total + term, a[:, :7] @ term
        found = blocks.sensitivity_pattern(given, stages, (2,))
        mixed = total != 0.0
        mixed[2:6] = mixed[2:6].any(axis=0)
        np.testing.assert_array_equal(found, mixed)
