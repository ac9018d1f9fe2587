"""Which perturbations the plants of robots on fixed wheels read."""

from __future__ import annotations

from wbmpc.simulation.perturbation import Perturbation

#: Settings of :class:`Perturbation` that these plants read.
READS = frozenset(
    {
        "mass", "inertia", "com_offset", "joint_offset", "wheel_radius", "wheel_radius_each", "actuator_time_constant",
        "actuator_time_constant_spread", "dry_friction", "friction",
        "encoder_jitter", "encoder_counts", "arm_counts", "gyro_noise", "gyro_bias", "gyro_walk", "accel_noise",
        "accel_bias", "accel_walk", "effort_gain", "effort_noise", "payload", "body_payload", "slope",
    }
)  # fmt: skip


def check_perturbation(perturbation: Perturbation) -> None:
    """Raise :class:`InputError` for a setting that these plants do not read."""
    reason = f"a robot on wheels that are fixed to the body does not read it; valid: {', '.join(sorted(READS))}"
    perturbation.check_read(READS, reason, {})
