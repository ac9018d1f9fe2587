"""Settings of `swerve-unified`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from wbmpc.bases.swerve.defaults import StateCost, SwerveCost
from wbmpc.configuration import OneOf
from wbmpc.settings import Robot, Settings, Weight
from wbmpc.studies.pankert2022.driving import DrivingSettings

#: Where the legs begin if nothing else is said.
AT_HOME = "home"
#: A configuration by name (H, X, A), or angles [rad], one for each leg.
Configuration = str | tuple[Annotated[float, Field(ge=-6.3, le=6.3)], ...]


class TargetLegs(Settings):
    """The legs go to ``goal``."""

    kind: Literal["targets"] = "targets"
    goal: Configuration = "A"


class SupportLegs(Settings):
    """The legs have no goal: the objective is the zero-moment point's margin in the support triangles over the two rearmost feet.
    ``weight``: weight of the margin, per second (a logarithmic barrier); ``reserve`` [m]: below it the barrier is quadratic."""

    kind: Literal["support"] = "support"
    weight: Weight = 0.05
    reserve: float = Field(0.05, gt=0, le=0.5)


#: What moves the legs.
Legs = OneOf[TargetLegs | SupportLegs]


class SwerveUnifiedSettings(DrivingSettings):
    """``leg_start``: H, X, A, angles [rad] in brackets, one for each leg, or home; ``legs``: what moves them from there, targets
    (``legs.goal``, as ``leg_start``) or their support (:class:`SupportLegs`);
    ``leg_guard``: whether the brakes of open legs that move off their plan close. The other settings are those of all experiments that drive."""

    cost: SwerveCost = SwerveCost(state=StateCost(position=20.0, yaw=20.0, leg=100.0))
    robot: Robot = "swerve-ur10"
    leg_start: Configuration = AT_HOME
    legs: Legs = TargetLegs()
    leg_guard: bool = True
