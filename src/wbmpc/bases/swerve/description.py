"""The ``base`` section of a robot on steered and driven wheels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

from pydantic import Field, model_validator

from wbmpc.bases.base import Radius, Section
from wbmpc.bases.common.description import SpeedBaseDescription


class ModuleDescription(Section):
    """One swerve module: names of its joints. A leg turns about a ``hinge`` or gets longer by a ``slide``; both are left out when the legs
    are fixed (all of a base, or none)."""

    hinge: str | None = None
    slide: str | None = None
    steer: str
    wheel: str

    @model_validator(mode="after")
    def _check_leg(self) -> ModuleDescription:
        if self.hinge and self.slide:
            raise ValueError(f"a leg has a hinge or a slide, got '{self.hinge}' and '{self.slide}'")
        return self

    @property
    def leg(self) -> str | None:
        """The joint of its leg."""
        return self.hinge or self.slide


class SwerveBaseDescription(SpeedBaseDescription):
    """A base on steered and driven wheels. ``wheel_radius`` [m]. ``orientation``: SE(2) state or a quaternion."""

    captions: ClassVar[Mapping[str, str]] = {"leg": "legs", "steer": "steering", "wheel": "wheels"}
    joint_key: ClassVar[str] = "modules"
    limit_keys: ClassVar[tuple[str, ...]] = ("base_linear", "base_angular")

    type: Literal["swerve"]
    orientation: Literal["yaw", "quaternion"] = "yaw"
    wheel_radius: float = Field(ge=1e-3, le=10)
    modules: tuple[ModuleDescription, ...] = Field(min_length=2)

    def joint_groups(self) -> dict[str, list[str]]:
        """Joints of the legs (none with fixed legs), steering and wheel joints, each by module."""
        moved = [m.leg for m in self.modules if m.leg]
        legs = {"leg": moved} if moved else {}
        return {**legs, "steer": self.steering_joints(), "wheel": [m.wheel for m in self.modules]}

    def steering_joints(self) -> list[str]:
        return [m.steer for m in self.modules]

    def joints(self) -> list[str]:
        return [n for m in self.modules for n in (m.leg, m.steer, m.wheel) if n]

    def radii(self) -> list[Radius]:
        return [Radius("base.wheel_radius", self.wheel_radius, "wheel", m.wheel) for m in self.modules]
