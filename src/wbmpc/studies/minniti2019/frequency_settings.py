"""Settings of `rezero-frequency`."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from wbmpc.bases.ball.perturbation import BallHardware, SeriesElasticDrives
from wbmpc.configuration import OneOf
from wbmpc.settings import Nothing, Positive, Settings, Weight
from wbmpc.studies.minniti2019.controller_settings import PlanningController
from wbmpc.studies.minniti2019.settings import RezeroSettings

VARIANTS = ("plain", "shaped")
#: Shorter steps [m] cannot be distinguished from the noise.
MIN_STEP = 0.01
#: Springs that resonate at 15 Hz with the freely rolling ball, and at 18 to 31 Hz with the arm; they take the place of the lag.
ELASTIC = BallHardware(drives=SeriesElasticDrives(), actuator_time_constant=0.0)


_Step = Annotated[float, Field(ge=-1, le=1)]


class FilterSettings(Settings):
    """ν = (pole / zero) (s + zero) / (s + pole) u. ``wheel_zero`` [rad/s]: zero of the filter of the wheels' torques; ``wheel_pole`` [rad/s]: its
    pole; ``arm_zero`` [rad/s]: zero of the filter of the arm's torques; ``arm_pole`` [rad/s]: its pole; ``wheel_weight``: factor of the
    weight of the wheels' torques with the filter, so that the end effector rises as fast as without; ``arm_weight``: that of the arm's torques."""

    kind: Literal["filters"] = "filters"
    wheel_zero: Positive = 20.0
    wheel_pole: Positive = 160.0
    arm_zero: Positive = 20.0
    arm_pole: Positive = 160.0
    wheel_weight: Weight = 1.0
    arm_weight: Weight = 1.0


class RezeroFrequencySettings(RezeroSettings):
    """``step`` [m]: of the end effector (3), and back; ``settle_time`` [s]: before it; ``hold_time`` [s]: time for which each step is
    held; ``preview``: whether the MPC sees the step before it comes; ``plain``: whether the variant without filters is run; ``shaped``:
    the variant with filters (:class:`FilterSettings`), or none."""

    plant: BallHardware = ELASTIC
    controller: PlanningController = PlanningController()
    actuator_time_constant: float = Field(0.006, ge=0, le=0.5)
    step: tuple[_Step, _Step, _Step] = (0.2, 0.0, 0.0)
    settle_time: float = Field(3.0, ge=0.5, le=60.0)
    hold_time: float = Field(5.0, ge=1.0, le=60.0)
    preview: bool = True
    plain: bool = True
    shaped: OneOf[Nothing | FilterSettings] = FilterSettings()

    @property
    def variants(self) -> list[str]:
        """Those that are run."""
        return [
            n for n, run in zip(VARIANTS, (self.plain, isinstance(self.shaped, FilterSettings)), strict=True) if run
        ]

    @field_validator("step")
    @classmethod
    def _somewhere(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        length = float(np.linalg.norm(value))
        if not MIN_STEP <= length <= 1.0:
            raise ValueError(f"a step of {MIN_STEP:g} to 1 m is needed: its rise is measured")
        return value

    @model_validator(mode="after")
    def _rest_before(self) -> Self:
        if self.preview and self.settle_time < self.controller.ahead:
            raise ValueError(
                f"settle_time: {self.settle_time:g} s before a step that is seen {self.controller.ahead:g} s ahead "
                "(controller.plan.horizon): at least as long, or preview=false"
            )
        return self

    @model_validator(mode="after")
    def _one_at_least(self) -> Self:
        if not self.variants:
            raise ValueError("plain: one variant at least is needed; valid: plain=true or shaped=filters")
        return self
