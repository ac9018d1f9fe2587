"""How the simulated robot differs from the planner's model, and how its sensors and drives misbehave."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator

from wbmpc.configuration import kind_alone
from wbmpc.errors import InputError

Array = NDArray[np.float64]
_Friction = Annotated[float, Field(ge=0, le=100)]


class _Choice(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class RigidDrives(_Choice):
    """Drives without springs."""

    kind: Literal["rigid"] = "rigid"


class SeriesElasticDrives(_Choice):
    """Torque drives behind springs (:mod:`wbmpc.simulation.elastic_drives`). ``wheel_spring`` [N m/rad]: stiffness at the wheels;
    ``arm_spring`` [N m/rad]: stiffness at the arm's joints; ``wheel_rotor`` [kg m²]: a wheel drive's rotor, at the joint; ``arm_rotor``
    [kg m²]: an arm drive's rotor, at the joint; ``spring_damping``: damping ratio of the springs; ``torque_gain``: gain of the torque loop;
    ``torque_damping``: damping of the torque loop. Their figures are assumed: none are published."""

    kind: Literal["elastic"] = "elastic"
    wheel_spring: float = Field(default=40.0, gt=0, le=1e9)
    arm_spring: float = Field(default=300.0, gt=0, le=1e9)
    wheel_rotor: float = Field(default=0.010, gt=0, le=1000)
    arm_rotor: float = Field(default=0.050, gt=0, le=1000)
    spring_damping: float = Field(default=0.02, ge=0, le=2)
    torque_gain: float = Field(default=1.0, ge=0, le=20)
    torque_damping: float = Field(default=0.2, ge=0, le=2)


class SoundBrakes(_Choice):
    """Brakes that do what they are commanded to."""

    kind: Literal["none"] = "none"


class StuckBrake(_Choice):
    """A brake that stays open or closed. ``leg``: whose brake, the leg's place in the description, from 0; ``time`` [s]: from when on, of
    the plant, which stands for ``settle_time`` first."""

    kind: Literal["open", "closed"]
    leg: int = Field(default=0, ge=0, le=1000)
    time: float = Field(default=0.0, ge=0, le=1e6)


Drives = Annotated[RigidDrives | SeriesElasticDrives, Field(discriminator="kind"), BeforeValidator(kind_alone)]
BrakeFaults = Annotated[SoundBrakes | StuckBrake, Field(discriminator="kind"), BeforeValidator(kind_alone)]


class Perturbation(BaseModel):
    """Spreads of the differences between plant and model; each is drawn uniformly within ± its value, per seed.

    Each plant declares which of them it reads (:meth:`check_read`): asking it for another one is an error.

    ``mass``: relative error of the bodies' masses; ``inertia``: relative error of the bodies' inertias; ``com_offset`` [m]: shift of
    centers of mass, per axis; ``joint_offset`` [rad]: zero errors of the encoders of hinges and arm; ``steer_offset`` [rad]: zero
    errors of the steering encoders (measured = true + offset); ``wheel_radius_each``: relative error of the wheel radius, wheel by
    wheel; ``wheel_radius``: relative error of the wheel radius, common to all wheels.

    ``actuator_time_constant`` [s]: lag of the drives; ``actuator_time_constant_spread``: relative spread of the lag, drive by drive;
    ``dry_friction`` [N m]: dry friction of wheel and steer joints (scrub and rolling loss); ``brake_delay`` [s]: time that a brake
    takes to open and to close; ``friction``: coefficient of the floor, a range or one number; ``torsional_friction`` [m]: friction
    about the vertical of what rolls on the floor at one point, as torque over weight.

    ``encoder_jitter`` [s]: the values of a message are up to this old; ``encoder_counts``: encoder counts per turn of wheel, steer and
    leg, 0: exact; ``arm_counts``: encoder counts per turn of the arm's joints, 0: exact; ``steer_noise`` [rad]: standard deviation of
    the steering encoders per message. The inertial unit is of the order of an ADIS16448: ``gyro_noise`` [rad/s/√Hz]: noise density of
    the gyro; ``gyro_bias`` [rad/s]: bias of the gyro at the start; ``gyro_walk`` [rad/s/√s]: random walk of the gyro's bias;
    ``accel_noise`` [m/s²/√Hz]: density of the accelerometer's noise; ``accel_bias`` [m/s²]: bias of the accelerometer at the start;
    ``accel_walk`` [m/s²/√s]: random walk of the accelerometer's bias. An idealized state sensor has ``state_age`` [s]: age of the state
    sensor's message; ``position_noise`` [m]: noise of the state sensor's positions; ``angle_noise`` [rad]: noise of the state sensor's
    angles; ``speed_noise`` [m/s]: noise of the state sensor's speeds; ``rate_noise`` [rad/s]: noise of the state sensor's angular
    rates.

    Torque drives, and not spreads: ``actuator_dead_time`` [s]: dead time of the drives, whole physics steps; ``drives``: rigid, or elastic
    (:class:`SeriesElasticDrives`).

    Not spreads but values that the planner does not know of: ``payload`` [kg]: unknown mass at the tool, whose weight is not fed
    forward to the arm's drives; ``body_payload`` [kg]: unknown mass on the body; ``slope`` [rad]: slope of the floor, in a random
    direction; ``brake_fault``: none, or a brake that stays open or closed (:class:`StuckBrake`); ``floor_cables`` [m]: height of a grid
    of cables on the floor.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    mass: float = Field(default=0.05, ge=0, lt=0.5)
    inertia: float = Field(default=0.10, ge=0, lt=0.5)
    com_offset: float = Field(default=0.010, ge=0, le=1)
    joint_offset: float = Field(default=0.002, ge=0, le=3.2)
    steer_offset: float = Field(default=0.003, ge=0, le=3.2)
    wheel_radius: float = Field(default=0.0, ge=0, lt=0.2)
    wheel_radius_each: float = Field(default=0.002, ge=0, lt=0.2)
    actuator_time_constant: float = Field(default=0.020, ge=0, le=10)
    actuator_time_constant_spread: float = Field(default=0.30, ge=0, lt=1)
    actuator_dead_time: float = Field(default=0.0, ge=0, le=0.5)
    drives: Drives = RigidDrives()
    dry_friction: float = Field(default=2.0, ge=0, le=10000)
    brake_delay: float = Field(default=0.10, ge=0, le=100)
    friction: tuple[_Friction, _Friction] = (0.6, 0.9)
    torsional_friction: float = Field(default=0.01, ge=0, le=1)
    encoder_jitter: float = Field(default=0.002, ge=0, le=0.5)
    encoder_counts: int = Field(default=2**14, ge=0, le=2**40)
    arm_counts: int = Field(default=2**17, ge=0, le=2**40)
    steer_noise: float = Field(default=0.0, ge=0, le=3.2)
    gyro_noise: float = Field(default=2e-4, ge=0, le=100)
    gyro_bias: float = Field(default=0.01, ge=0, le=100)
    gyro_walk: float = Field(default=2e-5, ge=0, le=100)
    accel_noise: float = Field(default=1e-3, ge=0, le=1000)
    accel_bias: float = Field(default=0.01, ge=0, le=1000)
    accel_walk: float = Field(default=3e-3, ge=0, le=1000)
    state_age: float = Field(default=0.005, ge=0, le=1.0)
    position_noise: float = Field(default=1e-3, ge=0, le=100)
    angle_noise: float = Field(default=2e-3, ge=0, le=3.2)
    speed_noise: float = Field(default=0.01, ge=0, le=100)
    rate_noise: float = Field(default=0.02, ge=0, le=100)
    payload: float = Field(default=0.0, ge=0, le=50)
    body_payload: float = Field(default=0.0, ge=0, le=500)
    slope: float = Field(default=0.0, ge=0, le=0.5)
    brake_fault: BrakeFaults = SoundBrakes()
    floor_cables: float = Field(default=0.0, ge=0, le=0.02)

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

    def is_set(self, name: str) -> bool:
        """Whether a setting is given: it is neither its default nor 0."""
        return getattr(self, name) not in (0, type(self).model_fields[name].default)

    def check_read(self, reads: Collection[str], reason: str, reasons: Mapping[str, str]) -> None:
        """Raise :class:`InputError` for the first setting that is given (:meth:`is_set`) and that a plant does not read, with the
        reason of this setting, or the one of all others."""
        for name in type(self).model_fields:
            if name not in reads and self.is_set(name):
                raise InputError(f"plant.{name}: {reasons.get(name, reason)}")

    @classmethod
    def none(cls, **changes: Any) -> Perturbation:
        """A plant like the model, with perfect sensors; drives keep a lag of 20 ms. ``changes`` replace fields."""
        kept = {"actuator_time_constant": 0.020, "friction": 0.8, "torsional_friction": 0.01}
        zero = {name: 0 for name, info in cls.model_fields.items() if not isinstance(info.default, BaseModel)}
        return cls(**{**zero, **kept, **changes})

    def draw(self, rng: np.random.Generator, bodies: Collection[str], wheels: int, arm: int) -> PlantSample:
        """One plant: numbers for the named bodies, ``wheels`` driven wheels (modules) and ``arm`` joints."""

        def around(spread: float, *size: int) -> Array:
            return rng.uniform(-spread, spread, size)

        def lag(size: int) -> Array:
            return self.actuator_time_constant * (1.0 + around(self.actuator_time_constant_spread, size))

        return PlantSample(
            mass={name: 1.0 + float(around(self.mass)) for name in bodies},
            inertia={name: 1.0 + float(around(self.inertia)) for name in bodies},
            com={name: around(self.com_offset, 3) for name in bodies},
            friction=float(rng.uniform(*self.friction)),
            radius=(1.0 + around(self.wheel_radius)) * (1.0 + around(self.wheel_radius_each, wheels)),
            leg_offset=around(self.joint_offset, wheels),
            steer_offset=around(self.steer_offset, wheels),
            arm_offset=around(self.joint_offset, arm),
            wheel_lag=lag(wheels),
            steer_lag=lag(wheels),
            arm_lag=lag(arm),
            gyro_bias=around(self.gyro_bias, 3),
            accel_bias=around(self.accel_bias, 3),
            # the last one: the numbers before it are those of a level floor
            downhill=float(rng.uniform(-np.pi, np.pi)),
        )


@dataclass(frozen=True)
class PlantSample:
    """The numbers of one plant: factors by body, shifts (3) [m] of centers of mass in the body's frame, and the rest
    as in :class:`Perturbation`, one entry per wheel or arm joint; lags are time constants [s]; ``downhill`` [rad]: the
    direction in which a slope falls."""

    mass: dict[str, float]
    inertia: dict[str, float]
    com: dict[str, Array]
    friction: float
    radius: Array
    leg_offset: Array
    steer_offset: Array
    arm_offset: Array
    wheel_lag: Array
    steer_lag: Array
    arm_lag: Array
    gyro_bias: Array
    accel_bias: Array
    downhill: float = 0.0

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
