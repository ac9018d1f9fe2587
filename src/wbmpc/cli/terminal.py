"""What is on the terminal while something runs, and how much of it."""

from __future__ import annotations

import io
import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout

#: Exit statuses.
COMPLETED, ABORTED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


@contextmanager
def progress_bar(title: str, show: bool) -> Iterator[Callable[[float, str], None] | None]:
    """A progress bar on a terminal; nothing in a pipe."""
    if not (show and sys.stderr.isatty()):
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[note]}"), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=1.0, note="")
        yield lambda fraction, note: bar.update(task, completed=fraction, note=note)


@contextmanager
def logged(verbose: bool) -> Iterator[None]:
    """What the library notes, on standard error: warnings, or everything."""
    log, handler = logging.getLogger("wbmpc"), logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("wbmpc: %(message)s"))
    before = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO if verbose else logging.WARNING)
    try:
        yield
    finally:
        log.removeHandler(handler)
        log.setLevel(before)


@contextmanager
def silent(wanted: bool) -> Iterator[None]:
    """Nothing on standard output if ``wanted``."""
    if not wanted:
        yield
        return
    with redirect_stdout(io.StringIO()):
        yield
