"""A compiled function with arrays of its own: one step of an estimator or of a controller, as a control tick calls it.

To add one: write the step as a function of translated Python (:mod:`wbmpc.kernel.translate`) under the ``step`` decorator of a
:class:`~wbmpc.kernel.library.Library`, keep its arrays in a dictionary by the names of its arguments, and bind the two.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from copy import deepcopy
from functools import partial
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from wbmpc.errors import KernelError, unknown_name
from wbmpc.kernel.ir import BOOL, INT, INTS, NONE, NUM, NUMS
from wbmpc.kernel.library import Function

Backend = Literal["compiled", "interpreted"]
_BACKEND: ContextVar[Backend] = ContextVar("backend", default="compiled")
#: Numbers, whole numbers and truth values as ``struct`` packs them into eight bytes.
_WORDS = {NUM: "d", INT: "q", BOOL: "?7x"}
Memory = Mapping[str, NDArray[Any]]


@contextmanager
def made_as(backend: Backend) -> Iterator[None]:
    """Steps that are made meanwhile run as machine code, or their source as ordinary Python ("interpreted"): with a debugger, or to
    compare the two. Those of an object are made with it, or when it is first used."""
    token = _BACKEND.set(backend)
    try:
        yield
    finally:
        _BACKEND.reset(token)


class Step:
    """``step(*numbers)`` runs a function of a library on the arrays of ``memory`` and on ``constants``, both by the names of its
    arguments (of a record: of its fields); ``numbers`` are the other arguments, in order. Returns the function's result, a tuple
    where there are several.

    Arrays are contiguous, of float64 or int64, and do not overlap; they stay where they are, so callers write into them. A call does
    not allocate, look anything up, or let go of the interpreter. ``backend``: left out: see :func:`made_as`.
    Compiles, or loads from the cache, when it is made. Raises :class:`KernelError` for arrays that cannot be used and for names
    that are no arguments.
    """

    def __init__(
        self, function: Callable[..., Any], memory: Memory, backend: Backend | None = None, **constants: int | float
    ) -> None:
        backend = backend or _BACKEND.get()
        if backend not in ("compiled", "interpreted"):
            raise unknown_name("backend", backend, ("compiled", "interpreted"))
        if not isinstance(function, Function) or not function.stepped:
            raise KernelError(f"{function}: no step of a library (decorator 'step')")
        self._function, self._memory, self._backend, self._constants = function, dict(memory), backend, constants
        self._bind()

    def _bind(self) -> None:
        f, arguments = self._function, self._function.argument_names
        if len(set(arguments)) < len(arguments):
            twice = sorted({name for name in arguments if arguments.count(name) > 1})
            raise KernelError(f"{f.signature.symbol}: several arguments have the name {', '.join(twice)}")
        for name in (*self._memory, *self._constants):
            if name not in arguments:
                raise unknown_name("argument", name, arguments)
        _check_apart(f.signature.symbol, self._memory)
        self._free = [a for a in arguments if a not in self._memory and a not in self._constants]
        self._count, self._interpreted = len(self._free), self._backend == "interpreted"
        self._given: list[Any] = [self._memory.get(a, self._constants.get(a)) for a in arguments]
        if self._backend == "compiled":
            self._fill_table()
        else:
            self._places = [arguments.index(a) for a in self._free]

    def _fill_table(self) -> None:
        """The table of arguments that the machine code reads, then room for its results; eight bytes each."""
        f = self._function
        result = f.signature.result
        kinds = result if isinstance(result, tuple) else () if result == NONE else (result,)
        first = len(self._given)
        table = np.zeros(first + len(kinds), dtype=np.int64)
        numbers = table.view(np.float64)
        runs: list[list[int]] = []  # of free arguments that follow each other
        for i, (name, kind, value) in enumerate(zip(f.argument_names, f.signature.arguments, self._given, strict=True)):
            if name in self._free:
                if kind not in _WORDS:
                    raise KernelError(f"{f.signature.symbol}: there is no array '{name}'")
                if not runs or runs[-1][-1] != i - 1:
                    runs.append([])
                runs[-1].append(i)
            elif kind in (NUMS, INTS):
                table[i] = _address(f.signature.symbol, name, value, np.float64 if kind == NUMS else np.int64)
            else:
                (numbers if kind == NUM else table)[i] = value
        view = table.data.cast("B")
        # (packed, numbers come into the table and out of it several times as fast as by its items)
        writers = [
            partial(_packed([f.signature.arguments[i] for i in run]).pack_into, view, 8 * run[0]) for run in runs
        ]
        ends = np.cumsum([len(run) for run in runs]).tolist()
        parts = [(w, slice(end - len(run), end)) for w, run, end in zip(writers, runs, ends, strict=True)]
        self._write = writers[0] if len(runs) == 1 else partial(_write, parts)
        self._read = partial(_packed(kinds).unpack_from, view, 8 * first)
        self._table, self._run, self._result = table, partial(f.by_table, table.ctypes.data), result
        self._several = isinstance(result, tuple)

    @property
    def call(self) -> Callable[[], None]:
        """The step as a function without arguments and results, for the innermost loops; :class:`KernelError` where it has some."""
        if self._free or self._function.signature.result != NONE:
            raise KernelError(f"{self._function.signature.symbol}: it has arguments that are not bound, or results")
        if self._backend != "compiled":
            return self.__call__
        call = partial(self._run)
        vars(call)["step"] = self  # whose arrays live as long as the function
        return call

    def __call__(self, *numbers: float) -> Any:
        if len(numbers) != self._count:
            raise KernelError(f"{self._function.signature.symbol}: needs {len(self._free)} numbers, got {len(numbers)}")
        if self._interpreted:
            for place, number in zip(self._places, numbers, strict=True):
                self._given[place] = number
            return self._function.interpreted(*self._function.signature.structured(self._given))
        if numbers:
            self._write(*numbers)
        self._run()
        if self._result == NONE:
            return None
        found = self._read()
        return found if self._several else found[0]

    def __deepcopy__(self, memo: dict[int, Any]) -> Step:
        """Arrays move with a copy of what owns them: addresses are taken again."""
        return Step(self._function, deepcopy(self._memory, memo), self._backend, **self._constants)


def bind(function: Callable[..., Any], arrays: Memory, **constants: int | float) -> Step:
    """A :class:`Step` on those of the ``arrays`` that the function has arguments for: several steps share one dictionary."""
    names = function.argument_names if isinstance(function, Function) else ()
    return Step(function, {name: arrays[name] for name in names if name in arrays}, None, **constants)


def zeros(record: Callable[..., Any], n: int) -> dict[str, NDArray[np.float64]]:
    """Arrays (n) by name for all fields of a record that are :class:`~wbmpc.kernel.ir.Floats`."""
    kinds = record.__annotations__.items()
    return {name: np.zeros(n) for name, kind in kinds if getattr(kind, "__forward_arg__", kind) == "Floats"}


def _write(parts: Sequence[tuple[Callable[..., None], slice]], *numbers: float) -> None:
    """Numbers to where they belong: to each function its part of them."""
    for write, part in parts:
        write(*numbers[part])


def _packed(kinds: Iterable[Any]) -> struct.Struct:
    """What packs numbers of these kinds, one after the other."""
    return struct.Struct("=" + "".join(_WORDS[kind] for kind in kinds))


def _address(symbol: str, name: str, array: Any, dtype: type) -> int:
    if not isinstance(array, np.ndarray) or array.dtype != dtype or not array.flags.c_contiguous:
        raise KernelError(f"{symbol}: '{name}' needs a contiguous array of {dtype.__name__}")
    return int(array.ctypes.data)


def _check_apart(symbol: str, memory: Memory) -> None:
    """Compiled code may keep numbers of one array in registers while it writes to another."""
    spans = sorted((int(a.ctypes.data), int(a.ctypes.data) + a.nbytes, name) for name, a in memory.items())
    for (_, end, one), (start, _, other) in pairwise(spans):
        if start < end:
            raise KernelError(f"{symbol}: the arrays '{one}' and '{other}' overlap")
