"""Worker processes of a study that can be interrupted."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from types import TracebackType
from typing import TypeVar

T = TypeVar("T")


class Workers:
    """Processes that do not hear the terminal's Ctrl-C: this one does, and ends them, whatever they are at, if it leaves by an
    exception. ``count``: as many as there are cores when left out."""

    def __init__(self, count: int | None = None, method: str = "spawn") -> None:
        self._pool = ProcessPoolExecutor(count, multiprocessing.get_context(method))

    def submit(self, work: Callable[..., T], *given: object) -> Future[T]:
        """Have it done. Processes start in here, and a signal that is blocked then stays so for them."""
        previous = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return self._pool.submit(work, *given)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, previous)

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if kind is not None:
            for process in multiprocessing.active_children():
                process.kill()  # SIGTERM is caught by a forked one that has not begun its work
        self._pool.shutdown(cancel_futures=True)
