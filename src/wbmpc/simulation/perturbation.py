"""How the simulated robot differs from the planner's model, and how its sensors and drives misbehave."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Self

import mujoco
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from wbmpc.arrays import Array
from wbmpc.bases import base_type
from wbmpc.errors import InputError
from wbmpc.robots import RobotDescription
from wbmpc.settings import ACTUATOR_TIME_CONSTANT

_Friction = Annotated[float, Field(ge=0, le=100)]


class Choice(BaseModel):
    """One of several models of a setting, by its ``kind``."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)


class Perturbation(BaseModel):
    """Spreads of the differences between plant and model; each is drawn uniformly within ± its value, per seed.

    What the plants of all robots read; a base type adds its own in a subclass (:meth:`wbmpc.bases.base.BaseType.perturbation`).

    ``mass`` [1]: relative error of the bodies' masses; ``inertia`` [1]: relative error of the bodies' inertias; ``com_offset`` [m]: shift of
    centers of mass, per axis; ``joint_offset`` [rad]: zero errors of the encoders of hinges and arm.

    ``actuator_time_constant`` [s]: lag of the drives; ``actuator_time_constant_spread`` [1]: relative spread of the lag, drive by drive;
    ``friction``: coefficient of the floor, a range or one number.

    ``encoder_jitter`` [s]: the values of a message are up to this old; ``arm_counts``: encoder counts per turn of the arm's joints,
    0: exact.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)
    #: What a plant like the model (:meth:`none`) has in the place of 0.
    LEFT: ClassVar[Mapping[str, float]] = {"actuator_time_constant": ACTUATOR_TIME_CONSTANT, "friction": 0.8}

    mass: float = Field(default=0.05, ge=0, lt=0.5)
    inertia: float = Field(default=0.10, ge=0, lt=0.5)
    com_offset: float = Field(default=0.010, ge=0, le=1)
    joint_offset: float = Field(default=0.002, ge=0, le=3.2)
    actuator_time_constant: float = Field(default=ACTUATOR_TIME_CONSTANT, ge=0, le=10)
    actuator_time_constant_spread: float = Field(default=0.30, ge=0, lt=1)
    friction: tuple[_Friction, _Friction] = (0.6, 0.9)
    encoder_jitter: float = Field(default=0.002, ge=0, le=0.5)
    arm_counts: int = Field(default=2**17, ge=0, le=2**40)

    @field_validator("friction", mode="before")
    @classmethod
    def _one_number_is_a_range(cls, value: Any) -> Any:
        return (value, value) if isinstance(value, (int, float)) else value

    @field_validator("friction")
    @classmethod
    def _range_in_order(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] > value[1]:
            raise ValueError("one number, or two with 0 ≤ lower ≤ upper ≤ 100, are needed")
        return value

    @classmethod
    def of(cls, given: Perturbation | None, description: RobotDescription) -> Self:
        """``given`` (None: the defaults) as this model, of the plant of a described robot, has it.

        Raises :class:`InputError` naming settings that are given, neither their default nor 0, and that this model does not have.
        """
        if given is None or type(given) is cls:
            return given or cls()
        usual = type(given).model_fields
        changed = {n: v for n, v in given if v != usual[n].default and (v != 0 or n in cls.model_fields)}
        try:
            return cls.model_validate(changed)
        except ValidationError as error:
            unknown = ", ".join(f"plant.{e['loc'][0]}" for e in error.errors() if e["type"] == "extra_forbidden")
            if not unknown:
                raise
            raise InputError(
                f"{unknown}: the simulated robot '{description.name}' (base type '{description.base.type}') does not read it; "
                f"valid: {', '.join(sorted(cls.model_fields))}"
            ) from error

    @classmethod
    def none(cls, **changes: Any) -> Self:
        """A plant like the model, with perfect sensors; drives keep a lag of 20 ms. ``changes`` replace fields."""
        left = {n: v for kind in reversed(cls.__mro__) for n, v in getattr(kind, "LEFT", {}).items()}
        zero = {name: 0 for name, info in cls.model_fields.items() if not isinstance(info.default, BaseModel | str)}
        return cls(**{**zero, **left, **changes})

    def mount_offsets(self) -> tuple[float, float]:
        """Spreads [rad] of the zero errors of two encoders of each wheel, where a base type has such."""
        return self.joint_offset, 0.0

    def draw(self, rng: np.random.Generator, bodies: Collection[str], wheels: int, arm: int) -> PlantSample:
        """One plant: numbers for the named bodies, ``wheels`` driven wheels and ``arm`` joints.

        A spread that a base type's model does not have is 0, and its numbers are drawn nevertheless: what one seed draws of the others does
        not depend on the base type."""

        def around(spread: str, *size: int) -> Array:
            half = getattr(self, spread, 0.0)
            return rng.uniform(-half, half, size)

        def lag(size: int) -> Array:
            return self.actuator_time_constant * (1.0 + around("actuator_time_constant_spread", size))

        return PlantSample(
            mass={name: 1.0 + float(around("mass")) for name in bodies},
            inertia={name: 1.0 + float(around("inertia")) for name in bodies},
            com={name: around("com_offset", 3) for name in bodies},
            friction=float(rng.uniform(*self.friction)),
            radius=(1.0 + around("wheel_radius")) * (1.0 + around("wheel_radius_each", wheels)),
            mount_offset=np.array([rng.uniform(-half, half, wheels) for half in self.mount_offsets()]),
            arm_offset=around("joint_offset", arm),
            wheel_lag=lag(wheels),
            mount_lag=lag(wheels),
            arm_lag=lag(arm),
            gyro_bias=around("gyro_bias", 3),
            accel_bias=around("accel_bias", 3),
            # the last ones: the numbers before them are those of a level floor, and of drives that report nothing
            downhill=float(rng.uniform(-np.pi, np.pi)),
            effort_gain=1.0 + around("effort_gain", arm),
        )


class ArmPerturbation(Perturbation):
    """An arm that is driven by speeds. Not a spread but a value that the planner does not know of: ``payload`` [kg]: unknown mass at the
    tool, whose weight is not fed forward to the arm's drives."""

    payload: float = Field(default=0.0, ge=0, le=50)


