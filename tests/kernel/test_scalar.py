"""Emitted code, for one node and for eight. Truth: CasADi's interpreter at the same points, edge values included."""

from __future__ import annotations

import casadi as ca
import llvmlite.binding as llvm
import numpy as np
import pytest
import scipy.special

from toys import call_lanes, call_scalar, compile_ir
from wbmpc.errors import UnsupportedOperation
from wbmpc.kernel.codegen_target import object_code, parsed
from wbmpc.kernel.dense import FMA
from wbmpc.kernel.object_file import largest_frame
from wbmpc.kernel.scalar import DECLARATIONS, emit_function, literal, supported_operations, unsupported_operation
from wbmpc.kernel.simd_batch import emit_lanes, helpers

TINY, HUGE = np.finfo(float).tiny, 1e300
EDGES = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    -0.5,
    2.0,
    -2.5,
    3.0,
    5e-324,
    -TINY,
    1e-9,
    HUGE,
    -HUGE,
    710.0,
    np.inf,
    -np.inf,
    np.nan,
]

#: Scalar code, and vectors of two, four and eight.
WIDTHS = (0, 2, 4, 8)

UNARY = {
    ca.OP_ASSIGN: lambda x: x, ca.OP_NEG: lambda x: -x, ca.OP_SQ: lambda x: x * x, ca.OP_TWICE: lambda x: 2 * x,
    ca.OP_INV: lambda x: 1 / x, ca.OP_NOT: ca.logic_not, ca.OP_SIGN: ca.sign, ca.OP_SIN: ca.sin, ca.OP_COS: ca.cos,
    ca.OP_TAN: ca.tan, ca.OP_ASIN: ca.asin, ca.OP_ACOS: ca.acos, ca.OP_ATAN: ca.atan, ca.OP_SINH: ca.sinh,
    ca.OP_COSH: ca.cosh, ca.OP_TANH: ca.tanh, ca.OP_EXP: ca.exp, ca.OP_LOG: ca.log, ca.OP_SQRT: ca.sqrt,
    ca.OP_FABS: ca.fabs, ca.OP_FLOOR: ca.floor, ca.OP_CEIL: ca.ceil, ca.OP_ASINH: ca.asinh, ca.OP_ACOSH: ca.acosh,
    ca.OP_ATANH: ca.atanh, ca.OP_EXPM1: ca.expm1, ca.OP_LOG1P: ca.log1p, ca.OP_ERF: ca.erf,
}  # fmt: skip
BINARY = {
    ca.OP_ADD: lambda x, y: x + y, ca.OP_SUB: lambda x, y: x - y, ca.OP_MUL: lambda x, y: x * y,
    ca.OP_DIV: lambda x, y: x / y, ca.OP_LT: lambda x, y: x < y, ca.OP_LE: lambda x, y: x <= y,
    ca.OP_EQ: lambda x, y: x == y, ca.OP_NE: lambda x, y: x != y, ca.OP_AND: ca.logic_and, ca.OP_OR: ca.logic_or,
    ca.OP_ATAN2: ca.atan2, ca.OP_POW: lambda x, y: x**y, ca.OP_FMIN: ca.fmin, ca.OP_FMAX: ca.fmax,
    ca.OP_COPYSIGN: ca.copysign, ca.OP_HYPOT: ca.hypot, ca.OP_IF_ELSE_ZERO: lambda x, y: ca.if_else(x, y, 0),
    ca.OP_FMOD: ca.fmod, ca.OP_REMAINDER: ca.remainder,
}  # fmt: skip


def operations(function: ca.Function) -> set[int]:
    return {function.instruction_id(k) for k in range(function.n_instructions())}


def results(function: ca.Function, points: list[list[float]], width: int) -> np.ndarray:
    """Compiled results; ``width``: vectors of so many lanes, 0: scalar code."""
    if width == 0:
        engine = compile_ir(f"{DECLARATIONS}\n{emit_function(function, 'f')}")
        address = engine.get_function_address("f")
        return np.array([call_scalar(address, [np.array([v]) for v in point], [1])[0][0] for point in points])
    ir = emit_lanes(function, "f", width)
    engine = compile_ir("\n".join([DECLARATIONS, helpers(ir, width), ir]))
    address, found = engine.get_function_address("f"), []
    for start in range(0, len(points), 8):
        eight = np.resize(points[start : start + 8], (8, len(points[0])))  # the first ones again where there are fewer
        found.append(call_lanes(address, [eight[:, [i]] for i in range(eight.shape[1])], [1])[0].ravel())
    return np.concatenate(found)[: len(points)]


