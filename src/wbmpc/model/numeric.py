"""CasADi functions of numbers, called from where time counts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, ParamSpec, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.arrays import Array
from wbmpc.checks import real_numbers
from wbmpc.errors import InputError

P = ParamSpec("P")
R = TypeVar("R")


class Reentrant(Generic[P, R]):
    """Calls what ``make()`` makes, one for each call that is under way: a handler that comes between two steps of a call would
    otherwise change its numbers, and a lock would wait for the very call that it interrupts."""

    def __init__(self, make: Callable[[], Callable[P, R]]) -> None:
        self._make = make
        self._idle: list[Callable[P, R]] = []

    def __call__(self, *arguments: P.args, **names: P.kwargs) -> R:
        try:
            one = self._idle.pop()
        except IndexError:
            one = self._make()
        found = one(*arguments, **names)
        self._idle.append(one)  # one that was interrupted by an exception is left half done, and not used again
        return found


class Numeric:
    """A CasADi function with dense arguments, called with arrays (n) or (n, m): returns arrays (n, m).

    CasADi's own call takes some 20 µs to convert what goes in and out and lets Python's interpreter go, which in a control loop
    means to wait for it. This one writes into memory that belongs to the function, and to one call at a time.
    """

    def __init__(self, function: ca.Function) -> None:
        self.function, self._name = function, function.name()
        self._sizes = [function.numel_in(i) for i in range(function.n_in())]
        self._run = Reentrant(lambda: _Buffer(function))

    def __call__(self, *values: ArrayLike) -> list[Array]:
        arrays = []
        for size, value in zip(self._sizes, values, strict=True):
            array = real_numbers(self._name, value)
            if array.size != size:
                raise InputError(f"{self._name}: {size} numbers are needed, got {array.size}")
            arrays.append(array.ravel(order="F") if array.ndim > 1 else array)
        return self._run(arrays)

    def __deepcopy__(self, _: dict[int, object]) -> Numeric:
        return Numeric(self.function)

    def __reduce__(self) -> tuple[type[Numeric], tuple[ca.Function]]:
        """Memory does not leave its process."""
        return Numeric, (self.function,)


class _Buffer:
    """The memory of one call."""

    def __init__(self, function: ca.Function) -> None:
        f = function
        buffer: Any
        buffer, self._run = f.buffer()
        self._buffer, self._arguments = buffer, [np.zeros(f.numel_in(i)) for i in range(f.n_in())]
        self._found: list[tuple[Array, tuple[tuple[int, int], NDArray[np.int64]] | None]] = []
        for i, place in enumerate(self._arguments):
            buffer.set_arg(i, place.data)
        for i in range(f.n_out()):
            form = f.sparsity_out(i)
            nonzeros: Any = np.zeros(form.nnz())
            buffer.set_res(i, memoryview(nonzeros))
            whole = nonzeros.reshape(form.shape, order="F") if form.is_dense() else nonzeros
            entries = None if form.is_dense() else (form.shape, np.array(form.get_triplet(), int))
            self._found.append((whole, entries))

    def __call__(self, arrays: list[Array]) -> list[Array]:
        for place, array in zip(self._arguments, arrays, strict=True):
            place[:] = array
        self._run()
        return [place.copy() if entries is None else _filled(place, *entries) for place, entries in self._found]


def _filled(values: Array, shape: tuple[int, int], places: NDArray[np.int64]) -> Array:
    """An array with ``values`` at ``places`` (2, n) and zeros elsewhere."""
    out = np.zeros(shape)
    out[places[0], places[1]] = values
    return out
