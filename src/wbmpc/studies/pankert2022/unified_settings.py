"""Settings of `swerve-unified`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from wbmpc.bases.swerve.defaults import StateCost, SwerveCost
from wbmpc.configuration import OnlyWith
from wbmpc.settings import ExperimentSettings, Weight

#: Where the legs begin if nothing else is said.
AT_HOME = "home"
#: A configuration by name (H, X, A), or angles [rad], one for each leg.
Configuration = str | tuple[float, ...]


class SwerveUnifiedSettings(ExperimentSettings):
    """``legs``: by targets (from ``leg_start`` to ``leg_goal``: H, X, A, or angles [rad] in brackets, one for each leg; the robot's
    home and A if nothing is said) or free, with the zero-moment point's margin in the support triangles over the two rearmost feet
    as the objective of ``support`` weight per second (a logarithmic barrier, quadratic below ``reserve`` [m]), and without a goal;
    ``use_gyro``, ``settle_time``, ``actuator_time_constant``: as in swerve-track; ``leg_guard``: see
    :class:`wbmpc.bases.swerve.controller.SwerveController`."""

    cost: SwerveCost = SwerveCost(state=StateCost(position=20.0, yaw=20.0, leg=100.0))
    robot: str = "swerve-ur10"
    legs: Literal["targets", "support"] = "targets"
    leg_start: Configuration = AT_HOME
    leg_goal: Annotated[Configuration, OnlyWith(legs="targets")] = "A"
    support: Annotated[Weight, OnlyWith(legs="support")] = 0.05
    reserve: Annotated[float, OnlyWith(legs="support")] = Field(0.05, gt=0, le=0.5)
    use_gyro: bool = True
    settle_time: float = Field(20.0, ge=0, le=120)
    actuator_time_constant: float = Field(0.020, ge=0, le=0.5)
    leg_guard: bool = True
