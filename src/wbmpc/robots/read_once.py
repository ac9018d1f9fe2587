"""A robot's files are read by all that checks them; within one examination, in which they stay as they are, once."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

T = TypeVar("T")
_READ: ContextVar[dict[Hashable, Any] | None] = ContextVar("read", default=None)


@contextmanager
def reading_once() -> Iterator[None]:
    """Within it, also within another one, :func:`once` remembers."""
    if _READ.get() is not None:
        yield
        return
    token = _READ.set({})
    try:
        yield
    finally:
        _READ.reset(token)


def once(key: Hashable, make: Callable[[], T]) -> T:
    """What ``make`` makes, or has made of the same ``key`` before within :func:`reading_once`. Errors are not remembered."""
    known = _READ.get()
    if known is None:
        return make()
    if key not in known:
        known[key] = make()
    found: T = known[key]
    return found


def remembers() -> bool:
    """Whether this is within :func:`reading_once`."""
    return _READ.get() is not None
