"""The ``base`` section of a robot on steered and driven wheels."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from wbmpc.bases.base import BaseDescription, Radius, Section

_SPEEDS = (
    "the inputs of a swerve base are speeds, so that a contact force or wrench has no effect on its motion; valid: with a base of "
    "type ball"
)


class ModuleDescription(Section):
    """One swerve module: names of its joints; ``hinge`` is left out when the legs are fixed (all of a base, or none)."""

    hinge: str | None = None
    steer: str
    wheel: str


class SwerveBaseDescription(BaseDescription):
    """A base on steered and driven wheels. ``wheel_radius`` [m]. ``orientation``: SE(2) state or a quaternion."""

    joint_key: ClassVar[str] = "modules"
    uses_inertia: ClassVar[bool] = False
    limit_keys: ClassVar[tuple[str, ...]] = ("base_linear", "base_angular")
    not_applicable: ClassVar[dict[str, str]] = {"contact": _SPEEDS, "contact_frame": _SPEEDS}

    type: Literal["swerve"]
    orientation: Literal["yaw", "quaternion"] = "yaw"
    wheel_radius: float = Field(ge=1e-3, le=10)
    modules: tuple[ModuleDescription, ...] = Field(min_length=2)

    def joint_groups(self) -> dict[str, list[str]]:
        """Hinges (none with fixed legs), steering and wheel joints, each by module."""
        hinges = [m.hinge for m in self.modules if m.hinge]
        legs = {"leg": hinges} if hinges else {}
        return {**legs, "steer": [m.steer for m in self.modules], "wheel": [m.wheel for m in self.modules]}

    def joints(self) -> list[str]:
        """The joints module by module."""
        return [n for m in self.modules for n in (m.hinge, m.steer, m.wheel) if n]

    def radii(self) -> list[Radius]:
        """Of every wheel."""
        return [Radius("base.wheel_radius", self.wheel_radius, "wheel", m.wheel) for m in self.modules]
