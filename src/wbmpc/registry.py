"""Experiments by name: those of this package, those of other installed packages, and files that a user wrote.

An experiment is a :class:`wbmpc.experiment.Experiment` somewhere in a module. A package offers its own through the entry-point group
``wbmpc.experiments``, and so do the studies of papers that come with this one; :data:`wbmpc.tasks.EXPERIMENTS` lists the general ones,
which a source checkout that is not installed has too::

    [project.entry-points."wbmpc.experiments"]
    my-task = "my_package.my_task:EXPERIMENT"

A file needs no entry: ``wbmpc run my_task.py``.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cache, partial
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from threading import RLock
from types import ModuleType
from typing import Any

from wbmpc import plugins
from wbmpc.errors import InputError, ProgramError, unknown_name
from wbmpc.experiment import Experiment
from wbmpc.mpc.mpc import MPC
from wbmpc.result import RunResult
from wbmpc.result_checks import check_result

GROUP = "wbmpc.experiments"
#: The entry points of 'wbmpc demo': the same targets again.
DEMO_GROUP = "wbmpc.demo"
#: The table of the general experiments, imported by its name when it is asked for: it stands above this module.
GENERAL = "wbmpc.tasks:EXPERIMENTS"
#: One file at a time: while a file is imported its classes look each other up by the module's name, which two threads would share.
_IMPORTING = RLock()
#: Where programs of files (None: of other packages) are that have changed the directory.
_AT_HOME: dict[Path | None, str] = {}


@cache
def locations() -> dict[str, str]:
    """Name -> "module:attribute": the general experiments in their order, the others of this distribution by name, then those of other
    packages by name.

    The name of an experiment of this distribution cannot be taken.
    """
    general: dict[str, str] = plugins.load(GENERAL, "general experiments:")
    return {**general, **{name: value for name, value in plugins.offered(GROUP).items() if name not in general}}


@cache
def load(name: str) -> Experiment:
    """The experiment of a name. Raises :class:`InputError` for an unknown name, or a package whose experiment cannot be imported."""
    known = locations()
    if name not in known:
        raise unknown_name("experiment", name, known)
    found = plugins.load(known[name], f"experiment '{name}':")
    where = f"experiment '{name}': {known[name]}"
    checked = _checked(found, where)
    return (
        checked
        if known[name].startswith(f"{plugins.OWN}.")
        else replace(checked, run=partial(_run, where, None, checked.run))
    )


def load_file(path: Path) -> Experiment:
    """The experiment of a Python file: its ``EXPERIMENT``.

    Raises :class:`InputError` if there is no such file, it cannot be imported, or has no ``EXPERIMENT``. Its run raises
    :class:`ProgramError` for a mistake of the file, with its line.
    """
    if not path.is_file():
        raise InputError(f"there is no file '{path}'")
    found = _checked(getattr(_imported(path), "EXPERIMENT", None), f"{path}: EXPERIMENT")
    return replace(found, run=partial(_run, str(path), path, found.run))


def _run(where: str, file: Path | None, run: Callable[..., RunResult], *arguments: Any) -> RunResult:
    """A run of other people's experiment, whose mistakes are no outcome of a robot's."""
    streams = sys.stdout, sys.stderr
    try:
        with (
            _own_directory(file),
            plugins.mistakes_of("its run fails" if file else f"{where}: its run fails", file, ProgramError),
        ):
            result: RunResult = run(*arguments)
    finally:
        sys.stdout, sys.stderr = streams
    try:
        check_result(result)
    except InputError as error:
        raise ProgramError(f"{where}: the result of its run: {error}") from error
    return result


def load_mpc(problem: str) -> MPC:
    """The MPC of ``FILE.py`` or ``FILE.py:NAME``: NAME is one, or a function that returns one; by default ``make_mpc``, or else ``mpc``.

    Raises :class:`InputError` if there is no such file, it cannot be imported, or has no MPC of that name.
    """
    file, colon, name = problem.partition(":")
    path = Path(file)
    if path.suffix != ".py" or not path.is_file():
        raise InputError(
            f"'{problem}': a Python file that makes an MPC is needed, as FILE.py or FILE.py:NAME; there is no file '{path}'"
        )
    if colon and not name:
        raise InputError(f"'{problem}': there is no name after ':'; valid: FILE.py:NAME, or FILE.py alone")
    module = _imported(path)
    names = (name,) if name else ("make_mpc", "mpc")
    found = next((getattr(module, n) for n in names if hasattr(module, n)), None)
    if found is None:
        raise InputError(
            f"{path}: there is no {' and no '.join(names)}; valid: a function that returns an MPC, or an MPC"
        )
    called = name or "make_mpc"
    with _own_directory(path), plugins.mistakes_of(f"{called}() fails", path):
        made = found() if callable(found) else found
    if not isinstance(made, MPC):
        raise InputError(f"{path}: {called}: an MPC is needed, got {type(made).__name__}")
    return made


def _imported(path: Path) -> ModuleType:
    """The module of a file; files beside it can be imported by it."""
    name = f"wbmpc_experiment_{re.sub('[^A-Za-z0-9]', '_', str(path.resolve()))}"
    spec = spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    beside = str(path.resolve().parent)
    with _IMPORTING:
        sys.modules[name] = module  # annotations that are text are looked up there
        sys.path.insert(0, beside)
        try:
            with _own_directory(path, new=True), plugins.mistakes_of("cannot be imported", path):
                spec.loader.exec_module(module)
        finally:
            with suppress(ValueError):  # a program may do with the path what it likes
                sys.path.remove(beside)
    return module


@contextmanager
def _own_directory(file: Path | None, new: bool = False) -> Iterator[None]:
    """A program may change the directory, and finds itself there again, unless it is ``new``; paths of the command line stay the user's."""
    program = Path(os.path.abspath(file)) if file else None
    try:
        before = os.getcwd()
    except OSError:  # it has been removed
        yield
        return
    home = _AT_HOME.pop(program, before)
    with suppress(OSError):
        os.chdir(before if new else home)
    try:
        yield
    finally:
        with suppress(OSError):
            if (now := os.getcwd()) != before:
                _AT_HOME[program] = now
        with suppress(OSError):
            os.chdir(before)


def _checked(found: Any, where: str) -> Experiment:
    if not isinstance(found, Experiment):
        raise InputError(f"{where}: a wbmpc.experiment.Experiment is needed, got {type(found).__name__}")
    return found


def demonstrated() -> list[str]:
    """The experiments that 'wbmpc demo' runs: those that installed packages offer for it. Raises :class:`InputError` if there is none."""
    found = [name for name in plugins.offered(DEMO_GROUP) if name in locations()]
    if not found:
        raise InputError(
            f"no installed package offers an experiment for 'wbmpc demo' (entry-point group '{DEMO_GROUP}')"
        )
    return found


class Registry(Mapping[str, Experiment]):
    """All experiments that are installed, each imported when it is asked for."""

    def __getitem__(self, name: str) -> Experiment:
        if name not in locations():
            raise KeyError(name)
        return load(name)

    def __iter__(self) -> Iterator[str]:
        return iter(locations())

    def __len__(self) -> int:
        return len(locations())

    def __contains__(self, name: object) -> bool:
        return name in locations()


REGISTRY = Registry()
