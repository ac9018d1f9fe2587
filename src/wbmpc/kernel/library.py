"""A library of translated functions: compiled as one module, cached, called without the interpreter lock."""

from __future__ import annotations

import builtins
import ctypes
import hashlib
import threading
from collections.abc import Callable
from functools import update_wrapper
from importlib import import_module
from pathlib import Path
from types import FunctionType
from typing import Any, Generic, ParamSpec, TypeVar, cast

import numpy as np

from wbmpc.errors import KernelError, SolverBusy
from wbmpc.kernel import cache
from wbmpc.kernel.ir import BOOL, DECLARATIONS, INTS, MASK, NONE, NUM, NUMS, VEC, Signature, llvm_type
from wbmpc.kernel.translate import Translator
from wbmpc.kernel.vector_log import emit_log

P = ParamSpec("P")
R = TypeVar("R")
_CTYPES = {NUM: ctypes.c_double, NUMS: ctypes.c_void_p, INTS: ctypes.c_void_p}


class Function(Generic[P, R]):
    """A translated function: calling it runs machine code; ``python`` is the same as ordinary Python.

    ``short``: it takes microseconds, so that it keeps the interpreter: who lets others have it may wait long to get it back.
    ``stepped``: it can be called with a table of arguments, by :class:`wbmpc.kernel.step.Step`.
    """

    def __init__(self, library: Library, python: Callable[P, R]) -> None:
        self.library, self.python = library, python
        self.signature = Signature.of(python)
        self._pointer: Any = None
        self._by_table: Any = None
        self._interpreted: Callable[P, R] | None = None
        self.short = self.stepped = False
        update_wrapper(self, python)

    @property
    def pointer(self) -> Any:
        """The function as ctypes calls it: the arguments, then where the results go (8 bytes each)."""
        if self._pointer is None:
            kinds = [
                ctypes.c_int64 if isinstance(a, tuple) else _CTYPES.get(a, ctypes.c_int64)
                for a in self.signature.arguments
            ]
            address = self.library.address(f"{self.signature.symbol}.entry")
            form = ctypes.PYFUNCTYPE if self.short else ctypes.CFUNCTYPE
            self._pointer = form(None, *kinds, ctypes.c_void_p)(address)
        return self._pointer

    @property
    def by_table(self) -> Any:
        """The function as ctypes calls it with the address of a table: arguments, then results, 8 bytes each. It keeps the interpreter."""
        if self._by_table is None:
            address = self.library.address(f"{self.signature.symbol}.table")
            self._by_table = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)(address)
        return self._by_table

    @property
    def argument_names(self) -> list[str]:
        """The names of the arguments of machine code, in order."""
        return list(self.signature.names)

    @property
    def interpreted(self) -> Callable[P, R]:
        """As ``python``, with all functions that it calls as ordinary Python too."""
        if self._interpreted is None:
            python: Any = self.python
            names = {
                k: v.interpreted if isinstance(v, Function) else v
                for k, v in python.__globals__.items()
                if k in python.__code__.co_names
            }
            made: Any = FunctionType(python.__code__, {"__builtins__": builtins, **names}, python.__name__)
            self._interpreted = made
        return cast(Callable[P, R], self._interpreted)

    def __call__(self, *arguments: P.args, **names: P.kwargs) -> R:
        """Run the machine code. Arrays must be contiguous, of float64 or int64. With vectors: runs as Python. Raises
        :class:`KernelError` where an argument is missing, unknown, or an array that cannot be used."""
        if not _callable(self.signature):
            return self.python(*arguments, **names)
        converted, result = [], self.signature.result
        values: tuple[Any, ...] = (*arguments, *self._in_order(len(arguments), names)) if names else arguments
        for value, kind in zip(self.signature.flat(values), self.signature.arguments, strict=True):
            if kind in (NUMS, INTS):
                if value.dtype != (np.float64 if kind == NUMS else np.int64) or not value.flags.c_contiguous:
                    raise KernelError(f"{self.signature.symbol}: contiguous float64 or int64 arrays are needed")
                value = value.ctypes.data
            converted.append(value)
        kinds = result if isinstance(result, tuple) else () if result == NONE else (result,)
        out = ((ctypes.c_double if kinds and kinds[0] == NUM else ctypes.c_int64) * max(len(kinds), 1))()
        self.pointer(*converted, ctypes.addressof(out))
        found = tuple(bool(v) if k == BOOL else v for v, k in zip(out, kinds, strict=False))
        returned: Any = found if isinstance(result, tuple) else found[0] if found else None
        return cast(R, returned)

    def _in_order(self, first: int, names: dict[str, Any]) -> list[Any]:
        """Arguments by name in the order of the function's own, from the ``first`` on."""
        needed = [p.name for p in self.signature.parameters[first:]]
        if set(needed) != set(names):
            raise KernelError(
                f"{self.signature.symbol}: got the arguments {', '.join(names)}; needed: {', '.join(needed)}"
            )
        return [names[name] for name in needed]


