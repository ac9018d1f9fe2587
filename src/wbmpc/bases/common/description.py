"""What the ``base`` sections of robots whose planner has speeds as inputs have in common."""

from __future__ import annotations

from typing import ClassVar

from wbmpc.bases.base import BaseDescription

_SPEEDS = "the inputs of this base are speeds, so that a contact force or wrench has no effect on its motion; valid: with a base of type ball"


class SpeedBaseDescription(BaseDescription):
    """Only kinematics is read of the file."""

    uses_inertia: ClassVar[bool] = False
    not_applicable: ClassVar[dict[str, str]] = {"contact": _SPEEDS, "contact_frame": _SPEEDS}
