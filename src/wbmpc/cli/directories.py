"""Where files go, so that nothing is overwritten: the one place that decides.

A name that the program chooses gets the next free number (``runs/NAME-seed200-2``, ``plots-2.html``), and so does the directory of
a run. A file that the user names is rejected when it is there, unless ``--force`` is given. A directory that a command goes on with
(studies, searches, the site of all experiments) is new, empty, or has what an earlier call has left.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Annotated

import typer

from wbmpc.errors import InputError
from wbmpc.output_file import is_named_pipe

AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
Force = Annotated[bool, typer.Option("--force", help="Replace files that are there already.")]

#: Bytes of a run's recording, with a unit.
RECORD_LIMIT = "2GB"
RecordLimit = Annotated[
    str,
    typer.Option(
        metavar="SIZE", help="Largest recording on the disk, as 500MB or 2GB; beyond it the oldest half is replaced."
    ),
]
_UNITS = {"B": 1, "KB": 1_000, "MB": 1_000_000, "GB": 1_000_000_000, "TB": 1_000_000_000_000}
#: A smaller recording would be all about its own beginning.
MIN_RECORD = 1_000_000


def size_of(option: str, text: str) -> int:
    """Bytes of a size such as ``500MB``. Raises :class:`InputError` naming the option."""
    found = re.fullmatch(r"([0-9]{1,9}(?:\.[0-9]{1,9})?)\s*([kKMGT]?B)", text.strip())
    size = float(found[1]) * _UNITS[found[2].upper()] if found else 0.0
    if size < MIN_RECORD:
        raise InputError(
            f"{option}: '{text}': a size from 1MB on is needed, as 500MB or 2GB; valid units: {', '.join(_UNITS)}"
        )
    return int(size)


def new_file(option: str, chosen: Path | None, default: Path, force: bool) -> Path:
    """The file that ``option`` names, or else one beside ``default`` that is not there yet.

    Raises :class:`InputError` if the named one is there and ``force`` is not given, or cannot be written, and if that beside
    ``default`` is a link (:func:`reject_links`).
    """
    if chosen is not None and not chosen.parent.is_dir():
        raise InputError(f"{option}: '{chosen}': there is no directory '{chosen.parent}'")
    path = chosen or _own(option, default, force)
    reject_existing(option, [path], force)
    _try_to_write(option, path)
    return path


def _try_to_write(option: str, path: Path) -> None:
    """Before the work is done, not after it. A file that was not there is not there afterwards, nor one where a link leads."""
    existed = path.exists()
    file = path if existed else Path(os.path.realpath(path))
    try:
        file.open("ab").close()
        if not existed:
            file.unlink()
    except OSError as error:
        raise InputError(f"{option}: '{path}' cannot be written ({error.strerror})") from error


def _make(option: str, path: Path) -> None:
    """A directory, if it is not there. Raises :class:`InputError` naming the option if that, or writing into it, is impossible."""
    if path.exists() and not path.is_dir():
        raise InputError(f"{option}: '{path}' is a file; give a directory")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{option}: '{path}' cannot be made ({error.strerror})") from error
    if not os.access(path, os.W_OK | os.X_OK):
        raise InputError(f"{option}: cannot write into '{path}'")


@contextmanager
def writable_directory(option: str, path: Path) -> Iterator[None]:
    """Make it before the work, if it is not there; what was made for it and stays empty is removed again. Raises as :func:`_make`."""
    with _empty_ones_removed(path, *path.parents):
        _make(option, path)
        yield


@contextmanager
def resumed_directory(option: str, path: Path, marks: Iterable[str]) -> Iterator[None]:
    """As :func:`writable_directory`, of a command that goes on with what is in ``path``, and replaces pages there.

    Raises :class:`InputError` too if the directory has files, but none that fits one of the patterns ``marks``: these are
    something else's, as those of the file system's root. So it is with links to files (:func:`reject_links`).
    """
    with _empty_ones_removed(path, *path.parents):
        _make(option, path)
        reject_links(option, (entry for entry in sorted(path.iterdir()) if not entry.is_dir()))
        strange = next((entry.name for entry in sorted(path.iterdir()) if not entry.name.startswith(".")), None)
        if strange is not None and not any(next(path.glob(mark), None) for mark in marks):
            raise InputError(
                f"{option}: '{path}' has files of something else ('{strange}'); give a new or empty directory, or one of an earlier "
                f"call of this command"
            )
        yield


@contextmanager
def _empty_ones_removed(*paths: Path) -> Iterator[None]:
    """Directories, the innermost first, that are not there yet and are empty at the end are removed again."""
    missing = [path for path in paths if not path.exists()]
    try:
        yield
    finally:
        for path in missing:
            with suppress(OSError):
                path.rmdir()  # succeeds only if nothing was written


def new_directory(option: str, chosen: Path | None, default: Path, force: bool) -> Path:
    """A directory for files that :func:`reject_existing` then checks: the chosen one, or as :func:`new_file` has it."""
    if chosen is not None and chosen.exists() and not chosen.is_dir():
        raise InputError(f"{option}: '{chosen}' is a file; give a directory")
    return chosen or _own(option, default, force)


def _own(option: str, default: Path, force: bool) -> Path:
    """A name that the user has not chosen: what is there is replaced with ``force``, but for a link."""
    path = default if force else _free(default)
    reject_links(option, [path])
    return path


def reject_existing(option: str, paths: Iterable[Path], force: bool) -> None:
    """Raise :class:`InputError` naming the first file that is there, unless ``force`` is given and it can be replaced."""
    for path in paths:
        if path.is_dir():
            raise InputError(f"{option}: '{path}' is a directory; give a file")
        if is_named_pipe(path):
            raise InputError(f"{option}: '{path}' is a pipe, whose reader may never come; give a file")
        if path.exists() and not force:
            raise InputError(f"{option}: '{path}' is there already; give another name, or --force to replace it")


def reject_links(option: str, paths: Iterable[Path]) -> None:
    """Raise :class:`InputError` naming the first that is a link: the names are the command's, and the user has not named what is written
    there."""
    for path in paths:
        if path.is_symlink():
            raise InputError(
                f"{option}: '{path}' is a link: another file would be written; remove it, or give another name"
            )


def _free(path: Path) -> Path:
    """``path``, or the first of ``path``-2, -3 … (before the ending) that is not there."""
    names = (path if k == 1 else path.with_name(f"{path.stem}-{k}{path.suffix}") for k in count(1))
    return next(p for p in names if not os.path.lexists(p))  # nor behind a link


def _reserve(base: Path) -> Path:
    """Make ``base``, or ``base-2``, ``base-3`` … when it is there: a run never overwrites another one."""
    for k in count(1):
        path = base if k == 1 else base.with_name(f"{base.name}-{k}")
        try:
            path.mkdir(parents=True)
        except FileExistsError:
            continue
        return path
    raise AssertionError("unreachable")


@contextmanager
def run_directory(out: Path | None, name: str, seed: int, files: Iterable[str] = ()) -> Iterator[Path]:
    """Where the files go: a directory without another run, nor any of ``files``. Made before the run, so that a bad path is found at
    once.

    What was made for it and stays empty is removed again.
    """
    target = out or Path("runs") / f"{name}-seed{seed}"
    with _empty_ones_removed(target, *target.parents):
        directory = _chosen(out, target, files)
        try:
            yield directory
        finally:
            if directory != target:  # made under another name
                with suppress(OSError):
                    directory.rmdir()


def _chosen(out: Path | None, target: Path, files: Iterable[str]) -> Path:
    from wbmpc.report import RUN_FILES

    if out is not None:
        _make("--out", out)
        if not any(os.path.lexists(out / file) for file in (*RUN_FILES, *files)):
            return out
        if out.name in ("", ".."):  # '.', '..' and '/': a name beside them would not be below what the user has named
            raise InputError(f"--out: '{out}' has the files of a run already; give the name of a new directory")
    try:
        return _reserve(target)
    except OSError as error:
        raise InputError(f"'{target}' cannot be made ({error.strerror}); give another directory with --out") from error