def _callable(s: Signature) -> bool:
    """Whether a function can be called from outside: vectors pass between translated functions only."""
    kinds = [*s.arguments, s.result]
    return not any(k in (VEC, MASK) for kind in kinds for k in (kind if isinstance(kind, tuple) else (kind,)))


def _entry(s: Signature) -> str:
    """A wrapper with plain C arguments: truth values as integers, results through a pointer."""
    parameters = [f"{'i64' if k == BOOL else llvm_type(k)} %a{i}" for i, k in enumerate(s.arguments)]
    lines = [f"define void @{s.symbol}.entry({', '.join([*parameters, 'ptr %out'])}) nounwind {{"]
    passed = []
    for i, k in enumerate(s.arguments):
        if k == BOOL:
            lines.append(f"%b{i} = icmp ne i64 %a{i}, 0")
        passed.append(f"{llvm_type(k)} %{'b' if k == BOOL else 'a'}{i}")
    lines += _call_and_store(s, passed, "out", 0)
    return "\n".join([*lines, "ret void", "}"])


def _table_entry(s: Signature) -> str:
    """A wrapper with one argument: a table of the arguments, then of the results, of eight bytes each."""
    lines = [f"define void @{s.symbol}.table(ptr %t) nounwind {{"]
    passed = []
    for i, k in enumerate(s.arguments):
        t = llvm_type(k)
        lines.append(f"%p{i} = getelementptr i64, ptr %t, i64 {i}")
        lines.append(f"%a{i} = load {'i64' if k == BOOL else t}, ptr %p{i}")
        if k == BOOL:
            lines.append(f"%b{i} = icmp ne i64 %a{i}, 0")
        passed.append(f"{t} %{'b' if k == BOOL else 'a'}{i}")
    lines += _call_and_store(s, passed, "t", len(s.arguments))
    return "\n".join([*lines, "ret void", "}"])


def _thunk(s: Signature) -> str:
    """A function of another module under its own name here: it calls that module's wrapper, the one of :func:`_entry`."""
    kinds = s.result if isinstance(s.result, tuple) else () if s.result == NONE else (s.result,)
    types = ["i64" if k == BOOL else llvm_type(k) for k in s.arguments]
    lines = [f"declare void @{s.symbol}.entry({', '.join([*types, 'ptr'])}) nounwind"]
    parameters = ", ".join(f"{llvm_type(k)} %a{i}" for i, k in enumerate(s.arguments))
    lines += [
        f"define {llvm_type(s.result)} @{s.symbol}({parameters}) nounwind {{",
        f"%out = alloca [{len(kinds)} x i64]",
    ]
    lines += [f"%b{i} = zext i1 %a{i} to i64" for i, k in enumerate(s.arguments) if k == BOOL]
    passed = [f"{t} %{'b' if k == BOOL else 'a'}{i}" for i, (t, k) in enumerate(zip(types, s.arguments, strict=True))]
    lines.append(f"call void @{s.symbol}.entry({', '.join([*passed, 'ptr %out'])})")
    for i, k in enumerate(kinds):
        lines.append(f"%o{i} = getelementptr i64, ptr %out, i64 {i}")
        lines.append(f"%{'w' if k == BOOL else 'r'}{i} = load {'double' if k == NUM else 'i64'}, ptr %o{i}")
        if k == BOOL:
            lines.append(f"%r{i} = trunc i64 %w{i} to i1")
    whole = "%r0"
    if isinstance(s.result, tuple):
        for i, k in enumerate(kinds):
            before = f"%s{i - 1}" if i else "undef"
            lines.append(f"%s{i} = insertvalue {llvm_type(s.result)} {before}, {llvm_type(k)} %r{i}, {i}")
        whole = f"%s{len(kinds) - 1}"
    lines.append(f"ret {llvm_type(s.result)} {whole}" if kinds else "ret void")
    return "\n".join([*lines, "}"])


def _call_and_store(s: Signature, passed: list[str], out: str, first: int) -> list[str]:
    """The call of a function, and its results to the words of ``out`` from the ``first`` one on."""
    call = f"call {llvm_type(s.result)} @{s.symbol}({', '.join(passed)})"
    lines = [call if s.result == NONE else f"%r = {call}"]
    kinds = s.result if isinstance(s.result, tuple) else () if s.result == NONE else (s.result,)
    for i, k in enumerate(kinds):
        value = "%r"
        if isinstance(s.result, tuple):
            lines.append(f"%r{i} = extractvalue {llvm_type(s.result)} %r, {i}")
            value = f"%r{i}"
        if k == BOOL:
            lines.append(f"%w{i} = zext i1 {value} to i64")
            value = f"%w{i}"
        lines.append(f"%o{i} = getelementptr i64, ptr %{out}, i64 {first + i}")
        lines.append(f"store {'double' if k == NUM else 'i64'} {value}, ptr %o{i}")
    return lines


