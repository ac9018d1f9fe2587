"""Python translated to machine code. Truth: the same function run as ordinary Python."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wbmpc.errors import KernelError
from wbmpc.kernel.ir import LANES, Floats, Integers, Mask, PointerCall, Vector
from wbmpc.kernel.library import Library
from wbmpc.solver import compilation, receding  # noqa: F401  the library of the driver

LIBRARY = Library("test")
compiled = LIBRARY.compiled
SCALE, LIMIT = 3, 0.25


class Entry(IntEnum):
    FIRST = 0
    THIRD = 2


@dataclass(frozen=True)
class Constants:
    factor: float = 0.5
    repeats: int = 3


CONSTANTS = Constants()


call1 = PointerCall(1)


@compiled
def arithmetic(a: float, b: float, n: int) -> float:
    x = a * b - a / (1.0 + b * b) + n
    x += SCALE * LIMIT
    x -= n % 3 + n // 2
    y = -x if x > 0.5 else x**2
    return y + (-a) ** 2 + abs(b) ** 1.5 - -n


@compiled
def functions(a: float, b: float) -> float:
    """A docstring, and functions of NumPy."""
    c = np.sqrt(abs(a)) + np.log(1.0 + abs(b)) + np.exp(-abs(a)) + np.floor(b)
    return min(c, a, b) + max(a, b, 1.0) + float(int(abs(c)))


@compiled
def logic(a: float, b: float, n: int) -> bool:
    if (not (a < b <= 2.0) and (n == 2 or a != b)) or np.isinf(a):
        return n > 1
    return np.isfinite(a) and a >= b


@compiled
def loops(m: Floats, o: Integers, n: int) -> tuple[float, float, float]:
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


@compiled
def pair(a: float, b: float) -> tuple[float, float]:
    return b, a


@compiled
def swapped(a: float, b: float, both: tuple[float, float]) -> float:
    a, b = b, a
    c, d = pair(a, b)
    e, f = both
    return c + 10.0 * d + 100.0 * e + 1000.0 * f


@compiled
def calls(a: float, b: float) -> float:
    return swapped(a, b, (a, 2)) + arithmetic(a, b, 2)


@compiled
def whole(n: int, yes: bool) -> tuple[int, int]:
    m = n
    if yes:
        m = min(n, 3)
    elif n > 5:
        m = max(n, 7)
    return m, 1 if yes else 0


@compiled
def fill(m: Floats, n: int) -> None:
    if n < 0:
        return
    for i in range(n):
        m[i] = i


@compiled
def both(a: Vector, b: Vector) -> tuple[Vector, Mask]:
    return a * b - 1.0, (a > b) & (b <= 0.5)


@compiled
def vectors(m: Floats, n: int) -> tuple[float, float, float]:
    biggest, total, agreed = 0.0, 0.0, 0
    for i in range(0, n, LANES):
        a, b = m[i : i + LANES], m[n + i : n + i + LANES]
        c, which = both(a, b)
        c = np.where(which, c, -a / (2.0 + abs(b)))
        biggest = max(biggest, np.max(np.maximum(c, np.minimum(a, 0.1))))
        total += np.sum(1.0 - c)
        if np.all(a != b):
            agreed += 1
        m[i : i + LANES] = c
        m[n + i : n + i + LANES] += 2.0 * b
    return biggest, total, float(agreed)


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


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 3), st.integers(0, 99))
def test_eight_numbers_at_a_time(blocks: int, seed: int) -> None:
    n = blocks * LANES
    m = np.random.default_rng(seed).normal(size=2 * n + 3)
    m[n + 1 : n + 2] = m[1:2]
    a, b = m.copy(), m.copy()
    np.testing.assert_allclose(vectors(a, n), vectors.python(b, n), rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(a, b, rtol=1e-13)


@compiled
def logarithms(m: Floats, n: int) -> None:
    for i in range(0, n, LANES):
        m[i : i + LANES] = np.log(m[i : i + LANES])


def test_logarithms_of_eight_numbers() -> None:
    """Against the C library, to one unit in the last place, from the smallest number to the largest, near 1 and beyond all."""
    rng = np.random.default_rng(0)
    numbers = np.concatenate([10.0 ** rng.uniform(-323.0, 308.0, 4000), 1.0 + 1e-3 * rng.normal(size=4000)])
    edges = np.array([0.0, -0.0, -1.0, np.inf, -np.inf, np.nan, 5e-324, 1.0])
    with np.errstate(divide="ignore", invalid="ignore"):
        want, at_edges = np.log(numbers), np.log(edges)
    logarithms(numbers, numbers.size)
    assert np.max(np.abs(numbers - want) / np.spacing(np.abs(want))) <= 1.0
    logarithms(edges, edges.size)
    np.testing.assert_allclose(edges, at_edges, rtol=1e-15)


def _slice(m: Floats) -> Vector:
    return m[0:3]


def _vector_of_integers(o: Integers) -> Vector:
    return o[0 : 0 + LANES]  # type: ignore[index,return-value]


@pytest.mark.parametrize(("function", "message"), [(_slice, "slice"), (_vector_of_integers, "only numbers")])
def test_other_slices_are_rejected(function: Callable[..., Vector], message: str) -> None:
    library = Library("bad")
    library.compiled(function)
    with pytest.raises(KernelError, match=message):
        library.source()


@compiled
def fields(m: Floats) -> float:
    m[Entry.FIRST] = 2.0 * m[Entry.THIRD]
    return m[1 + Entry.FIRST]


def test_named_fields_are_their_indices() -> None:
    """Truth: the members' values, and the same function as ordinary Python."""
    compiled_m, python_m = np.arange(1.0, 5.0), np.arange(1.0, 5.0)
    assert fields(compiled_m) == fields.python(python_m) == 2.0
    np.testing.assert_array_equal(compiled_m, [6.0, 2.0, 3.0, 4.0])
    np.testing.assert_array_equal(compiled_m, python_m)


