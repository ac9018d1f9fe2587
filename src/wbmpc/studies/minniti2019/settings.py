"""Settings that the ball robot's experiments share; what the chosen controller and estimator do not read is an error."""

from __future__ import annotations

from functools import reduce
from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from wbmpc.bases.ball.defaults import BodyCost, HandCost, RezeroCost
from wbmpc.bases.ball.settings import BallControllerSettings
from wbmpc.settings import ExperimentSettings
from wbmpc.studies.minniti2019.baselines import (
    ACCURATE_BASELINES,
    BaselineSettings,
    Controller,
    TrackingSettings,
    unread,
)

#: What the filter alone reads of the simulated sensors, and what only the state of the simulator has [of ``plant``].
INERTIAL = tuple(f"plant.{sensor}_{kind}" for sensor in ("gyro", "accel") for kind in ("noise", "bias", "walk"))
STATE_NOISE = tuple(f"plant.{kind}_noise" for kind in ("position", "angle", "speed", "rate"))


class RezeroSettings(BallControllerSettings, ExperimentSettings):
    """``robot``: a name or a file, of a base of type ball; the weights were found for Rezero.
    ``estimator``: the state from the sensors (filter), or from the simulator with noise (truth); ``payload`` [kg]: an
    unknown mass at the hand; ``controller``: the MPC, or a baseline that has its estimator and the same limits of the drives,
    with its gains (``baseline``); ``tracking`` of the MPC's plans. What the chosen controller does not read is rejected."""

    robot: str = "rezero"
    estimator: Literal["filter", "truth"] = "filter"
    payload: float = Field(0.0, ge=0, le=5.0)
    controller: Controller = "mpc"
    baseline: BaselineSettings = BaselineSettings()
    tracking: TrackingSettings = TrackingSettings()

    #: Settings that the experiment has no use for: to change them is rejected. Those that it reads itself, whatever controls.
    unused: ClassVar[tuple[str, ...]] = ("cost.torque.force", "cost.torque.moment")
    own: ClassVar[tuple[str, ...]] = ()

    def _changed(self, name: str) -> bool:
        """Whether a setting is not as it is by default."""
        first, *rest = name.split(".")
        usual = reduce(getattr, rest, type(self).model_fields[first].default)
        return bool(reduce(getattr, rest, getattr(self, first)) != usual)

    def _asked(self, name: str) -> bool:
        """Whether somebody wants this: it is not as by default, and not 0, nothing of it."""
        value = reduce(getattr, name.split("."), self)
        return self._changed(name) and (value is False or value != 0)

    def idle(self) -> dict[str, str]:
        """Settings that nothing reads as the others are, by name, and which other one makes them so."""
        sensors = STATE_NOISE if self.estimator == "filter" else (*INERTIAL, "expected_push_time")
        out = dict.fromkeys(sensors, f"estimator={self.estimator}")
        if self.cost.lean == 0.0:
            out["expected_push_time"] = "cost.lean=0"
        if self.mpc.limits == "soft":
            out["cost.speed_slack"] = "mpc.limits=soft"
        if not self.estimate_disturbance:
            out |= dict.fromkeys(("estimate_payload", "max_pushed_speed"), "estimate_disturbance=false")
        return out

    def controllers(self) -> tuple[Controller, ...]:
        """Those that run."""
        return (self.controller,)

    @model_validator(mode="after")
    def _used(self) -> Self:
        for name in filter(self._changed, self.unused):
            raise ValueError(f"{name}: this experiment does not use it")
        idle = frozenset.intersection(*(unread(c, self.tracking) for c in self.controllers()))
        for name in filter(self._changed, sorted(idle - set(self.own))):
            with_ = " and tracking.kind=actuators" if self.controller == "mpc" and name == "actuator_dead_time" else ""
            raise ValueError(f"{name}: with controller={self.controller}{with_} nothing uses it")
        for name, other in self.idle().items():
            if self._asked(name):
                raise ValueError(f"{name}: with {other} nothing uses it")
        return self


class AccurateSettings(RezeroSettings):
    """A hand that is led accurately while the ball has a place of its own: stiff weights, for references that move slowly; so have
    the baselines."""

    expected_push_time: float = Field(0.0, ge=0, le=1.0)
    cost: RezeroCost = RezeroCost(
        end_effector=HandCost(weight=1000.0, orientation=2.0, roll=0.0), body=BodyCost(ball=150.0, yaw=20.0), lean=0.6
    )
    baseline: BaselineSettings = ACCURATE_BASELINES
