"""The library of the estimators' compiled steps."""

from __future__ import annotations

from wbmpc.kernel.library import Library

_STEPS = ("odometry_step", "disturbance_step", "inertial_gate_step")
LIBRARY = Library(
    "estimators", packages=("estimation", "kernel"), modules=tuple(f"wbmpc.estimation.{m}" for m in _STEPS)
)
compiled, step = LIBRARY.compiled, LIBRARY.step