@compiled
def scaled(a: float) -> float:
    for _ in range(CONSTANTS.repeats):
        a *= CONSTANTS.factor
    return a


def test_fields_of_frozen_settings_are_constants() -> None:
    """Truth: 0.5³."""
    assert scaled(4.0) == scaled.python(4.0) == 0.5


def _bad_annotation(a: complex) -> float:
    return 0.0


def test_types_that_cannot_be_translated_are_rejected() -> None:
    with pytest.raises(
        KernelError, match=r"_bad_annotation: annotation 'complex' cannot be translated; valid: float, int"
    ):
        Library("bad").compiled(_bad_annotation)


@compiled
def difference(a: float, b: float, c: float) -> float:
    return a - 2.0 * b + 3.0 * c


@compiled
def mixed(a: float, b: float) -> float:
    return difference(b, c=a, b=7.0)


def test_arguments_by_name_go_where_they_belong() -> None:
    """Truth: Python's own rules, for both the call from outside and the translated one."""
    assert difference(1.0, c=2.0, b=5.0) == difference.python(1.0, c=2.0, b=5.0) == -3.0
    assert mixed(2.0, 1.0) == mixed.interpreted(2.0, 1.0) == -7.0


def _unknown_name(a: float) -> float:
    return difference(a, b=a, d=a)  # type: ignore[call-arg]


def _twice(a: float) -> float:
    return difference(a, a, a, a=a)  # type: ignore[misc]


def _numpy_by_name(a: float) -> float:
    return np.sqrt(x=a)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (_unknown_name, "each argument once; valid: a, b, c"),
        (_twice, "each argument once"),
        (_numpy_by_name, "by name"),
    ],
)
def test_names_that_are_no_arguments_are_rejected(function: Callable[..., float], message: str) -> None:
    own = Library("bad", uses=(LIBRARY,))
    own.compiled(function)
    with pytest.raises(KernelError, match=message):
        own.source()
    with pytest.raises(KernelError, match="needed: n"):
        fill(np.zeros(4), m=2)


def test_no_result_and_early_return() -> None:
    m = np.full(4, -1.0)
    assert fill(m, -1) is None
    np.testing.assert_array_equal(m, -1.0)
    fill(m, 3)
    np.testing.assert_array_equal(m, [0.0, 1.0, 2.0, -1.0])


