"""The ``base`` section of a robot on omni or mecanum wheels."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from wbmpc.bases.planar_motion.description import PlanarBaseDescription

#: Largest angle [deg] between a roller's axle and the rolling direction: beyond it a wheel passes on hardly any speed.
STEEPEST = 75.0


class OmnidirectionalBaseDescription(PlanarBaseDescription):
    """Wheels with rollers. ``rollers``: "omni" (the rollers' axles lie along the rolling direction), "mecanum" (at ±45 degrees, in the
    arrangement whose lever of yaw is lx + ly), or the angle [deg] of each wheel: of the axle of the roller that touches the ground,
    from the rolling direction, positive to the left, seen from above."""

    type: Literal["omnidirectional"]
    rollers: Literal["omni", "mecanum"] | tuple[Annotated[float, Field(ge=-STEEPEST, le=STEEPEST)], ...]

    @field_validator("rollers", mode="before")
    @classmethod
    def _known(cls, value: Any) -> Any:
        numbers = isinstance(value, list | tuple) and all(
            isinstance(v, int | float) and abs(v) <= STEEPEST for v in value
        )
        if not numbers and value not in ("omni", "mecanum"):
            raise ValueError(f"valid: omni, mecanum, or one angle per wheel from -{STEEPEST:g} to {STEEPEST:g} [deg]")
        return value

    @model_validator(mode="after")
    def _one_angle_per_wheel(self) -> Self:
        if not isinstance(self.rollers, str) and len(self.rollers) != len(self.wheels):
            raise ValueError(f"rollers: {len(self.wheels)} angles are needed, one per wheel, got {len(self.rollers)}")
        return self
