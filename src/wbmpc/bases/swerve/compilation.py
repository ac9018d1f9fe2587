"""The library of the swerve robot's compiled steps."""

from __future__ import annotations

from wbmpc.control.compilation import LIBRARY as CONTROL
from wbmpc.kernel.library import Library

_STEPS = ("slip_step", "inertial_step", "brake_step", "tracking_step", "smooth_step")
LIBRARY = Library(
    "swerve robot",
    packages=("bases/swerve", "control", "kernel"),
    modules=tuple(f"wbmpc.bases.swerve.{m}" for m in _STEPS),
    uses=(CONTROL,),
)
compiled, step = LIBRARY.compiled, LIBRARY.step
