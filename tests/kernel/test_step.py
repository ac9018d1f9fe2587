"""Steps with arrays of their own: the same as calling the function, by address; copies have memory of their own."""

from __future__ import annotations

import ast
from copy import deepcopy
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import wbmpc
from wbmpc.errors import InputError, KernelError
from wbmpc.kernel.ir import Floats, Integers
from wbmpc.kernel.library import Library
from wbmpc.kernel.step import Step

LIBRARY = Library("test of steps")


@LIBRARY.compiled
def square(x: float) -> float:
    return x * x


@LIBRARY.step
def filtered(mean: Floats, count: Integers, n: int, gain: float, value: float, skip: bool) -> tuple[float, bool, int]:
    """A mean that follows ``value``."""
    if skip:
        return 0.0, False, count[0]
    count[0] += 1
    total = 0.0
    for i in range(n):
        mean[i] += gain * (value - mean[i])
        total += square(mean[i])
    return total, True, count[0]


@LIBRARY.step
def angles(m: Floats) -> None:
    m[2], m[3] = np.arctan2(m[0], m[1]), np.arcsin(m[0] / 10.0)
    m[4] = np.sin(m[0]) ** 2 + np.cos(m[0]) ** 2


def memory() -> dict[str, np.ndarray]:
    return {"mean": np.zeros(3), "count": np.zeros(1, dtype=np.int64)}


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_a_step_works_on_its_arrays(backend: str) -> None:
    """Truth: a mean with gain 1/2 after 4, then 8: 2, then 5; with its square three times."""
    m = memory()
    step = Step(filtered, m, backend, n=3, gain=0.5)  # type: ignore[arg-type]
    assert step(4.0, False) == (12.0, True, 1)
    assert step(9.0, True) == (0.0, False, 1)
    m["count"][0] = 7
    assert step(8.0, False) == (75.0, True, 8)
    np.testing.assert_array_equal(m["mean"], 5.0)


def test_numbers_of_numpy_are_numbers_of_a_step() -> None:
    """Truth: the same call with Python's own, 3 × 2²."""
    step = Step(filtered, memory(), n=3, gain=0.5)
    assert step(np.float64(4.0), np.bool_(False)) == (12.0, True, 1)
    assert step(np.int64(9), np.bool_(True)) == (0.0, False, 1)


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_functions_of_angles(backend: str) -> None:
    """Truth: NumPy's."""
    m = np.array([-3.0, 2.0, 0.0, 0.0, 0.0])
    assert Step(angles, {"m": m}, backend)() is None  # type: ignore[arg-type]
    np.testing.assert_allclose(m[2:], [np.arctan2(-3.0, 2.0), np.arcsin(-0.3), 1.0], rtol=1e-15)


def test_a_copy_has_memory_of_its_own() -> None:
    class Owner:
        def __init__(self) -> None:
            self.memory = memory()
            self.step = Step(filtered, self.memory, n=3, gain=0.5)

    one = Owner()
    one.step(4.0, False)
    other = deepcopy(one)
    other.step(8.0, False)
    np.testing.assert_array_equal(one.memory["mean"], 2.0)
    np.testing.assert_array_equal(other.memory["mean"], 5.0)


def test_what_cannot_be_bound_is_named() -> None:
    whole = np.zeros(8)
    valid = {"n": 3, "gain": 0.5}
    with pytest.raises(KernelError, match="contiguous array of float64"):
        Step(filtered, {**memory(), "mean": whole[::2]}, **valid)
    with pytest.raises(KernelError, match="contiguous array of int64"):
        Step(filtered, {**memory(), "count": np.zeros(1)}, **valid)
    with pytest.raises(KernelError, match="no array 'count'"):
        Step(filtered, {"mean": np.zeros(3)}, **valid)
    with pytest.raises(KernelError, match="'mean' and 'count' overlap"):
        Step(filtered, {"mean": whole[:3], "count": whole.view(np.int64)[2:3]}, **valid)
    with pytest.raises(InputError, match=r"unknown argument 'means'.*mean"):
        Step(filtered, {"means": np.zeros(3)}, **valid)
    with pytest.raises(InputError, match="valid: compiled, interpreted"):
        Step(filtered, memory(), "numba", **valid)  # type: ignore[arg-type]
    with pytest.raises(KernelError, match="decorator 'step'"):
        Step(square, {})
    with pytest.raises(KernelError, match="needs 2 numbers, got 1"):
        Step(filtered, memory(), **valid)(1.0)


