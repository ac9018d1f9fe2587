"""The library of compiled nearest points."""

from __future__ import annotations

from wbmpc.kernel.library import Library

_STEPS = ("support_step", "simplex_step", "pairs_step", "depth_step", "grid_step", "own_pairs", "plan_step")
LIBRARY = Library(
    "nearest points", packages=("clearance", "kernel"), modules=tuple(f"wbmpc.clearance.{m}" for m in _STEPS)
)
compiled, step = LIBRARY.compiled, LIBRARY.step
