"""Threads that use what another one closes: Cyclone DDS crashes where an endpoint is made on what is being deleted."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import wraps
from typing import Concatenate, ParamSpec, Protocol, TypeVar

from wbmpc.errors import RunAborted

P = ParamSpec("P")
R = TypeVar("R")


class InUse:
    """Of a node with a ``name``. Thread-safe."""

    def __init__(self, name: str) -> None:
        self.closed, self._name = False, name
        self._threads: list[int] = []  # that use it, as often as they have begun to
        self._changed = threading.Condition(threading.Lock())

    def check(self) -> None:
        """Raise :class:`RunAborted` if it is closed: who waits for something waits in vain."""
        if self.closed:
            raise RunAborted(f"node '{self._name}' is closed")

    @contextmanager
    def hold(self) -> Iterator[None]:
        """It is not closed meanwhile. Raises :class:`RunAborted` if it is."""
        with self._changed:
            self.check()
            self._threads.append(threading.get_ident())
        try:
            yield
        finally:
            with self._changed:
                self._threads.remove(threading.get_ident())
                self._changed.notify_all()

    def begin(self) -> ExitStack | None:
        """As :meth:`hold`, which has begun and ends with what is returned; None if it is closed."""
        held = ExitStack()
        try:
            held.enter_context(self.hold())
        except RunAborted:
            return None
        return held

    def close(self) -> bool:
        """Whether this call closes it: once, and when no other thread uses it any more."""
        own = threading.get_ident()
        with self._changed:
            if self.closed:
                return False
            self.closed = True
            try:
                self._changed.wait_for(lambda: all(thread == own for thread in self._threads))
            except BaseException:  # Ctrl-C: the next call closes it
                self.closed = False
                raise
        return True


class Used(Protocol):
    """What has threads that use it."""

    in_use: InUse


U = TypeVar("U", bound=Used)


def while_open(method: Callable[Concatenate[U, P], R]) -> Callable[Concatenate[U, P], R]:
    """A method of what is not closed while it runs."""

    @wraps(method)
    def held(self: U, /, *given: P.args, **keys: P.kwargs) -> R:
        with self.in_use.hold():
            return method(self, *given, **keys)

    return held