def compare(function: ca.Function, points: list[list[float]], sign_of_zero: bool = True, width: int = 0) -> None:
    for point, got in zip(points, results(function, points, width), strict=True):
        want = float(function(*point))
        if np.isnan(want):
            assert np.isnan(got), (function, point, got)
        else:
            assert got == pytest.approx(want, rel=1e-14, abs=0.0), (function, point)
            assert not sign_of_zero or np.signbit(got) == np.signbit(want), (function, point)


def test_every_supported_operation_is_tried() -> None:
    # LIFT cannot be made from Python; ERFINV has a test of its own
    assert supported_operations() == {*UNARY, *BINARY, ca.OP_CONSTPOW, ca.OP_LIFT, ca.OP_ERFINV}


def test_every_elementary_operation_of_casadi_is_supported() -> None:
    """Those that an SX function of a random input can have; what prints and what calls is left to the twin."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    assert not unsupported_operation(ca.Function("f", [x, y], [f(x) for f in UNARY.values()]))
    assert not unsupported_operation(ca.Function("f", [x, y], [f(x, y) for f in BINARY.values()]))
    assert unsupported_operation(ca.Function("f", [x, y], [x.printme(y)])) == "OP_PRINTME"


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("op", UNARY)
def test_unary(op: int, width: int) -> None:
    x = ca.SX.sym("x")
    function = ca.Function("f", [x], [UNARY[op](x)])
    assert op == ca.OP_ASSIGN or op in operations(function)
    compare(function, [[v] for v in EDGES], width=width)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("op", BINARY)
def test_binary(op: int, width: int) -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    expression = BINARY[op](x, y)
    function = ca.Function("f", [x, y], [expression])
    assert op in operations(function)
    # C leaves open which of 0 and −0 is the smaller one
    compare(function, [[a, b] for a in EDGES for b in EDGES], op not in (ca.OP_FMIN, ca.OP_FMAX), width)


@pytest.mark.parametrize("power", [-2.0, -1.5, 0.0, 0.5, 2.5, 3.0])
@pytest.mark.parametrize("width", WIDTHS)
def test_constant_power(power: float, width: int) -> None:
    x = ca.SX.sym("x")
    function = ca.Function("f", [x], [ca.constpow(x, power)])
    compare(function, [[v] for v in EDGES], width=width)


@pytest.mark.parametrize("width", WIDTHS)
def test_inverse_error_function(width: int) -> None:
    """Against SciPy: CasADi's own is good to five digits only in parts (its guess has two coefficients exchanged)."""
    x = ca.SX.sym("x")
    points = [v for v in EDGES if abs(v) != 1.0] + [0.1, -0.7, 0.7, 0.69999, 0.999, -0.9999, 1.0, -1.0]
    got = results(ca.Function("f", [x], [ca.erfinv(x)]), [[v] for v in points], width)
    np.testing.assert_allclose(got, scipy.special.erfinv(points), rtol=1e-12)


@pytest.mark.parametrize("width", (0, 8))
def test_random_expressions(width: int) -> None:
    """Graphs of forty operations, all kinds mixed, at random points; CasADi works them out in the same order."""
    rng = np.random.default_rng(7)
    for _ in range(12):
        x = ca.SX.sym("x", 3)
        nodes = [x[0], x[1], x[2], ca.SX(0.7), ca.SX(-2.0)]
        for _ in range(40):
            a, b = (nodes[int(i)] for i in rng.integers(max(0, len(nodes) - 12), len(nodes), 2))
            table = (UNARY, BINARY)[int(rng.integers(2))]
            op = list(table)[int(rng.integers(len(table)))]
            nodes.append(table[op](a) if table is UNARY else table[op](a, b))
        graph = ca.Function("f", [x], [ca.vertcat(*nodes)])
        points = np.vstack([rng.normal(size=(6, 3)), 3.0 * rng.uniform(size=(2, 3))])
        want = np.array([np.array(graph(p)).ravel() for p in points])
        np.testing.assert_allclose(many(graph, points, width), want, rtol=1e-11, atol=1e-300)


def many(function: ca.Function, points: np.ndarray, width: int) -> np.ndarray:
    """Results (8, n) of a function of one vector at eight points, as ``results``."""
    size = function.nnz_out(0)
    if width == 0:
        engine = compile_ir(f"{DECLARATIONS}\n{emit_function(function, 'f')}")
        return np.array([call_scalar(engine.get_function_address("f"), [p], [size])[0] for p in points])
    ir = emit_lanes(function, "f", width)
    engine = compile_ir("\n".join([DECLARATIONS, helpers(ir, width), ir]))
    return call_lanes(engine.get_function_address("f"), [points], [size])[0]


