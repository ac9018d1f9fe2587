"""What checks of a robot's file find: one message each, with how to fix it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

#: "error": the robot does not load, or would not do what its file means. "warning": it loads, and something is assumed or lost.
#: "info": what a user has to know to describe it.
Severity = Literal["error", "warning", "info"]


@dataclass(frozen=True)
class Finding:
    """``check``: name of the check; ``where``: the element of the file; ``text``: what is wrong; ``fix``: how to fix it."""

    severity: Severity
    check: str
    where: str
    text: str
    fix: str = ""

    @property
    def message(self) -> str:
        """In one line."""
        place = f"{self.where}: " if self.where else ""
        return f"{place}{self.text}{'; ' + self.fix if self.fix else ''}"
