"""What installed packages offer by entry points, so that nothing here has to name them."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from wbmpc.errors import NO_TEXT, InputError, ProgramError, WbmpcError, described, text_of
from wbmpc.interrupts import exits_seen, interrupted

#: The distribution whose names others cannot take.
OWN = "wbmpc"
#: Parts of other packages that what runs is made of: what each is -> "module:attribute".
_IN_USE: dict[str, str] = {}


def offered(group: str) -> dict[str, str]:
    """Name -> "module:attribute" of the entry points of a group: those of this distribution by name, then those of others by name. Nothing
    is imported."""
    points = sorted(entry_points(group=group), key=lambda p: (p.dist is None or p.dist.name != OWN, p.name))
    found: dict[str, str] = {}
    for point in points:
        found.setdefault(point.name, point.value)
    return found


@contextmanager
def mistakes_of(what: str, file: Path | None = None, kind: type[WbmpcError] = InputError) -> Iterator[None]:
    """Whatever other people's code raises, or that it ends the process, is an error of a ``kind`` that begins with ``file``, its line, and
    ``what``. Ctrl-C stays Ctrl-C."""
    try:
        with exits_seen():
            yield
    except BaseException as error:
        if interrupted(error) or (isinstance(error, WbmpcError) and text_of(error) != NO_TEXT):
            raise
        place = "" if file is None else f"{file}{_line(file, error)}: "
        raise kind(f"{place}{what}: {described(error)}") from error


def _line(file: Path, error: BaseException) -> str:
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if Path(f.filename) == file.absolute()]
    line = error.lineno if isinstance(error, SyntaxError) else lines[-1] if lines else None
    return "" if line is None else f", line {line}"


def load(value: str, what: str) -> Any:
    """The attribute of "module:attribute". Raises :class:`InputError` that begins with ``what`` if it cannot be imported."""
    module, _, attribute = value.partition(":")
    with mistakes_of(f"{what} {value} cannot be imported"):
        return getattr(import_module(module), attribute)


def is_own(value: str) -> bool:
    """Whether "module:attribute" is of this distribution."""
    return value.partition(":")[0].partition(".")[0] == OWN


def note_use(what: str, value: str) -> None:
    """What runs from now on is made of "module:attribute", which may be of another package: ``what`` it is."""
    if not is_own(value):
        _IN_USE[what] = value


def forget_uses() -> None:
    """Another command begins."""
    _IN_USE.clear()


def mistake_in_use(error: BaseException) -> ProgramError | None:
    """What ended a command that is made of parts of other packages, as an error that names the part and the line, if their code has raised
    it, or else all parts: one may have given back what nothing can be done with. None where there are no such parts."""
    if not _IN_USE:
        return None
    calls = [(Path(frame.filename), frame.lineno) for frame in traceback.extract_tb(error.__traceback__)]
    named = [(_home(value), f"{what} of another package ({value})") for what, value in _IN_USE.items()]
    for file, line in reversed(calls):
        parts = [part for home, part in named if home in (file, *file.parents)]
        if parts:
            return ProgramError(f"{', '.join(parts)}: {described(error)} ({file}, line {line})")
    file, line = calls[-1] if calls else (Path(), 0)
    return ProgramError(f"with {', '.join(part for _, part in named)}: {described(error)} ({file}, line {line})")


def _home(value: str) -> Path:
    """The folder of the package of "module:attribute", or the file of a module that is in none."""
    found = import_module(value.partition(":")[0].partition(".")[0])
    folders = list(getattr(found, "__path__", ()))  # also of a package without a file of its own
    return Path(folders[0] if folders else str(found.__file__)).resolve()
