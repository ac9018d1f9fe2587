"""Settings of pushes while ball or end effector are held."""

from __future__ import annotations

from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from wbmpc.checks import whole
from wbmpc.studies.minniti2019.controller_settings import HELD_MPC, HeldController
from wbmpc.studies.minniti2019.recovery import LAST
from wbmpc.studies.minniti2019.settings import ControlledSettings

#: Time [s] that a robot has for recovering, at least.
RECOVERY = 2.0


class PushSettings(ControlledSettings):
    """``push_duration`` [s]: of each push, whole controller periods; ``pause`` [s]: from a push (or the second of a pair) to the next."""

    #: what is to stay in its place: "hand", or "ball"
    held: ClassVar[str] = "hand"
    push_duration: float = Field(0.2, gt=0, le=5.0)
    pause: float = Field(7.0, ge=RECOVERY, le=60.0)

    @model_validator(mode="after")
    def _whole_periods(self) -> Self:
        whole("push_duration", self.push_duration, 1.0 / self.control.rate, "controller periods")
        return self

    @model_validator(mode="after")
    def _one_after_the_other(self) -> Self:
        if self.pause < self.push_duration + LAST:
            raise ValueError(
                f"pause: {self.pause:g} s from one push to the next, which are {self.push_duration:g} s long and judged by the last "
                f"{LAST:g} s; at least {self.push_duration + LAST:g} s are needed"
            )
        return self


class RezeroPushHandSettings(PushSettings):
    """The end effector is held: the weights of the steps.

    ``forces`` [N]: each along x and then along y; ``gap`` [s]: from the first push of such a pair to the second (left out: as long as the
    pause); ``settle_time`` [s]: at rest before the first push. The robot must be back before each push that comes at least
    :data:`RECOVERY` after the one before."""

    forces: tuple[Annotated[float, Field(ge=0, le=5000.0)], ...] = Field((50.0, 100.0, 200.0), min_length=1)
    gap: Annotated[float, Field(ge=0.5, le=60.0)] | None = None
    settle_time: float = Field(3.0, ge=0.5, le=60.0)

    @model_validator(mode="after")
    def _second_after_the_first(self) -> Self:
        if self.gap is not None and self.gap < self.push_duration:
            raise ValueError(f"gap: {self.gap:g} s from one push to the next, which are {self.push_duration:g} s long")
        return self


class RezeroPushBallSettings(RezeroPushHandSettings):
    """The ball is held and, of the end effector, only its orientation (the paper's first task); otherwise the same weights."""

    held: ClassVar[str] = "ball"
    controller: HeldController = HELD_MPC
