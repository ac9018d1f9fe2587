"""CasADi functions of numbers, called from where time counts."""

from __future__ import annotations

import threading
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.checks import real_numbers
from wbmpc.errors import InputError

Array = NDArray[np.float64]


class Numeric:
    """A CasADi function with dense arguments, called with arrays (n) or (n, m): returns arrays (n, m).

    CasADi's own call takes some 20 µs to convert what goes in and out and lets Python's interpreter go, which in a control loop
    means to wait for it. This one writes into memory that belongs to the function, and to the thread that calls it.
    """

    def __init__(self, function: ca.Function) -> None:
        self.function, self._name = function, function.name()
        self._own = threading.local()

    def __call__(self, *values: ArrayLike) -> list[Array]:
        own = self._own
        if not hasattr(own, "run"):
            self._open()
        for place, value in zip(own.arguments, values, strict=True):
            array = real_numbers(self._name, value)
            if array.size != place.size:
                raise InputError(f"{self._name}: {place.size} numbers are needed, got {array.size}")
            place[:] = array.ravel(order="F") if array.ndim > 1 else array
        own.run()
        return [place.copy() if entries is None else _filled(place, *entries) for place, entries in own.found]

    def __deepcopy__(self, _: dict[int, object]) -> Numeric:
        return Numeric(self.function)

    def __reduce__(self) -> tuple[type[Numeric], tuple[ca.Function]]:
        """Memory does not leave its process."""
        return Numeric, (self.function,)

    def _open(self) -> None:
        f, own = self.function, self._own
        own.buffer, own.run = f.buffer()
        own.arguments = [np.zeros(f.numel_in(i)) for i in range(f.n_in())]
        own.found = []
        for i, place in enumerate(own.arguments):
            own.buffer.set_arg(i, memoryview(place))
        for i in range(f.n_out()):
            form = f.sparsity_out(i)
            nonzeros: Any = np.zeros(form.nnz())
            own.buffer.set_res(i, memoryview(nonzeros))
            whole = nonzeros.reshape(form.shape, order="F") if form.is_dense() else nonzeros
            entries = None if form.is_dense() else (form.shape, np.array(form.get_triplet(), int))
            own.found.append((whole, entries))


def _filled(values: Array, shape: tuple[int, int], places: NDArray[np.int64]) -> Array:
    """An array with ``values`` at ``places`` (2, n) and zeros elsewhere."""
    out = np.zeros(shape)
    out[places[0], places[1]] = values
    return out
