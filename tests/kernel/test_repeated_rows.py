"""Like rows as loops. Truth: CasADi's own evaluation of the same functions, and the length of the code."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from toys import call_lanes, compile_ir
from wbmpc.kernel.compiled import by_rows, row_numbers
from wbmpc.kernel.scalar import DECLARATIONS, identity_map
from wbmpc.kernel.simd_batch import emit_lanes, helpers

X, P, W = ca.SX.sym("x", 4), ca.SX.sym("p", 240), ca.SX.sym("w", 2)


def distances(count: int) -> list[ca.SX]:
    """Of two points that turn with the state to ``count`` planes each."""
    rows = []
    for frame in range(2):
        c, s = ca.cos(X[frame]), ca.sin(X[frame])
        for k in range(count):
            row = P[5 * (count * frame + k) :][:5]
            point = ca.vertcat(X[2] + c * row[0] - s * row[1], X[3] + s * row[0] + c * row[1])
            rows.append(ca.dot(row[2:4], point) - row[4])
    return rows


def odd() -> list[ca.SX]:
    """Rows that are like their neighbors but for a constant, an operation, the order of operands, what they read, or how far apart that is."""
    s = ca.sin(X[0])
    rows = [s * P[k] + 0.5 * ca.sin(P[k] * X[1]) for k in range(3)]
    rows += [s * P[3] + 0.5 * ca.cos(P[3] * X[1]), s * P[4] + 0.7 * ca.sin(P[4] * X[1])]
    rows += [P[5] - s * P[6], s * P[6] - P[7], P[6] - s * P[5], P[9] - s * P[10], P[15] - s * P[16]]
    rows += [X[2] * W[0], X[3] * W[1], ca.SX(0.3), ca.SX(0.4), X[2] * P[20]]
    rows += [P[21] * P[22], P[23] * P[24], P[27] * P[28], P[30] + P[31], P[32] + P[33], P[34] - P[35]]
    return rows


def function(rows: list[ca.SX]) -> ca.Function:
    value = ca.vertcat(*rows)
    jacobian = ca.Function("f", [X, P, W], [value, ca.jacobian(value, X)])
    return by_rows(jacobian, identity_map(jacobian))[0]


def text(of: ca.Function, width: int, rows: bool = True) -> str:
    return emit_lanes(of, "f", width, shared=(2,), rows=row_numbers(of) if rows else None)


@pytest.mark.parametrize("width", [4, 8])
@pytest.mark.parametrize("rows", [distances(3), distances(20), odd()], ids=["few", "many", "odd"])
def test_values_and_derivatives_are_casadis(rows: list[ca.SX], width: int) -> None:
    of, random = function(rows), np.random.default_rng(0)
    x, p, w = random.normal(size=(8, 4)), random.normal(size=(8, 240)), random.normal(size=2)
    ir = text(of, width)
    engine = compile_ir("\n".join([DECLARATIONS, helpers(ir, width), ir]))
    sizes = [of.nnz_out(i) for i in range(2)]
    got = call_lanes(engine.get_function_address("f"), [x, p, w], sizes, shared=(2,))
    for k in range(8):
        for found, want in zip(got, of(x[k], p[k], w), strict=True):
            np.testing.assert_allclose(found[k], want.nonzeros(), rtol=1e-12, atol=1e-14)


def test_more_rows_are_no_longer_code() -> None:
    lines = [len(text(function(distances(count)), 8).splitlines()) for count in (3, 20)]
    assert lines[0] == lines[1] < len(text(function(distances(20)), 8, rows=False).splitlines()) / 5


def test_rows_of_which_a_result_goes_to_several_places_stay() -> None:
    of = function(distances(3))
    places = [[[at, at + 100] for (at,) in nonzeros] for nonzeros in identity_map(of)]
    assert emit_lanes(of, "f", 8, places, (2,), row_numbers(of)) == emit_lanes(of, "f", 8, places, (2,))
