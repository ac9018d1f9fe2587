"""How a simulated ball robot differs from the planner's model."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from wbmpc.configuration import OneOf
from wbmpc.simulation.perturbation import Choice, InertialUnit, WheelRadii


class RigidDrives(Choice):
    """Drives without springs."""

    kind: Literal["rigid"] = "rigid"


class SeriesElasticDrives(Choice):
    """Torque drives behind springs (:mod:`wbmpc.bases.ball.elastic_drives`). ``wheel_spring`` [N m/rad]: stiffness at the wheels;
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


Drives = OneOf[RigidDrives | SeriesElasticDrives]


class StateNoise(Choice):
    """Of an idealized sensor of the state. ``position_noise`` [m]: noise of the state sensor's positions; ``angle_noise`` [rad]: noise of
    the state sensor's angles; ``speed_noise`` [m/s]: noise of the state sensor's speeds; ``rate_noise`` [rad/s]: noise of the state
    sensor's angular rates."""

    position_noise: float = Field(default=1e-3, ge=0, le=100)
    angle_noise: float = Field(default=2e-3, ge=0, le=3.2)
    speed_noise: float = Field(default=0.01, ge=0, le=100)
    rate_noise: float = Field(default=0.02, ge=0, le=100)


class BallHardware(InertialUnit, WheelRadii):
    """Torque drives: ``actuator_dead_time`` [s]: dead time of the drives, whole physics steps; ``drives``: rigid, or elastic
    (:class:`SeriesElasticDrives`). ``torsional_friction`` [m]: friction about the vertical of what rolls on the floor at one point, as
    torque over weight; ``floor_cables`` [m]: height of a grid of cables on the floor; ``state_age`` [s]: age
    of the messages."""

    LEFT: ClassVar[dict[str, float]] = {"torsional_friction": 0.01}

    actuator_dead_time: float = Field(default=0.0, ge=0, le=0.5)
    drives: Drives = RigidDrives()
    torsional_friction: float = Field(default=0.01, ge=0, le=1)
    state_age: float = Field(default=0.005, ge=0, le=1.0)
    floor_cables: float = Field(default=0.0, ge=0, le=0.02)


class BallPerturbation(StateNoise, BallHardware):
    """The robot with its sensors, and an idealized sensor of its state beside them."""
