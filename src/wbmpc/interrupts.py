"""Signals that ask a command to end: they act once, wherever in the program they come, also while it is still being loaded; and what
ends a program from outside, as Ctrl-C does, ends its calls of CasADi."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType, TracebackType
from typing import Any, NoReturn

#: After so long [s] a signal acts that came where its exception would be lost.
_AGAIN = 0.01
_ENDING = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
#: Signals whose handlers may raise: Python's own for Ctrl-C, the command line's, and those of time limits and of users.
_SIGNALS = (
    signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM, signal.SIGVTALRM, signal.SIGPROF, signal.SIGUSR1, signal.SIGUSR2,
    signal.SIGQUIT,
)  # fmt: skip
#: Signals that came where their exception would be lost, and that have not acted yet.
_WAITING: set[int] = set()


class Request:
    """A signal that asks a command to end, as Ctrl-C does: a handler that raises KeyboardInterrupt. ``came``: whether it has."""

    def __init__(self) -> None:
        self.came = False

    def noted(self) -> None:
        """It came while something was finished first."""
        self.came = True

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.came = True
        if not (_is_dropped(frame) and _postpone(number)):
            raise KeyboardInterrupt


def _postpone(*numbers: int) -> bool:
    """Send signals again in a moment; False where nothing here answers the alarm."""
    if signal.getsignal(signal.SIGALRM) is not _send_again:
        return False
    _WAITING.update(numbers)
    signal.setitimer(signal.ITIMER_REAL, _AGAIN)
    return True


def _send_again(number: int, frame: FrameType | None) -> None:
    """To its present handler."""
    waiting = sorted(_WAITING)
    _WAITING.clear()
    for each in waiting:
        signal.raise_signal(each)


def act_on_waiting() -> None:
    """Raise KeyboardInterrupt if a signal came that has not acted yet."""
    if _WAITING:
        _WAITING.clear()
        raise KeyboardInterrupt


def _is_dropped(frame: FrameType | None) -> bool:
    """Whether an exception would go through CasADi, which tries conversions of arguments and drops what they raise, or through trimesh,
    which drops whatever ends an import."""
    while frame is not None:
        parts = frame.f_code.co_filename.split(os.sep)
        if parts[-1] == "casadi.py" or "trimesh" in parts:
            return True
        frame = frame.f_back
    return False


def _came() -> list[int]:
    handlers = [(number, signal.getsignal(number)) for number in _ENDING]
    return [number for number, handler in handlers if isinstance(handler, Request) and handler.came]


def ended_by_signal() -> int:
    """128 and the number of the signal that asked this command to end: SIGTERM, SIGHUP, as when the terminal was closed, or SIGINT,
    which is Ctrl-C. 0: none has come."""
    return next((128 + number for number in _came()), 0)


@contextmanager
def _nothing_dropped() -> Iterator[None]:
    """Python drops what is raised while it clears up: in callbacks of weak references, of which every import has one, and in
    ``__del__``. An interrupt that came there acts a moment later."""
    previous = sys.unraisablehook

    def hook(dropped: Any) -> None:
        if not (isinstance(dropped.exc_value, KeyboardInterrupt) and _postpone(*(_came() or [signal.SIGINT]))):
            previous(dropped)

    sys.unraisablehook = hook
    try:
        yield
    finally:
        if sys.unraisablehook is hook:
            sys.unraisablehook = previous


def in_main_thread() -> bool:
    """Whether this is the thread in which Python runs handlers of signals: what a signal raises comes nowhere else."""
    return threading.current_thread() is threading.main_thread()


@contextmanager
def terminable() -> Iterator[None]:
    """Handle Ctrl-C, SIGTERM and SIGHUP, but for those that have other handlers, in the main thread."""
    if not in_main_thread():
        yield
        return
    taken: dict[int, tuple[Any, Any]] = {
        signal.SIGALRM: (signal.SIG_DFL, _send_again), signal.SIGINT: (signal.default_int_handler, Request()),
        signal.SIGTERM: (signal.SIG_DFL, Request()), signal.SIGHUP: (signal.SIG_DFL, Request()),
    }  # fmt: skip
    taken = {number: (usual, own) for number, (usual, own) in taken.items() if signal.getsignal(number) == usual}
    try:
        for number, (_, own) in taken.items():
            signal.signal(number, own)
        with _nothing_dropped():
            yield
    finally:
        _WAITING.clear()  # an alarm that comes yet does nothing
        for number, (usual, _) in reversed(taken.items()):
            if number == signal.SIGALRM:
                signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(number, usual)


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Threads and processes that this thread starts in here do not hear the terminal's Ctrl-C, from their first instruction on: a signal
    that is blocked stays so for them. It is for the process that started them, which ends them."""
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # which would unblock it at the start of the first process
    previous = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous)


@contextmanager
def exits_seen() -> Iterator[None]:
    """``os._exit`` of this process raises SystemExit in the main thread, and ends with no 0 in others: it would pass for the command's own
    success. A child that was forked in here ends with it, with a status of its own, and does not go on as a second process with the
    same command."""
    if not in_main_thread():
        yield
        return
    process, leave = os.getpid(), see_exits()
    status = 1
    try:
        yield
    except SystemExit as error:
        status = error.code if isinstance(error.code, int) else int(error.code is not None)
        if os.getpid() != process:
            _end_child(leave, status, "" if isinstance(error.code, int | None) else f"{error.code}\n")
        raise
    finally:
        if os.getpid() != process:
            _end_child(leave, status)
        os._exit = leave


def _end_child(leave: Any, status: int, text: str = "") -> None:
    """With its ``text`` and what it has written, where that can be done at all: it ends in any case."""
    try:
        with suppress(Exception):
            sys.stderr.write(text)
        sys.stdout.flush()
    except BaseException:  # no output, a closed one, a full disk, a signal
        pass
    finally:
        leave(status & 0xFF)


def see_exits() -> Any:
    """As :func:`exits_seen`, from now on; what ``os._exit`` was."""
    leave, process = os._exit, os.getpid()

    def leave_seen(status: int) -> NoReturn:
        if os.getpid() != process:  # a child's status is its own
            leave(status)
        if in_main_thread():
            raise SystemExit(status)
        leave(status or 1)

    os._exit = leave_seen
    return leave


def interrupted(error: BaseException) -> bool:
    """Whether it was Ctrl-C that came while compiled code called Python: that reports it as an error of its own."""
    found: BaseException | None = error
    while found is not None and not isinstance(found, KeyboardInterrupt):
        found = found.__cause__ or found.__context__
    return found is not None


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
