"""What MuJoCo does beside the simulation, for the whole process."""

from __future__ import annotations

import ctypes
import logging
from contextlib import suppress

import mujoco

_LOG = logging.getLogger(__name__)


def log_warnings() -> None:
    """Log MuJoCo's warnings from now on, in this process: by itself it writes them into a file in the working directory."""
    mujoco.set_mju_user_warning(lambda text: _LOG.warning("MuJoCo: %s", text))


def stop_timers() -> None:
    """MuJoCo times its own parts no more, in this process: it reads the clock dozens of times in a physics step, for ``MjData.timer``."""
    # (set_mjcb_time(None) puts the clock of MuJoCo's Python package back in place)
    with suppress(OSError, ValueError):  # a build that does not export it keeps its timers
        ctypes.c_void_p.in_dll(ctypes.CDLL(mujoco._functions.__file__), "mjcb_time").value = None
