"""How a simulated swerve robot differs from the planner's model."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from wbmpc.configuration import OneOf
from wbmpc.simulation.perturbation import Choice, WheeledPerturbation


class SoundBrakes(Choice):
    """Brakes that do what they are commanded to."""

    kind: Literal["none"] = "none"


class StuckBrake(Choice):
    """A brake that stays open or closed. ``leg``: whose brake, the leg's place in the description, from 0; ``time`` [s]: from when on, of
    the plant, which stands for ``settle_time`` first."""

    kind: Literal["open", "closed"]
    leg: int = Field(default=0, ge=0, le=1000)
    time: float = Field(default=0.0, ge=0, le=1e6)


BrakeFaults = OneOf[SoundBrakes | StuckBrake]


class SoundPerturbation(WheeledPerturbation):
    """``steer_offset`` [rad]: zero errors of the steering encoders (measured = true + offset); ``steer_noise`` [rad]: standard deviation
    of the steering encoders per message; ``brake_delay`` [s]: time that a brake takes to open and to close."""

    steer_offset: float = Field(default=0.003, ge=0, le=3.2)
    steer_noise: float = Field(default=0.0, ge=0, le=3.2)
    brake_delay: float = Field(default=0.10, ge=0, le=100)

    def mount_offsets(self) -> tuple[float, float]:
        return self.joint_offset, self.steer_offset


class SwervePerturbation(SoundPerturbation):
    """``brake_fault``: none, or a brake that stays open or closed (:class:`StuckBrake`)."""

    brake_fault: BrakeFaults = SoundBrakes()
