"""Which perturbations the plant of ball robots reads."""

from __future__ import annotations

from wbmpc.simulation.perturbation import Perturbation

#: Settings of :class:`Perturbation` that this plant reads.
READS = frozenset(
    {
        "mass", "inertia", "com_offset", "joint_offset", "wheel_radius", "wheel_radius_each", "actuator_time_constant",
        "actuator_time_constant_spread", "actuator_dead_time", "drives", "friction", "torsional_friction", "encoder_jitter",
        "arm_counts", "gyro_noise", "gyro_bias", "gyro_walk", "accel_noise", "accel_bias", "accel_walk",
        "state_age", "position_noise", "angle_noise", "speed_noise", "rate_noise", "floor_cables",
    }
)  # fmt: skip
#: What a ball robot has in the place of others.
INSTEAD = {
    "brake_fault": "is for swerve robots only; a ball robot has no brakes",
    "payload": "is for swerve robots only; a ball robot's mass at the end effector is 'payload'",
}


def check_perturbation(perturbation: Perturbation) -> None:
    """Raise :class:`InputError` for a setting that this plant does not read."""
    perturbation.check_read(READS, "is for swerve robots only", INSTEAD)