class WheelRadii(Perturbation):
    """``wheel_radius_each``: relative error of the wheel radius, wheel by wheel; ``wheel_radius``: relative error of the wheel radius,
    common to all wheels."""

    wheel_radius: float = Field(default=0.0, ge=0, lt=0.2)
    wheel_radius_each: float = Field(default=0.002, ge=0, lt=0.2)


class InertialUnit(Perturbation):
    """An inertial unit of the order of an ADIS16448: ``gyro_noise`` [rad/s/√Hz]: noise density of
    the gyro; ``gyro_bias`` [rad/s]: bias of the gyro at the start; ``gyro_walk`` [rad/s/√s]: random walk of the gyro's bias;
    ``accel_noise`` [m/s²/√Hz]: density of the accelerometer's noise; ``accel_bias`` [m/s²]: bias of the accelerometer at the start;
    ``accel_walk`` [m/s²/√s]: random walk of the accelerometer's bias."""

    gyro_noise: float = Field(default=2e-4, ge=0, le=100)
    gyro_bias: float = Field(default=0.01, ge=0, le=100)
    gyro_walk: float = Field(default=2e-5, ge=0, le=100)
    accel_noise: float = Field(default=1e-3, ge=0, le=1000)
    accel_bias: float = Field(default=0.01, ge=0, le=1000)
    accel_walk: float = Field(default=3e-3, ge=0, le=1000)


class WheeledPerturbation(InertialUnit, WheelRadii, ArmPerturbation):
    """A robot on wheels. ``dry_friction`` [N m]: dry friction of wheel and steer joints (scrub and rolling loss); ``encoder_counts``:
    encoder counts per turn of wheel, steer and leg, 0: exact. Drives of the arm report their torques: ``effort_gain``: relative error of
    the torque that a drive reports, drive by drive; ``effort_noise``: standard deviation of the torque that a drive reports, over its
    limit, per message.

    Not spreads but values that the planner does not know of: ``body_payload`` [kg]: unknown mass on the body; ``slope`` [rad]: slope of
    the floor, in a random direction.
    """

    dry_friction: float = Field(default=2.0, ge=0, le=10000)
    encoder_counts: int = Field(default=2**14, ge=0, le=2**40)
    effort_gain: float = Field(default=0.03, ge=0, lt=1)
    effort_noise: float = Field(default=0.01, ge=0, le=1)
    body_payload: float = Field(default=0.0, ge=0, le=500)
    slope: float = Field(default=0.0, ge=0, le=0.5)


def perturbation_model(base_type_name: str) -> type[Perturbation]:
    """The perturbation of a base type's plants: its own model, or what all plants read."""
    kind = base_type(base_type_name).perturbation() or Perturbation
    if not (isinstance(kind, type) and issubclass(kind, Perturbation)):
        given = getattr(kind, "__name__", type(kind).__name__)
        raise InputError(f"base type '{base_type_name}': 'perturbation' gives '{given}', no wb.Perturbation")
    return kind


@dataclass(frozen=True)
class PlantSample:
    """The numbers of one plant: factors by body, shifts (3) [m] of centers of mass in the body's frame, and the rest
    as in :class:`Perturbation`, one entry per wheel or arm joint; lags are time constants [s]; ``mount_offset`` (2, n) [rad] and
    ``mount_lag`` (n): of two encoders and a drive that carry or turn each of n wheels, where there are such; ``downhill`` [rad]: the
    direction in which a slope falls."""

    mass: dict[str, float]
    inertia: dict[str, float]
    com: dict[str, Array]
    friction: float
    radius: Array
    mount_offset: Array
    arm_offset: Array
    wheel_lag: Array
    mount_lag: Array
    arm_lag: Array
    gyro_bias: Array
    accel_bias: Array
    downhill: float = 0.0
    effort_gain: Array = field(default_factory=lambda: np.ones(0))

    def apply_to_bodies(self, spec: mujoco.MjSpec, balanced: Collection[str] = ()) -> None:
        """Other masses, inertias and centers of mass of a specification, in place.

        Bodies that are ``balanced`` (wheels: they turn) keep their centers of mass. An inertia is scaled as a
        whole: scaling its moments one by one can break the triangle inequality.
        """
        nominal = spec.compile()
        for body in spec.bodies:
            name = body.name
            if name not in self.mass:
                continue
            b = nominal.body(name).id
            if nominal.body_mass[b] <= 0.0:
                continue
            body.explicitinertial = True
            body.fullinertia = np.full(6, np.nan)
            body.mass = float(nominal.body_mass[b]) * self.mass[name]
            body.inertia = nominal.body_inertia[b] * self.inertia[name]
            body.iquat = nominal.body_iquat[b]
            body.ipos = nominal.body_ipos[b] + (0.0 if name in balanced else self.com[name])


def quantize(values: Array, counts: int) -> Array:
    """Angles [rad] as an encoder with ``counts`` per turn reports them (0: exact)."""
    if counts == 0:
        return values
    step = 2.0 * np.pi / counts
    read: Array = np.rint(values / step) * step
    return read


def clipped(values: Array, limit: Array | float) -> Array:
    """``values`` within ± ``limit`` (``np.clip`` takes several times as long for few numbers)."""
    within: Array = np.minimum(np.maximum(values, -limit), limit)
    return within