@pytest.mark.parametrize("width", WIDTHS[1:])
def test_constants_that_are_operands_and_results(width: int) -> None:
    """Constants of two results, some of them operands too, in the order of their places and out of it."""
    x = ca.SX.sym("x", 2)
    outputs = [ca.vertcat(0.3, 0.7 * x[0], -2.5, 0.3 * x[1], 0.7, ca.SX(0.0)), ca.vertcat(x[0] - 2.5, 0.3)]
    function, places = ca.Function("f", [x], outputs), [[[5], [0], [4], [3], [1], [2]], [[0], [1]]]
    points = np.random.default_rng(2).normal(size=(8, 2))
    ir = emit_lanes(function, "f", width, places)
    engine = compile_ir("\n".join([DECLARATIONS, helpers(ir, width), ir]))
    first, second = call_lanes(engine.get_function_address("f"), [points], [6, 2])
    for k, point in enumerate(points):
        want = [np.array(out).ravel() for out in function(point)]
        np.testing.assert_allclose(first[k][[at for (at,) in places[0]]], want[0], rtol=1e-15)
        np.testing.assert_allclose(second[k], want[1], rtol=1e-15)


def of_a_process(triple: str, cpu: str, features: str) -> llvm.TargetMachine:
    """LLVM's machine for code that is loaded into this process, where addresses of constants are no part of an operation."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    return llvm.Target.from_triple(triple).create_target_machine(cpu=cpu, features=features, opt=1, jit=True)


def test_constants_are_not_spilled_to_the_stack() -> None:
    """Of a product with a matrix of 600 numbers, and its Jacobian. Truth: as spilled vectors of eight doubles they take 38 kB."""
    x = ca.SX.sym("x", 6)
    y = ca.DM(np.random.default_rng(3).normal(size=(100, 6))) @ x
    ir = emit_lanes(ca.Function("f", [x], [y, ca.jacobian(y, x)]), "f", 8)
    machine = of_a_process("x86_64-unknown-linux-gnu", "skylake-avx512", "-prefer-256-bit")
    text = "\n".join([DECLARATIONS, helpers(ir, 8), FMA, ir])
    assert largest_frame(object_code(machine, parsed(text))) < 4096


def test_unsupported_operation_is_named() -> None:
    x = ca.SX.sym("x")
    table = ca.interpolant("table", "bspline", [np.linspace(0.0, 1.0, 8)], np.linspace(0.0, 1.0, 8) ** 2)
    for expression, name in ((x.printme(x), "OP_PRINTME"), (table(x), r"OP_CALL \(a function or lookup table")):
        with pytest.raises(UnsupportedOperation, match=f"function 'bad': the SX operation {name}"):
            emit_function(ca.Function("f", [x], [expression]), "bad")


@pytest.mark.parametrize("width", WIDTHS[1:])
@pytest.mark.parametrize("scale", [1e-8, 1.0, 30.0, 1e5, 1e9])
def test_sine_and_cosine_of_eight_angles(scale: float, width: int) -> None:
    """Against the C library, to two units in the last place; near multiples of π/2, within reach and beyond."""
    rng = np.random.default_rng(1)
    angles = np.concatenate([rng.uniform(-scale, scale, 400), np.round(rng.uniform(-scale, scale, 400)) * np.pi / 2])
    x = ca.SX.sym("x")
    for function, truth in ((ca.sin(x), np.sin), (ca.cos(x), np.cos)):
        got = results(ca.Function("f", [x], [function]), [[a] for a in angles], width)
        assert np.max(np.abs(got - truth(angles)) / np.spacing(np.abs(truth(angles)))) <= 2.0


def test_one_angle_out_of_reach_leaves_the_others_right() -> None:
    x = ca.SX.sym("x")
    points = [[v] for v in (0.3, 1e9, -2.0, np.nan, 7.0, -0.0, 1e5, 1e300)]
    compare(ca.Function("f", [x], [ca.sin(x) + ca.cos(x)]), points, width=8)


def test_literals_are_exact() -> None:
    for value in (0.1, -0.0, np.pi, 5e-324, HUGE):
        assert np.array([int(literal(value), 16)], np.uint64).view(float)[0].hex() == value.hex()


def test_an_output_goes_to_several_places() -> None:
    x = ca.SX.sym("x", 2)
    function = ca.Function("f", [x], [ca.vertcat(x[0] * x[1], x[0] + x[1])])
    engine = compile_ir(f"{DECLARATIONS}\n{emit_function(function, 'f', [[[4, 0], [2]]])}")
    out = call_scalar(engine.get_function_address("f"), [np.array([3.0, 5.0])], [6])[0]
    np.testing.assert_array_equal(out, [15, np.nan, 8, np.nan, 15, np.nan])
