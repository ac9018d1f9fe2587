"""A bus on which messages come by hand alone."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any


class Listening:
    """A bus on which nothing comes but by hand: ``take`` by topic."""

    def __init__(self) -> None:
        self.take: dict[str, Callable[..., None]] = {}

    def subscribe(self, topic: str, kind: str, callback: Callable[..., None], *given: Any, **keys: Any) -> None:
        self.take[topic] = callback

    def publisher(self, *given: Any) -> Any:
        return SimpleNamespace(publish=lambda message: None)


def vector(x: float = 0.0, z: float = 0.0) -> Any:
    return SimpleNamespace(x=x, y=0.0, z=z)
