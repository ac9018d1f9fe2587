"""The library of compiled maps."""

from __future__ import annotations

from wbmpc.clearance import compilation
from wbmpc.kernel.library import Library

_STEPS = ("distances", "rays_step", "local_map")
LIBRARY = Library(
    "maps", packages=("mapping", "clearance", "kernel"), modules=tuple(f"wbmpc.mapping.{m}" for m in _STEPS),
    uses=(compilation.LIBRARY,),
)  # fmt: skip
compiled = LIBRARY.compiled
