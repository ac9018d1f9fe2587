"""The library of what compiled code does in a physics step."""

from __future__ import annotations

from wbmpc.kernel.library import Library

_STEPS = ("arm", "contacts", "scene", "speed_torque")
LIBRARY = Library(
    "simulation", packages=("simulation", "kernel"), modules=tuple(f"wbmpc.simulation.{m}" for m in _STEPS)
)
step = LIBRARY.step