def _translated(tree: ast.Module) -> list[tuple[str, int]]:
    """Names and numbers of arguments of a module's translated functions."""
    marks = ("step", "compiled")
    return [
        (f.name, len(f.args.args))
        for f in tree.body
        if isinstance(f, ast.FunctionDef) and any(ast.unparse(d).split(".")[-1] in marks for d in f.decorator_list)
    ]


def test_functions_have_few_arguments() -> None:
    """Two arrays that change places are an error that neither types nor a compiler see; :class:`Step` binds by name anyway. What belongs
    together is a record."""
    files = [(f, f.read_text()) for f in Path(wbmpc.__file__).parent.rglob("*.py")]
    trees = [(f, ast.parse(text)) for f, text in files if "kernel.ir import" in text]
    counts = [(f"{f.stem}.{name}", count) for f, tree in trees for name, count in _translated(tree)]
    assert len(counts) > 100 and not [one for one in counts if one[1] > 12]


class Cloud(NamedTuple):
    """Points about a center."""

    count: int
    scale: float
    points: Floats
    center: Floats


@LIBRARY.compiled
def mean_of(c: Cloud, shift: float) -> float:
    """The mean of the points, and into ``center`` what is left of it."""
    points, total = c.points, 0.0
    for i in range(c.count):
        total += points[i]
    c.center[0] = c.scale * total / c.count + shift
    return total / c.count


@LIBRARY.step
def centered(c: Cloud, shift: float) -> float:
    mean = mean_of(shift=shift, c=c)
    for i in range(c.count):
        c.points[i] -= mean
    return mean


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_records_are_bound_by_their_fields(backend: str) -> None:
    """Truth: the mean of 1, 2, 6 is 3; twice that and 10 more is 16."""
    arrays = {"points": np.array([1.0, 2.0, 6.0]), "center": np.zeros(1)}
    step = Step(centered, arrays, backend, count=3, scale=2.0)  # type: ignore[arg-type]
    assert step(10.0) == 3.0 and arrays["center"][0] == 16.0
    np.testing.assert_array_equal(arrays["points"], [-2.0, -1.0, 3.0])
    cloud = Cloud(3, 1.0, np.array([3.0, 3.0, 0.0]), np.zeros(1))
    assert mean_of(cloud, 0.5) == mean_of.python(cloud, 0.5) == 2.0 and cloud.center[0] == 2.5


class Clouds(NamedTuple):
    """A cloud, and numbers beside it."""

    first: Cloud
    shifts: Floats


@LIBRARY.compiled
def both_means(c: Clouds, more: Floats) -> float:
    """Of the record within, and of one that is made of its arrays."""
    other = mean_of(Cloud(count=2, scale=c.shifts[1], points=more, center=c.first.center), c.shifts[0])
    return 10.0 * mean_of(c.first, 0.0) + other


@LIBRARY.step
def shifted_means(c: Clouds, more: Floats) -> float:
    return both_means(c, more) + c.first.scale


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_records_hold_records_and_are_made_in_calls(backend: str) -> None:
    """Truth: means of 1, 2, 6 and of 4, 8 are 3 and 6; 10 · 3 + 6 + 2 = 38; ``center`` is of the last call: 2 · 9 / 3."""
    arrays = {"points": np.array([1.0, 2.0, 6.0]), "center": np.zeros(1)}
    arrays |= {"shifts": np.array([0.5, 3.0]), "more": np.array([4.0, 8.0])}
    step = Step(shifted_means, arrays, backend, count=3, scale=2.0)  # type: ignore[arg-type]
    assert step() == 38.0 and arrays["center"][0] == 6.0
    clouds = Clouds(Cloud(3, 2.0, arrays["points"], arrays["center"]), arrays["shifts"])
    assert both_means(clouds, arrays["more"]) == both_means.python(clouds, arrays["more"]) == 36.0


def test_what_is_wrong_with_a_record_is_said() -> None:
    library = Library("test of wrong records")

    @library.step
    def twice(c: Cloud, scale: float) -> float:
        return c.scale * scale

    with pytest.raises(KernelError, match="several arguments have the name scale"):
        Step(twice, {}, count=1)
    with pytest.raises(InputError, match=r"point.*valid: count, scale, points, center, shift"):
        Step(centered, {"point": np.zeros(3)})

    @library.compiled
    def passes_numbers(n: int, scale: float) -> float:
        return mean_of(n, scale)

    library.functions.append(mean_of)
    with pytest.raises(KernelError, match="'c' needs a record of the kind Cloud"):
        library.source()
