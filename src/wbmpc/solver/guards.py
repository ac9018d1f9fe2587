"""A solver's memory has one owner at a time; and what ends a program from outside, as Ctrl-C does, ends its calls of CasADi."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any

from wbmpc.errors import SolverBusy

#: Signals whose handlers may raise: Python's own for Ctrl-C, the command line's for the others.
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Exclusive:
    """One thread at a time, which may enter again. Who comes meanwhile does not wait: :class:`SolverBusy`."""

    def __init__(self, what: str) -> None:
        self.what, self._lock, self._running = what, threading.RLock(), False

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise SolverBusy(
                f"{self.what} is in use by another thread: its memory has one owner; valid: one for each thread"
            )

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._lock.release()

    @contextmanager
    def once(self, call: str) -> Iterator[None]:
        """As the context itself, but not again before it is left: a user's function that is called within it, as a guess is, may not
        ``call`` what called it."""
        with self:
            if self._running:
                raise SolverBusy(f"{call}: called before its last call has ended, as by a guess of this very MPC")
            self._running = True
            try:
                yield
            finally:
                self._running = False


class Interruptible:
    """What the handler of a signal raises within this context comes out of it, whatever CasADi made of it.

    CasADi's wrapper takes an exception that is raised while it looks at its arguments (they call Python) for arguments of a wrong
    type: it drops the exception, and raises NotImplementedError or goes on. Handlers run in the main thread only.
    """

    def __init__(self) -> None:
        self.raised: BaseException | None = None
        self._previous: list[tuple[int, Callable[..., Any], Callable[..., Any]]] = []

    def __enter__(self) -> Interruptible:
        if threading.current_thread() is threading.main_thread():
            for number in _SIGNALS:
                handler = signal.getsignal(number)
                if callable(handler):  # neither the system's default nor ignored
                    noting = self._noting(handler)
                    self._previous.append((number, handler, noting))
                    signal.signal(number, noting)
        return self

    def _noting(self, handler: Callable[..., Any]) -> Callable[[int, FrameType | None], Any]:
        def noting(number: int, frame: FrameType | None) -> Any:
            try:
                return handler(number, frame)
            except BaseException as error:
                self.raised = error
                if not _comes_or_goes(frame):  # which have to end, and raise it afterwards
                    raise

        return noting

    def check(self) -> None:
        """Raise what a handler has raised, if CasADi dropped it and went on."""
        if self.raised is not None:
            raise self.raised

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        for number, handler, noting in self._previous:
            if signal.getsignal(number) is noting:  # else the handler has set another one
                signal.signal(number, handler)
        if self.raised is not None and error is not self.raised:
            raise self.raised from None


def _comes_or_goes(frame: FrameType | None) -> bool:
    """Whether a frame is one that enters or leaves this context, or was called by one: parts of :mod:`signal` are Python."""
    while frame is not None and frame.f_code not in _COMING_AND_GOING:
        frame = frame.f_back
    return frame is not None


_COMING_AND_GOING = (Interruptible.__enter__.__code__, Interruptible.__exit__.__code__)
