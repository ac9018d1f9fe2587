"""What is on the terminal while something runs, and how much of it."""

from __future__ import annotations

import io
import logging
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import partial
from typing import TYPE_CHECKING, Any

from wbmpc.errors import printable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

#: Exit statuses.
COMPLETED, ABORTED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


class _Printable(logging.Formatter):
    """Lines of a log, each with its traceback if there is one."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        return printable(super().formatMessage(record))


def table(title: str | None = None) -> Table:
    """A table with lines and colors on a terminal; in a pipe plain columns, which other programs can read."""
    from rich.table import Table

    return Table(title=title) if sys.stdout.isatty() else Table(title=title, box=None, pad_edge=False)


def console() -> Console:
    """Where tables are printed: as wide as the terminal; in a pipe wide enough for everything. Texts stay texts: what stands in
    brackets, as a unit in a metric's name, is no style."""
    from rich.console import Console

    return Console(markup=False) if sys.stdout.isatty() else Console(markup=False, width=200, color_system=None)


def experiment_names(incomplete: str) -> list[str]:
    """For the shell's completion."""
    from wbmpc.registry import REGISTRY

    return [name for name in REGISTRY if name.startswith(incomplete)]


def robot_names(incomplete: str) -> list[str]:
    """For the shell's completion."""
    from wbmpc.robots import available_robots

    return [name for name in available_robots() if name.startswith(incomplete)]


@contextmanager
def progress_bar(title: str, show: bool) -> Iterator[Callable[[float, str], None] | None]:
    """A progress bar on a terminal; nothing in a pipe."""
    if not (show and sys.stderr.isatty()):
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    text = partial(TextColumn, markup=False)
    columns = (text("{task.description}"), BarColumn(), text("{task.fields[note]}"), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=1.0, note="")
        yield lambda fraction, note: bar.update(task, completed=fraction, note=note)


@contextmanager
def logged(verbose: bool, debug: bool = False) -> Iterator[None]:
    """What the library notes, on standard error: warnings, or everything; with ``debug`` tracebacks too."""
    log, handler = logging.getLogger("wbmpc"), logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Printable("wbmpc: %(message)s"))
    previous = log.level
    log.addHandler(handler)
    log.setLevel(logging.DEBUG if debug else logging.INFO if verbose else logging.WARNING)
    try:
        yield
    finally:
        log.removeHandler(handler)
        log.setLevel(previous)


class _Tolerant:
    """A stream whose reader may go away (``wbmpc list | head``): what is written then is lost, and nothing else happens. ``last``: so it is
    with whatever else is wrong with it."""

    def __init__(self, stream: Any, last: bool = False) -> None:
        self._stream, self._last = stream, last

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with self._kept():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with self._kept():
            self._stream.flush()

    def close(self) -> None:
        """It stays open: an experiment of a user may close it, and the command has yet to say what came of it."""
        self.flush()

    @contextmanager
    def _kept(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            # where standard error cannot be written, there is no other place to say so
            if not (isinstance(error, BrokenPipeError) or self._last):
                raise
            # what the stream still holds, and all that follows, goes nowhere
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)


def open_streams() -> None:
    """Standard streams that were closed (``wbmpc list >&-``) lead nowhere: Python has None for them, and the next file that is opened
    would take their number. Characters that a stream's encoding does not have, and names of files that are no text, are written out."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


@contextmanager
def unread_allowed() -> Iterator[None]:
    """Standard output and error may be pipes that are closed early: no command stops or fails for that."""
    with redirect_stdout(_Tolerant(sys.stdout)), redirect_stderr(_Tolerant(sys.stderr, last=True)):  # type: ignore[type-var]
        yield
        sys.stdout.flush()


@contextmanager
def silent(requested: bool) -> Iterator[None]:
    """Nothing on standard output if ``requested``."""
    if not requested:
        yield
        return
    with redirect_stdout(io.StringIO()):
        yield
