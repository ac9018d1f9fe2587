"""Monitors: they compare what is commanded with what is measured, and report faults. One protocol for all of them.

A monitor decides nothing: who assembles a controller says what a fault does (a message, another plan, a stop).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable


@runtime_checkable
class Fault(Protocol):
    """Something that a monitor has found at ``time`` [s]; ``str()`` is the message to a user."""

    @property
    def time(self) -> float: ...


@runtime_checkable
class Monitor(Protocol):
    """``update`` takes in what a monitor compares, and returns the faults that are new since the last time."""

    def update(self, *readings: Any) -> Sequence[Fault]: ...