def test_wrong_arrays_are_rejected() -> None:
    for bad in (np.zeros(4, np.float32), np.zeros((4, 4))[:, 0], np.zeros(4, np.int64)):
        with pytest.raises(KernelError, match="contiguous float64 or int64"):
            fill(bad, 2)


def outside(a: float) -> float:
    return a


def _unknown_function(a: float) -> float:
    return outside(a)


def _unknown_statement(a: float) -> float:
    with a:  # type: ignore[attr-defined]
        return a


def _unknown_name(a: float) -> float:
    return a + missing  # type: ignore[name-defined]  # noqa: F821


def _list(a: float) -> float:
    b = [a]
    return b  # type: ignore[return-value]


def _other_type(a: float) -> float:
    n = 1
    n = a  # type: ignore[assignment]
    return n


def _no_field(a: float) -> float:
    return a + CONSTANTS.offset  # type: ignore[attr-defined]


def _no_member(a: float) -> float:
    return a + Entry.SECOND  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (_unknown_function, "not compiled"), (_unknown_statement, "statement"), (_unknown_name, "neither a local name"),
        (_list, "expression"), (_other_type, "cannot make F into I"), (_no_member, "Entry has no member"),
        (_no_field, "Constants has no field"),
    ],
)  # fmt: skip
def test_what_cannot_be_translated_is_named(function: Callable[..., float], message: str) -> None:
    library = Library("bad")
    library.compiled(function)
    with pytest.raises(KernelError, match=message) as caught:
        library.source()
    assert function.__name__ in str(caught.value)


def test_the_driver_is_compiled_once_and_reloaded(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setenv("WBMPC_CACHE_DIR", str(tmp_path))

    def library() -> Library:
        made = Library("test", packages=("kernel",))
        made.functions = list(LIBRARY.functions)
        return made

    first = library()
    first.build()
    entries = sorted(tmp_path.glob("*.bin"))  # machine code and bitcode
    previous = [entry.stat().st_mtime_ns for entry in entries]
    second = library()
    monkeypatch.setattr(second, "source", lambda: pytest.fail("translated again"))
    second.build()
    assert [entry.stat().st_mtime_ns for entry in entries] == previous
    for entry in entries:
        entry.write_bytes(entry.read_bytes()[:-50])
    third = library()
    third.build()  # damaged: built again
    assert third.address("test_translate_fill.entry") > 0
    with pytest.raises(KernelError, match="no function 'nothing'"):
        third.address("nothing")


def test_a_library_of_another_package_is_built_again_when_its_source_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A base type of another package may have compiled steps. Truth: the number in its file; both versions share cache, name and symbol."""
    monkeypatch.setenv("WBMPC_CACHE_DIR", str(tmp_path / "cache"))
    for number in (1.0, 2.0):
        file = tmp_path / f"version-{number:g}" / "foreign_steps.py"
        file.parent.mkdir()
        file.write_text(
            "from wbmpc.kernel.library import Library\n\nLIBRARY = Library('foreign', packages=('kernel',))\n\n\n"
            f"@LIBRARY.compiled\ndef shifted(x: float) -> float:\n    return x + {number}\n"
        )
        spec = spec_from_file_location("foreign_steps", file)
        assert spec is not None and spec.loader is not None
        module = module_from_spec(spec)
        spec.loader.exec_module(module)
        assert module.shifted(0.5) == 0.5 + number


def test_the_driver_is_whole_whichever_function_comes_first() -> None:
    """In a fresh process that has imported one module of it only."""
    program = (
        "from wbmpc.solver.inequality_algebra import merits\n"
        "from wbmpc.solver.compilation import LIBRARY\n"
        "assert LIBRARY.address('receding_receding_solve.entry') > 0"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)


def test_every_function_of_the_driver_is_in_the_library() -> None:
    names = {f.signature.symbol for f in compilation.LIBRARY.functions}
    assert {"receding_receding_solve", "driver_solve", "riccati_backward", "inequalities_rows_step"} <= names
    assert len(names) == len(compilation.LIBRARY.functions)