class Library:
    """Functions that are compiled together, when the first of them is called, and kept in the cache.

    ``packages``: folders and files of wbmpc whose source, with that of the folders of the library's own functions, decides whether a cached build is
    valid; empty: no cache. ``modules`` are imported first, so that the library is complete whichever function is called first. ``uses``: other
    libraries, whose functions its own ones may call (without vectors).
    """

    def __init__(
        self, name: str, packages: tuple[str, ...] = (), modules: tuple[str, ...] = (), uses: tuple[Library, ...] = ()
    ) -> None:
        self.name, self.packages, self.modules, self.uses = name, packages, modules, uses
        self.functions: list[Function[..., Any]] = []
        self._engine: Any = None
        self._lock: Any = threading.RLock()

    def compiled(self, python: Callable[P, R]) -> Function[P, R]:
        """Decorator: the function as machine code, with the types of its annotations."""
        function = Function(self, python)
        self.functions.append(function)
        return function

    def step(self, python: Callable[P, R]) -> Function[P, R]:
        """Decorator: as :meth:`compiled`, and :class:`~wbmpc.kernel.step.Step` can bind it."""
        function = self.compiled(python)
        function.short = function.stepped = True
        return function

    def source(self) -> str:
        """The library as LLVM IR."""
        for module in self.modules:
            import_module(module)
        known = {id(f): f.signature for f in self.functions}
        foreign = {id(f): f for library in self.uses for f in library.functions if _callable(f.signature)}
        called: dict[int, Function[..., Any]] = {}

        def find(target: object) -> Signature | None:
            if id(target) in foreign:
                called[id(target)] = foreign[id(target)]
                return foreign[id(target)].signature
            return known.get(id(target))

        parts = [Translator(f.python, f.signature, find).translate() for f in self.functions]
        parts += [_thunk(f.signature) for f in called.values()]
        text = "\n".join(parts)
        text = text.replace("\ndefine ", "\ndefine internal ").replace("define ", "define internal ", 1)
        entries = [_entry(f.signature) for f in self.functions if _callable(f.signature)]
        entries += [_table_entry(f.signature) for f in self.functions if f.stepped]
        helpers = [emit_log()] if "@vector_log(" in text else []
        return "\n".join([DECLARATIONS, *helpers, text, *entries])

    def _key(self) -> str:
        from wbmpc.kernel.codegen_target import target_text

        functions = " ".join(sorted(f.signature.symbol for f in self.functions))
        source = cache.source_fingerprint((*self.packages, *self._folders()))
        text = f"{self.name} {source} {target_text()} {functions}"
        return hashlib.sha256(text.encode()).hexdigest()

    def _folders(self) -> list[str]:
        """Folders of the functions' files: a library of another package is outside of wbmpc's own."""
        files = {Path(f.python.__code__.co_filename) for f in self.functions}
        return sorted({str(file.resolve().parent) for file in files if file.is_file()})

    def optimized(self) -> bytes:
        """LLVM bitcode of the library after the passes on it, for this machine or the target that code is generated for; cached."""
        from wbmpc.kernel.codegen_target import optimized, target_text

        for module in self.modules:
            import_module(module)
        key = hashlib.sha256(f"{self._key()} bitcode".encode()).hexdigest() if self.packages else ""
        found = cache.load(key, target=target_text()) if key else None
        if found is not None:
            return found[0]
        code = optimized(self.source(), 2)
        if key:
            cache.save(key, code, {"library": self.name, "target": target_text()})
        return code

    def build(self) -> None:
        """Compile, or load from the cache. Raises :class:`SolverBusy` within a call that compiles it: who interrupted that, as a signal's
        handler does, would wait for it forever."""
        from wbmpc.kernel.codegen_target import emit, load_object, target_text

        for module in self.modules:
            import_module(module)
        if self._lock._is_owned() and self._engine is None:
            raise SolverBusy(
                f"the code of '{self.name}' is being compiled by the call that this one interrupts, as a signal's handler does; valid: "
                "one call of each function before the handler is set"
            )
        with self._lock:
            if self._engine is not None:
                return
            key = self._key() if self.packages else ""
            found = cache.load(key, target=target_text()) if key else None
            if found is None:
                code = emit(self.optimized())
                if key:
                    cache.save(key, code, {"library": self.name, "target": target_text()})
            else:
                code = found[0]
            self._engine = load_object(code, self._symbols())

    def _symbols(self) -> dict[str, int]:
        """Addresses of all functions of the libraries that this one uses, by the names of their wrappers."""
        names = [
            (library, f"{f.signature.symbol}.entry")
            for library in self.uses
            for f in library.functions
            if _callable(f.signature)
        ]
        return {name: library.address(name) for library, name in names}

    def address(self, symbol: str) -> int:
        self.build()
        found = self._engine.get_function_address(symbol)
        if found == 0:
            raise KernelError(f"the library '{self.name}' has no function '{symbol}'")
        return int(found)
