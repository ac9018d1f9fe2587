"""A solver's memory has one owner at a time."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from wbmpc.errors import SolverBusy

_Given = TypeVar("_Given")
_Result = TypeVar("_Result")


class Exclusive:
    """One thread at a time, which may enter again. Who comes meanwhile does not wait: :class:`SolverBusy`.

    Ctrl-C may come between any two steps of Python, also those of entering and leaving, and must not leave it in use for ever.
    """

    def __init__(self, what: str) -> None:
        self.what, self._running, self._lent = what, "", False
        self._lock: Any = threading.RLock()
        _ALL.add(self)

    def __enter__(self) -> None:
        if self._lock._is_owned():
            return
        try:
            free = self._lock.acquire(blocking=False)
        except BaseException:  # of a signal's handler, after the lock was taken or before
            if self._lock._is_owned():
                self._lock.release()
            raise
        if not free:
            raise SolverBusy(
                f"{self.what} is in use by another thread: its memory has one owner; valid: one for each thread"
            )

    @property
    def __exit__(self) -> Callable[..., None]:
        """What leaves: the lock's own method, in which no handler of Python's runs. It is looked up before the context is entered."""
        return _stay if self._lock._is_owned() else self._lock.__exit__  # type: ignore[no-any-return]

    def once(self, name: str, work: Callable[[_Given], _Result], given: _Given) -> _Result:
        """``work(given)`` within it, but not again before that has ended: a user's function that is called by it, as a guess is, or that
        interrupts it, as a signal's handler does, may not call ``name``, which works on the same memory."""
        with self:
            if self._running:
                raise SolverBusy(
                    f"{name}: called before its last call has ended, as by a guess of its own or a signal's handler"
                )
            try:
                self._running = name
                return work(given)
            finally:
                self._running = ""

    def between(self, what: str) -> Exclusive:
        """To be entered for ``what``, which changes what :meth:`once` works on, and so may not come in its middle."""
        if self._running and not self._lent and self._lock._is_owned():
            raise SolverBusy(
                f"{what}: called before {self._running} has ended, whose memory it changes, as by a signal's handler"
            )
        return self

    @contextmanager
    def lent(self) -> Iterator[None]:
        """While a guess is asked for: it may change what the call that asks for it begins with."""
        self._lent = True
        try:
            yield
        finally:
            self._lent = False

    def free_in_child(self) -> None:
        """After a fork: who was in it is not in this process, unless it is who forked."""
        if not self._lock._is_owned():
            self._running, self._lent, self._lock = "", False, threading.RLock()


#: Those of this process: a fork has one thread, and locks of all.
_ALL: weakref.WeakSet[Exclusive] = weakref.WeakSet()


def _free_all() -> None:
    for one in _ALL:
        one.free_in_child()


os.register_at_fork(after_in_child=_free_all)


def _stay(*_: object) -> None:
    """Leave a context within one of the same thread."""
