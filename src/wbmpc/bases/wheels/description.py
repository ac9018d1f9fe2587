"""The ``base`` section of a robot on any mix of wheels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

from pydantic import Field

from wbmpc.bases.base import Section
from wbmpc.bases.omnidirectional.description import STEEPEST
from wbmpc.bases.planar_motion.description import Place, PlanarBaseDescription


class WheelDescription(Section):
    """A wheel: its ``joint``; ``steer``: the joint of its steering axis, which may turn about +z or −z and may be beside the wheel;
    ``rollers`` [deg]: the angle of the axle of the roller that touches the ground from the rolling direction, positive to the left (0:
    omni, 45 or -45: mecanum), none for a tire; ``driven``: whether it has a drive and an encoder."""

    joint: str
    steer: str | None = None
    rollers: float | None = Field(None, ge=-STEEPEST, le=STEEPEST)
    driven: bool = True


class WheelsBaseDescription(PlanarBaseDescription):
    """``wheels``: the wheels; ``casters`` (x, y) [m] in the axes of the body: what else carries the robot in the simulator."""

    captions: ClassVar[Mapping[str, str]] = {"steer": "steering"}
    joint_key: ClassVar[str] = "wheels"
    describes_offsets: ClassVar[bool] = True

    type: Literal["wheels"]
    wheels: tuple[WheelDescription, ...] = Field(min_length=1)  # type: ignore[assignment]
    casters: tuple[tuple[Place, Place], ...] = ()

    def wheel_joints(self) -> list[str]:
        return [w.joint for w in self.wheels if w.driven]

    def joint_groups(self) -> dict[str, list[str]]:
        steering = self.steering_joints()
        return {"steer": steering} if steering else {}

    def steering_joints(self) -> list[str]:
        return [w.steer for w in self.wheels if w.steer]

    def joints(self) -> list[str]:
        return [n for w in self.wheels for n in (w.steer, w.joint) if n]
