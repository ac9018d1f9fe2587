"""MuJoCo without GLFW where there is no screen: there it could not draw, and to look for it MuJoCo's import starts a process, which takes
as long as the rest of it. What renders without a screen (:mod:`wbmpc.simulation.render`) chooses EGL."""

from __future__ import annotations

import os
import platform
import sys

#: The variable by which MuJoCo chooses its OpenGL when it is imported.
OPENGL = "MUJOCO_GL"


def without_screen() -> bool:
    """Whether windows cannot be opened, as far as the environment says."""
    return platform.system() == "Linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


if without_screen() and OPENGL not in os.environ and "mujoco" not in sys.modules:
    os.environ[OPENGL] = "disable"
    try:
        import mujoco  # noqa: F401
    finally:
        del os.environ[OPENGL]
