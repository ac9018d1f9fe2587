"""What the ``base`` sections of robots on wheels that are fixed to the body have in common."""

from __future__ import annotations

from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from wbmpc.bases.base import Radius
from wbmpc.bases.common.description import SpeedBaseDescription

#: A coordinate [m] in the axes of a body.
Place = Annotated[float, Field(ge=-100, le=100)]


class PlanarBaseDescription(SpeedBaseDescription):
    """``wheels``: names of the wheels' joints. ``wheel_radius`` [m]; left out: that of the wheels' shapes in the file."""

    joint_key: ClassVar[str] = "wheels"
    limit_keys: ClassVar[tuple[str, ...]] = ("base_linear", "base_angular")

    wheels: tuple[str, ...] = Field(min_length=2)
    wheel_radius: float | None = Field(None, ge=1e-3, le=10)

    def wheel_joints(self) -> list[str]:
        return list(self.wheels)

    def radii(self) -> list[Radius]:
        """Of every wheel, where the section gives it."""
        radius = self.wheel_radius
        return (
            []
            if radius is None
            else [Radius("base.wheel_radius", radius, "wheel", name) for name in self.wheel_joints()]
        )

    @model_validator(mode="after")
    def _every_wheel_once(self) -> Self:
        names = self.joints()
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise ValueError(f"wheels: every wheel once, got '{twice[0]}' twice")
        return self
