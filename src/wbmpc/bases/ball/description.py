"""The ``base`` section of a robot that balances on a ball."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from wbmpc.bases.base import BaseDescription, InertialDescription, Radius, Section

if TYPE_CHECKING:
    from wbmpc.robots.description import LimitsDescription

#: Omni wheels nearer to each other than about so many radians turn the ball about two axes only.
MIN_SPREAD = 0.05


class OmniWheelsDescription(Section):
    """Omni wheels on the ball: radius [m], zenith angle and azimuths [rad] of their contacts."""

    radius: float = Field(ge=1e-3, le=10)
    zenith: float = Field(gt=0, lt=np.pi / 2)
    azimuths: tuple[Annotated[float, Field(ge=-6.3, le=6.3)], ...] = Field(min_length=3)

    @field_validator("azimuths")
    @classmethod
    def _every_way(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        around = np.stack([np.cos(value), np.sin(value), np.ones(len(value))])  # the axes' directions at 45 degrees
        if np.linalg.svd(around, compute_uv=False)[-1] < MIN_SPREAD:
            raise ValueError("the wheels cannot turn the ball about every axis: three different azimuths are needed")
        return value


class BallBaseDescription(BaseDescription):
    """A base that balances on a ball: the body ``ball`` hangs on ``body`` by a ball joint, in the same frame.

    ``contact``: what the world does to the robot as an input: a force, or a wrench (force and moment), at each frame of
    ``contact_frame`` (a name or several; the arm's tool when left out); "none": a force at the tool as a parameter.
    ``payload``: whether a mass at the tool [kg] is a parameter (``payload``).
    """

    limit_keys: ClassVar[tuple[str, ...]] = ("wheel_effort", "wheel_velocity", "spin_effort")

    type: Literal["ball"]
    ball: str
    ball_radius: float = Field(ge=1e-3, le=10)
    wheels: OmniWheelsDescription
    imu: InertialDescription = InertialDescription()
    contact: Literal["none", "force", "wrench"] = "none"
    contact_frame: tuple[str, ...] = ()
    payload: bool = False

    @field_validator("contact_frame", mode="before")
    @classmethod
    def _several(cls, value: Any) -> Any:
        return (value,) if isinstance(value, str) else value

    @model_validator(mode="after")
    def _contacts(self) -> Self:
        if self.contact_frame and self.contact == "none":
            raise ValueError("contact_frame needs contact: force or contact: wrench")
        if len(set(self.contact_frame)) < len(self.contact_frame):
            raise ValueError(f"contact_frame: every frame once, got {', '.join(self.contact_frame)}")
        return self

    @model_validator(mode="after")
    def _wheels_fit(self) -> Self:
        if self.wheels.radius > self.ball_radius:  # they have no bodies in a model that would say so
            raise ValueError(
                f"wheels.radius: {self.wheels.radius:g} m is more than the radius of the ball that they turn, {self.ball_radius:g} m"
            )
        return self

    def parts(self) -> dict[str, str]:
        return {"ball": self.ball}

    @property
    def ground(self) -> float:
        """The world's origin is at the height of the ball's center."""
        return -self.ball_radius

    def radii(self) -> list[Radius]:
        return [Radius("base.ball_radius", self.ball_radius, "ball", self.ball, sphere=True)]

    def torque_limits(self, limits: LimitsDescription) -> tuple[float, ...]:
        return (limits.wheel_effort,) * len(self.wheels.azimuths)

    def frames(self) -> dict[str, tuple[str, ...]]:
        return {"contact_frame": self.contact_frame}

    def check_limits(self, limits: LimitsDescription) -> None:
        """The torque of the omni wheels has no default: without a limit the robot could lean as far as it likes."""
        if not np.isfinite(limits.wheel_effort):
            raise ValueError(
                "key 'limits.wheel_effort': a base of type ball needs the largest torque [N m] of its omni wheels"
            )
