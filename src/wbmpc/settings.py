"""Settings that experiments share. Every key can be set from the command line (``--set mpc.rate=100``)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from wbmpc.configuration import OneOf, reject_booleans, usual_kinds
from wbmpc.robots import load_description
from wbmpc.solver import SQP, InteriorPoint

#: Where nothing else is said: rate [Hz] of a tracking controller, time [s] that a solve is modeled to take, first-order lag [s] of drives,
#: as the controller assumes it and as the simulated ones have it but for their spread.
CONTROL_RATE, COMPUTATION_DELAY, ACTUATOR_TIME_CONSTANT = 400.0, 0.010, 0.020

#: Weights, gains and thresholds are numbers up to this: squares and products of larger ones leave the range of numbers.
LARGEST = 1e9
Weight = Annotated[float, Field(ge=0, le=LARGEST)]
#: A gain or a threshold: what is not there at 0.
Positive = Annotated[float, Field(gt=0, ge=1e-9, le=LARGEST)]


@dataclass(frozen=True)
class ReadBy:
    """Stands beside the type of a setting that names what is read from a file: ``read(value)`` raises :class:`InputError` where that
    cannot be read."""

    read: Callable[[Any], object]

    @classmethod
    def named(cls, settings: BaseModel) -> Iterator[tuple[Callable[[Any], object], Any]]:
        """Who reads it, and the value, for all that settings name."""
        for name, info in type(settings).model_fields.items():
            value = getattr(settings, name)
            if isinstance(value, BaseModel):
                yield from cls.named(value)
            elif value is not None:
                yield from ((mark.read, value) for mark in info.metadata if isinstance(mark, cls))


#: A robot's name or file.
Robot = Annotated[str, ReadBy(load_description)]


class Settings(BaseModel):
    """Base of all settings: unknown keys are errors; values are frozen; one of several models is by default of the default's kind. Of those
    that have one, ``robot``: name of a built-in robot, or a robot file."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)

    @model_validator(mode="before")
    @classmethod
    def _checked(cls, data: Any) -> Any:
        return usual_kinds(cls, reject_booleans(cls, data))


class Nothing(Settings):
    """A choice that is left out."""

    kind: Literal["none"] = "none"


class MpcTiming(Settings):
    """When a closed loop plans. ``rate`` [Hz]: update rate of the MPC; ``computation_delay`` [s]: modeled computation time."""

    rate: float = Field(50.0, gt=0, ge=1e-3, le=10_000)
    computation_delay: float = Field(COMPUTATION_DELAY, ge=0, le=1.0)


class UniformPlan(Settings):
    """A plan on a uniform grid. ``horizon`` [s]: length of the horizon; ``intervals``: number of intervals of the horizon;
    ``iterations``: solver iterations per update; ``barrier_mu``: barrier parameter of interior point and relaxed barriers;
    ``rollout_restart``: whether a plan is replaced by a roll-out of the model where a state outside its limit cuts steps to nearly
    nothing."""

    horizon: float = Field(10.0, gt=0, le=1000)
    intervals: int = Field(50, ge=1, le=1000)
    iterations: int = Field(1, ge=1, le=50)
    barrier_mu: float = Field(3e-3, gt=0, le=1e6)
    rollout_restart: bool = True


class PlanSettings(UniformPlan):
    """``first_interval`` [s]: first interval of a geometric grid (0: uniform grid)."""

    first_interval: float = Field(0.017, ge=0, le=1000)


class MpcSettings(PlanSettings, MpcTiming):
    """``limits``: treatment of limits, by an interior point (hard) or relaxed barriers (soft)."""

    limits: Literal["hard", "soft"] = "hard"

    def solver(self) -> SQP:
        """The solver's real-time settings."""
        interior_point = InteriorPoint("real_time", self.barrier_mu, rollout_restart=self.rollout_restart)
        return SQP.real_time(self.iterations, interior_point=interior_point)


_Center = Annotated[float, Field(ge=-10, le=10)]


class NoStability(Settings):
    """Nothing keeps the robot from tipping over: plans know no inertia."""

    kind: Literal["nothing"] = "nothing"


class StabilitySettings(Settings):
    """What keeps a robot on wheels from tipping over: one of its subclasses. ``payload`` [kg]: mass at the end effector that plans
    include; ``payload_center`` [m]: where it is, in the end effector's axes; ``estimate_payload``: whether the mass is weighed by the
    torques of the arm's drives while the arm is still in the base, and ``payload`` holds until then."""

    payload: float = Field(0.0, ge=0, le=1000)
    payload_center: tuple[_Center, _Center, _Center] = (0.0, 0.0, 0.0)
    estimate_payload: bool = False


class WheelLoadSettings(StabilitySettings):
    """Every wheel carries a load. ``min_load``: least load of a wheel, over the mean load of the empty robot at rest; ``friction``:
    coefficient for which tires hold in plans, best the least that may be (0: any force); ``estimate_friction``: whether wheels that slide
    show the coefficient, and ``friction`` holds until then."""

    kind: Literal["wheel_loads"] = "wheel_loads"
    min_load: float = Field(0.2, ge=0, lt=1)
    friction: float = Field(0.0, ge=0, le=10)
    estimate_friction: bool = False


class SupportMarginSettings(StabilitySettings):
    """The zero-moment point stays in the support polygon, for bases on casters too. ``margin`` [m]: distance of the zero-moment point
    from the border of the polygon."""

    kind: Literal["support_margin"] = "support_margin"
    margin: float = Field(0.05, ge=0, le=10)


#: What plans keep.
Stability = OneOf[NoStability | WheelLoadSettings | SupportMarginSettings]


class ControlSettings(Settings):
    """``rate`` [Hz]: rate of the tracking controller."""

    rate: float = Field(CONTROL_RATE, gt=0, ge=1e-3, le=10_000)
