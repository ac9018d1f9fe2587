"""Settings of `rezero-door`, and the doors that there are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from wbmpc.bases.ball.defaults import ApproachCost, BodyCost, TaskCost, TorqueCost
from wbmpc.configuration import OneOf
from wbmpc.settings import Nothing
from wbmpc.studies.minniti2019.controller_parts import DEAD_TIME, DeadTime, PayloadDisturbance
from wbmpc.studies.minniti2019.controller_settings import Planner
from wbmpc.studies.minniti2019.door_problem import DoorScheme, PushCost, default_push_cost
from wbmpc.studies.minniti2019.settings import RezeroSettings

DOORS: dict[str, dict[str, Any]] = {
    "free": {},
    "heavy": {"mass": 36.0, "damping": 20.0},
    "sticking": {"breakaway": 3.2},
    "light": {"mass": 6.0, "friction": 0.5, "closer": 0.5, "damping": 3.0},
    "locked": {"locked": True},
}
#: The force's error (rms over force) that a door should not exceed, where that is not 8 %: a light door runs away.
FORCE_GOAL = {"light": 0.15}


class DoorMpc(Planner):
    """``cost``: weights of a free end effector; ``actuator_dead_time`` [s]: of the drives, that the MPC's policy assumes."""

    disturbance: OneOf[Nothing | PayloadDisturbance] = PayloadDisturbance()
    cost: TaskCost = TaskCost(
        end_effector=ApproachCost(weight=300.0, orientation=30.0, limit=0.05, twist=1.0, angular=0.05),
        body=BodyCost(ball_speed=1.0, tilt_rate=5.0, arm=1.0),
        torque=TorqueCost(wheel=0.2, arm=0.3),
        lean=0.6,
    )
    actuator_dead_time: DeadTime = DEAD_TIME


class DoorSettings(RezeroSettings):
    """``rise_time`` [s]: time from the touch until a force is reached; ``settle_time`` [s]: before the end effector starts;
    ``opening_angle`` [rad]: angle of the door at which the end effector lets go;
    ``timeout`` [s]: from its start, after which it lets go too;
    ``final_hold_time`` [s]: time from the release to the end of the run. ``scheme``: what of the door the problem knows; ``push``:
    weights while it pushes (what is left out: as suits the scheme); ``door_position_error`` [m]: the door's place is not known better;
    ``door_spread``: width, mass, hinge, friction, closer and damping of the door differ by up to this share from those of its kind;
    ``lean_share``: a force beyond this share of what the lean's limit holds at home (:func:`held`) is not pushed with; this share is,
    and it is reported."""

    controller: DoorMpc = DoorMpc()
    scheme: DoorScheme = DoorScheme()
    push: PushCost | None = None
    rise_time: float = Field(0.05, ge=0, le=10.0)
    settle_time: float = Field(3.0, ge=0.5, le=60.0)
    opening_angle: float = Field(float(np.deg2rad(60.0)), gt=0, le=2.0)
    timeout: float = Field(9.0, ge=1.0, le=120.0)
    final_hold_time: float = Field(4.0, ge=0.1, le=60.0)
    door_position_error: float = Field(0.01, ge=0, le=0.05)
    door_spread: float = Field(0.2, ge=0, le=0.3)
    lean_share: float = Field(0.6, gt=0, le=10.0)

    @field_validator("push", mode="before")
    @classmethod
    def _suit_the_scheme(cls, push: Any, info: ValidationInfo) -> Any:
        """Some weights as a mapping: the others are those of the scheme."""
        scheme = info.data.get("scheme")  # missing where it is wrong itself
        return {**default_push_cost(scheme).model_dump(), **push} if isinstance(push, Mapping) and scheme else push


class RezeroDoorSettings(DoorSettings):
    """``door``: its kind; ``forces`` [N]: along the normal, a run each; ``speed`` [m/s]: speed of the approach at its start."""

    door: Literal["free", "heavy", "sticking", "light", "locked"] = "free"
    forces: tuple[Annotated[float, Field(gt=0, le=200.0)], ...] = Field((8.0, 16.0), min_length=1, max_length=2)
    speed: float = Field(0.1, gt=0, le=1.0)
