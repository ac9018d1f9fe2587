"""The ``base`` section of a robot whose base does not move."""

from __future__ import annotations

from typing import ClassVar, Literal

from wbmpc.bases.base import BaseDescription

_SPEEDS = (
    "the inputs of a fixed base are speeds, so that a contact force or wrench has no effect on its motion; valid: with a base of "
    "type ball"
)


class FixedBaseDescription(BaseDescription):
    """A base that does not move."""

    moves: ClassVar[bool] = False
    uses_inertia: ClassVar[bool] = False

    not_applicable: ClassVar[dict[str, str]] = {"contact": _SPEEDS, "contact_frame": _SPEEDS}

    type: Literal["fixed"]
