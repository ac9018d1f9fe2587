"""Monitors: they compare what is commanded with what is measured, and report faults. One protocol for all of them.

A monitor decides nothing: who assembles a controller says what a fault does (a message, another plan, a stop).
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

_LOG = logging.getLogger("wbmpc")


class Fault(Protocol):
    """Something that a monitor has found at ``time`` [s]; ``str()`` is the message to a user."""

    @property
    def time(self) -> float:
        """When [s]."""


@dataclass(frozen=True)
class SimpleFault:
    """A fault that is no more than its message: ``what`` was found at ``time`` [s]."""

    time: float
    what: str

    def __str__(self) -> str:
        return f"{self.what} ({self.time:.2f} s)"


#: What monitors of one base compare: a record of its own, or its measurement.
ReadingsT = TypeVar("ReadingsT", contravariant=True)
Readings = TypeVar("Readings")


class Monitor(Protocol[ReadingsT]):
    """One of a controller's ``monitors``, which its controller asks in every tick, or as often as it says."""

    def update(self, readings: ReadingsT, /) -> Sequence[Fault]:
        """The faults that are new since the last ``readings``."""


def found_by(monitors: Iterable[Monitor[Readings]], readings: Readings) -> list[Fault]:
    """What all monitors find in the same ``readings``; it is logged."""
    found = [fault for monitor in monitors for fault in monitor.update(readings)]
    for fault in found:
        _LOG.warning("%s", fault)
    return found
