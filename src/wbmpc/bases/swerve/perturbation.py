"""Which perturbations the plant of swerve robots reads."""

from __future__ import annotations

from wbmpc.simulation.perturbation import Perturbation

#: Settings of :class:`Perturbation` that this plant reads.
READS = frozenset(
    {
        "mass", "inertia", "com_offset", "joint_offset", "steer_offset", "wheel_radius", "wheel_radius_each",
        "actuator_time_constant", "actuator_time_constant_spread", "dry_friction", "brake_delay", "friction", "encoder_jitter",
        "encoder_counts", "arm_counts", "steer_noise", "gyro_noise", "gyro_bias", "gyro_walk", "accel_noise",
        "accel_bias", "accel_walk", "effort_gain", "effort_noise", "payload", "body_payload", "slope", "brake_fault",
    }
)  # fmt: skip
_SENSORS = (
    "is for ball robots only; a swerve robot has encoders and an inertial unit: 'plant.encoder_jitter', 'plant.steer_noise', "
    "'plant.gyro_noise'"
)
_DRIVES = "is for ball robots only; a swerve robot's drives have 'plant.actuator_time_constant'"
#: What a swerve robot has in the place of others.
INSTEAD = {
    "floor_cables": "is for ball robots only; swerve-drive and swerve-plaster have their own",
    "torsional_friction": "is for ball robots only; a swerve robot's wheels hold the floor by 'plant.friction' alone",
    **dict.fromkeys(("actuator_dead_time", "drives"), _DRIVES),
    **dict.fromkeys(("state_age", "position_noise", "angle_noise", "speed_noise", "rate_noise"), _SENSORS),
}


def check_perturbation(perturbation: Perturbation) -> None:
    """Raise :class:`InputError` for a setting that this plant does not read."""
    perturbation.check_read(READS, "is for ball robots only", INSTEAD)
