"""Steps with arrays of their own: the same as calling the function, by address; copies have memory of their own."""

from __future__ import annotations

import ast
from copy import deepcopy
from pathlib import Path

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
    with pytest.raises(ValueError, match="zip"):
        Step(filtered, memory(), **valid)(1.0)


def _translated(tree: ast.Module) -> dict[str, int]:
    """The numbers of arguments of a module's translated functions."""
    marks = ("step", "compiled")
    return {
        f.name: len(f.args.args)
        for f in tree.body
        if isinstance(f, ast.FunctionDef) and any(ast.unparse(d).split(".")[-1] in marks for d in f.decorator_list)
    }


def test_calls_with_many_arguments_name_them() -> None:
    """Two arrays that change places are an error that neither types nor a compiler see; :class:`Step` binds by name anyway."""
    files = [(f, f.read_text()) for f in Path(wbmpc.__file__).parent.rglob("*.py")]
    trees = [(f, ast.parse(text)) for f, text in files if "kernel.ir import" in text]
    many = {name for _, tree in trees for name, count in _translated(tree).items() if count > 12}
    bad = [
        f"{f.name}:{call.lineno}"
        for f, tree in trees
        for call in ast.walk(tree)
        if isinstance(call, ast.Call) and ast.unparse(call.func) in many and len(call.args) > 12
    ]
    assert len(many) > 20
    assert not bad
