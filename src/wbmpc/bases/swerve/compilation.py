"""The library of the swerve robot's compiled steps."""

from __future__ import annotations

from wbmpc.kernel.library import Library

LIBRARY = Library("swerve robot", rooms=("bases/swerve", "kernel"), modules=("wbmpc.bases.swerve.tracking_step",))
compiled, step = LIBRARY.compiled, LIBRARY.step
