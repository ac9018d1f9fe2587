"""The library of compiled steps that controllers of several bases share."""

from __future__ import annotations

from wbmpc.kernel.library import Library

LIBRARY = Library("control", packages=("control", "kernel"), modules=("wbmpc.control.drive_step",))
step = LIBRARY.step
