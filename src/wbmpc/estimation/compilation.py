"""The library of the estimators' compiled steps."""

from __future__ import annotations

from wbmpc.kernel.library import Library

LIBRARY = Library("estimators", rooms=("estimation", "kernel"), modules=("wbmpc.estimation.odometry_step",))
compiled, step = LIBRARY.compiled, LIBRARY.step
