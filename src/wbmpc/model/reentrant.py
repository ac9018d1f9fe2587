"""What works in memory of its own, for calls that come while another one is under way: from other threads, from a signal's handler."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


class Reentrant(Generic[P, R]):
    """Calls what ``make()`` makes, one for each call that is under way: a handler that comes between two steps of a call would
    otherwise change its numbers, and a lock would wait for the very call that it interrupts."""

    def __init__(self, make: Callable[[], Callable[P, R]]) -> None:
        self._make = make
        self._idle: list[Callable[P, R]] = []

    def __call__(self, *arguments: P.args, **names: P.kwargs) -> R:
        try:
            one = self._idle.pop()
        except IndexError:
            one = self._make()
        found = one(*arguments, **names)
        self._idle.append(one)  # one that was interrupted by an exception is left half done, and not used again
        return found
