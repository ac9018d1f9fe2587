"""Threads that use what another one closes: Cyclone DDS crashes where an endpoint is made on what is being deleted."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import wraps
from typing import Concatenate, ParamSpec, Protocol, TypeVar

from wbmpc.errors import RunAborted

P = ParamSpec("P")
R = TypeVar("R")
#: How often [s] who closes looks whether others still use it.
POLL = 2e-3


class InUse:
    """Of a node with a ``name``. Thread-safe without locks: Ctrl-C may come between taking one and leaving it again, and the node that is
    closed for it would wait forever. Single steps on lists and dicts are whole."""

    def __init__(self, name: str) -> None:
        self._name, self._open = name, [True]  # who takes it out closes
        self._threads: dict[object, int] = {}  # that use it, each time that they have begun to

    @property
    def closed(self) -> bool:
        """Whether nobody may begin to use it any more."""
        return not self._open

    def check(self) -> None:
        """Raise :class:`RunAborted` if it is closed: who waits for something waits in vain."""
        if self.closed:
            raise RunAborted(f"node '{self._name}' is closed")

    @contextmanager
    def hold(self) -> Iterator[None]:
        """It is not closed meanwhile. Raises :class:`RunAborted` if it is."""
        use = object()
        try:
            self._threads[use] = threading.get_ident()
            self.check()  # after that: who closes looks for threads afterwards
            yield
        finally:
            self._threads.pop(use, None)

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
        try:
            self._open.pop()
        except IndexError:
            return False
        try:
            while any(thread != own for thread in self._threads.copy().values()):
                time.sleep(POLL)
        except BaseException:  # Ctrl-C: the next call closes it
            self._open.append(True)
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
