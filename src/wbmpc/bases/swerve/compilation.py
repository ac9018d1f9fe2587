"""The library of the swerve robot's compiled steps."""

from __future__ import annotations

from wbmpc.kernel.library import Library

_STEPS = (
    "odometry_step", "kalman_step", "slip_step", "inertial_velocity", "brake_monitor", "tracking_step", "rolling",
)  # fmt: skip
LIBRARY = Library(
    "swerve robot",
    packages=("bases/swerve", "kernel", "constants.py"),
    modules=tuple(f"wbmpc.bases.swerve.{m}" for m in _STEPS),
)
compiled, step = LIBRARY.compiled, LIBRARY.step
