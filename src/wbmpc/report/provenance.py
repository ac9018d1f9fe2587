"""What a run is of: versions, the commit, the processor."""

from __future__ import annotations

import platform
import subprocess
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from wbmpc import __version__

#: The package's directory.
PACKAGE = Path(__file__).parents[1]


def versions() -> dict[str, str]:
    """What ran: versions of this library and of what it stands on, and the processor."""
    out = {
        "wbmpc": __version__, "commit": commit(), "python": platform.python_version(), "machine": platform.machine(),
        "cpu": _processor(),
    }  # fmt: skip
    for name in ("casadi", "mujoco", "llvmlite", "numpy", "scipy"):
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            out[name] = "unknown"
    return out


@cache
def commit() -> str:
    """The commit of this checkout, short, with ``+`` behind it if files differ from it; ``""`` for an installed package.

    It is looked up once per process: documents name the commit that a figure is of.
    """
    try:
        revision, changed = (
            subprocess.run(
                ["git", "--no-optional-locks", "-C", str(PACKAGE), *words], capture_output=True, text=True, check=True,
                timeout=10,
            ).stdout.strip()
            for words in (("rev-parse", "--short=10", "HEAD"), ("status", "--porcelain", "--untracked-files=no", "."))
        )  # fmt: skip
        tracked = subprocess.run(
            ["git", "--no-optional-locks", "-C", str(PACKAGE), "ls-files", "--error-unmatch", "__init__.py"],
            capture_output=True,
            timeout=10,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return "" if tracked.returncode else revision + "+" * bool(changed)


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next(
        (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.processor()
    )
