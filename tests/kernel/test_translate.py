"""Python translated to machine code. Truth: the same function run as ordinary Python."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wbmpc.errors import KernelError
from wbmpc.kernel.library import Library
from wbmpc.kernel.translate import BOOL, INT, INT2, INTS, NONE, NUM, NUM2, NUM3, NUMS, PointerCall
from wbmpc.solver import compilation, receding  # noqa: F401  the library of the driver

LIBRARY = Library("test")
compiled = LIBRARY.compiled
SCALE, LIMIT = 3, 0.25
call1 = PointerCall(1)


@compiled(NUM, NUM, NUM, INT)
def arithmetic(a, b, n):  # type: ignore[no-untyped-def]
    x = a * b - a / (1.0 + b * b) + n
    x += SCALE * LIMIT
    x -= n % 3 + n // 2
    y = -x if x > 0.5 else x**2
    return y + (-a) ** 2 + abs(b) ** 1.5 - -n


@compiled(NUM, NUM, NUM)
def functions(a, b):  # type: ignore[no-untyped-def]
    """A docstring, and functions of NumPy."""
    c = np.sqrt(abs(a)) + np.log(1.0 + abs(b)) + np.exp(-abs(a)) + np.floor(b)
    return min(c, a, b) + max(a, b, 1.0) + float(int(abs(c)))


@compiled(BOOL, NUM, NUM, INT)
def logic(a, b, n):  # type: ignore[no-untyped-def]
    if (not (a < b <= 2.0) and (n == 2 or a != b)) or np.isinf(a):
        return n > 1
    return np.isfinite(a) and a >= b


@compiled(NUM3, NUMS, INTS, INT)
def loops(m, o, n):  # type: ignore[no-untyped-def]
    total, last, found = 0.0, 0, -1.0
    for i in range(n):
        if i == 3:
            continue
        for j in range(i, 0, -1):
            total += m[i] * m[j] + o[j]
        last = i
        if total > 50.0:
            break
    while last > 0:
        last -= 2
        m[o[0]] += 0.5
        o[1] = o[1] + 1
    for i in range(1, n):
        if m[i] > m[0]:
            found = m[i]
            break
    return total, float(last), found


@compiled(NUM2, NUM, NUM)
def pair(a, b):  # type: ignore[no-untyped-def]
    return b, a


@compiled(NUM, NUM, NUM, NUM2)
def swapped(a, b, both):  # type: ignore[no-untyped-def]
    a, b = b, a
    c, d = pair(a, b)
    e, f = both
    return c + 10.0 * d + 100.0 * e + 1000.0 * f


@compiled(NUM, NUM, NUM)
def calls(a, b):  # type: ignore[no-untyped-def]
    return swapped(a, b, (a, 2)) + arithmetic(a, b, 2)


@compiled(INT2, INT, BOOL)
def whole(n, yes):  # type: ignore[no-untyped-def]
    m = n
    if yes:
        m = min(n, 3)
    elif n > 5:
        m = max(n, 7)
    return m, 1 if yes else 0


@compiled(NONE, NUMS, INT)
def fill(m, n):  # type: ignore[no-untyped-def]
    if n < 0:
        return
    for i in range(n):
        m[i] = i


numbers = st.floats(-3.0, 3.0, allow_subnormal=False)


@settings(max_examples=60, deadline=None)
@given(numbers, numbers, st.integers(0, 9))
def test_scalars(a: float, b: float, n: int) -> None:
    assert arithmetic(a, b, n) == pytest.approx(arithmetic.python(a, b, n), rel=1e-12, abs=1e-12)
    assert functions(a, b) == pytest.approx(functions.python(a, b), rel=1e-12, abs=1e-12)
    assert logic(a, b, n) == logic.python(a, b, n)
    assert calls(a, b) == pytest.approx(_calls(a, b), rel=1e-12, abs=1e-12)
    assert whole(n, a > 0) == whole.python(n, a > 0)


def _calls(a: float, b: float) -> float:
    first, second = a, b  # swapped once by the assignment, once by pair
    return first + 10.0 * second + 100.0 * a + 1000.0 * 2 + arithmetic.python(a, b, 2)


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_values_that_are_not_finite(value: float) -> None:
    assert logic(value, 1.0, 2) == logic.python(value, 1.0, 2)
    assert logic(1.0, value, 2) == logic.python(1.0, value, 2)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 8), st.integers(0, 99))
def test_arrays_and_loops(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    m, o = 3.0 * rng.normal(size=10), rng.integers(0, 9, size=10).astype(np.int64)
    a, b = (m.copy(), o.copy()), (m.copy(), o.copy())
    np.testing.assert_allclose(loops(*a, n), loops.python(*b, n), rtol=1e-13)
    np.testing.assert_allclose(a[0], b[0])
    np.testing.assert_array_equal(a[1], b[1])


def test_no_result_and_early_return() -> None:
    m = np.full(4, -1.0)
    assert fill(m, -1) is None
    np.testing.assert_array_equal(m, -1.0)
    fill(m, 3)
    np.testing.assert_array_equal(m, [0.0, 1.0, 2.0, -1.0])


def test_wrong_arrays_are_refused() -> None:
    for bad in (np.zeros(4, np.float32), np.zeros((4, 4))[:, 0], np.zeros(4, np.int64)):
        with pytest.raises(KernelError, match="contiguous float64 or int64"):
            fill(bad, 2)


def outside(a: float) -> float:
    return a


def _unknown_function(a):  # type: ignore[no-untyped-def]
    return outside(a)


def _unknown_statement(a):  # type: ignore[no-untyped-def]
    with a:
        return a


def _unknown_name(a):  # type: ignore[no-untyped-def]
    return a + missing  # noqa: F821


def _list(a):  # type: ignore[no-untyped-def]
    b = [a]
    return b


def _other_type(a):  # type: ignore[no-untyped-def]
    n = 1
    n = a
    return n


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (_unknown_function, "not compiled"), (_unknown_statement, "statement"), (_unknown_name, "neither a local name"),
        (_list, "expression"), (_other_type, "cannot make F into I"),
    ],
)  # fmt: skip
def test_what_cannot_be_translated_is_named(function, message: str) -> None:  # type: ignore[no-untyped-def]
    library = Library("bad")
    library.compiled(NUM, NUM)(function)
    with pytest.raises(KernelError, match=message) as caught:
        library.source()
    assert function.__name__ in str(caught.value)


def test_the_driver_is_compiled_once_and_reloaded(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setenv("WBMPC_CACHE_DIR", str(tmp_path))

    def library() -> Library:
        made = Library("test", rooms=("kernel",))
        made.functions = list(LIBRARY.functions)
        return made

    first = library()
    first.build()
    (entry,) = tmp_path.glob("*.bin")
    before = entry.stat().st_mtime_ns
    second = library()
    monkeypatch.setattr(second, "source", lambda: pytest.fail("translated again"))
    second.build()
    assert entry.stat().st_mtime_ns == before
    entry.write_bytes(entry.read_bytes()[:-50])
    third = library()
    third.build()  # damaged: built again
    assert third.address("test_translate_fill.entry") > 0
    with pytest.raises(KernelError, match="no function 'nothing'"):
        third.address("nothing")


def test_every_function_of_the_driver_is_in_the_library() -> None:
    names = {f.signature.symbol for f in compilation.LIBRARY.functions}
    assert {"receding_receding_solve", "driver_solve", "riccati_backward", "rows_rows_step"} <= names
    assert len(names) == len(compilation.LIBRARY.functions)
