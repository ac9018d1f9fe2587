"""Kernels of rows of one variable. Truth: NumPy, row by row."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from toys import aligned, aligned_copy, call_pointers, compile_ir
from wbmpc.kernel import dense
from wbmpc.kernel.box_rows import emit_add_boxes, emit_box_values

NX, NU = 21, 11


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(0, NX + NU - 1), max_size=30), st.booleans(), st.integers(0, 99))
def test_any_variables(chosen: list[int], ordered: bool, seed: int) -> None:
    """Neighbors and distant ones, states and inputs in one vector, a variable several times, no row at all."""
    variables = [v if v < NX else v + 1 for v in (sorted(chosen) if ordered else chosen)]
    r, count, nz, lz = np.random.default_rng(seed), len(variables), NX + 1 + NU, dense.pad(NX + 1 + NU)
    engine = compile_ir(
        "\n".join(
            [
                dense.FMA,
                emit_box_values("values", NX, variables, True),
                emit_box_values("changes", NX, variables, False),
                emit_add_boxes("add", NX, variables, lz),
            ]
        )
    )
    z = np.concatenate([r.normal(size=NX), [1.0], r.normal(size=NU)])
    x, u = np.append(z[:NX], np.full(8, np.nan)), np.append(z[NX + 1 :], np.full(8, np.nan))
    sign, offset, sigma, e = (aligned_copy(np.append(r.normal(size=count), np.zeros(8))) for _ in range(4))
    for name, constant in (("values", offset[:count]), ("changes", 0.0)):
        out = aligned(count + 8)
        out[:] = 7.0
        call_pointers(engine.get_function_address(name), x, u, sign, offset, out)
        np.testing.assert_allclose(out[:count], sign[:count] * z[variables] + constant, rtol=1e-13, atol=1e-13)
        np.testing.assert_array_equal(out[count:], 7.0)
    hessian, w = r.normal(size=(nz, lz)), np.array([0.3])
    found, want = aligned_copy(hessian), hessian.copy()
    for j, v in enumerate(variables):
        want[v, v] += 0.3 * sigma[j] * sign[j] ** 2
        want[(NX, v) if v < NX else (v, NX)] += 0.3 * sigma[j] * sign[j] * e[j]
    call_pointers(engine.get_function_address("add"), sign, sigma, e, w, found)
    np.testing.assert_allclose(found, want, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("variables", "loads"), [([4, 4, 5, 5, 6, 6, 7, 7], 1), ([0, 7], 1), ([0, 8], 2), ([20, 22], 2)]
)
def test_neighbors_are_loaded_at_once(variables: list[int], loads: int) -> None:
    """Bounds of both sides of four neighbors are one vector; distant variables, and a state and an input, are two."""
    lines = emit_box_values("values", NX, variables, False).splitlines()
    assert sum("load <8 x double>" in line and "align 8" in line for line in lines) == loads
