"""MuJoCo's warnings go to the log: by itself it writes them into a file in the working directory."""

from __future__ import annotations

import logging

import mujoco

_LOG = logging.getLogger(__name__)


def log_warnings() -> None:
    """Log MuJoCo's warnings from now on, in this process."""
    mujoco.set_mju_user_warning(lambda text: _LOG.warning("MuJoCo: %s", text))
