"""The library of the ball robot's compiled steps."""

from __future__ import annotations

from wbmpc.kernel.library import Library

_STEPS = (
    "filter_step",
    "filter_solve",
    "joint_step",
    "torque_step",
    "monitor_step",
    "sensor_step",
    "payload_step",
    "lean_step",
)
LIBRARY = Library("ball robot", rooms=("bases/ball", "kernel"), modules=tuple(f"wbmpc.bases.ball.{m}" for m in _STEPS))
compiled, step = LIBRARY.compiled, LIBRARY.step
