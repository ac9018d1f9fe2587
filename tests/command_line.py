"""The command line for tests: called in this process, with an experiment that takes no time, and in one of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from fake_experiment import REGISTRY
from wbmpc.cli import main

HERE = Path(__file__).parent


def call(*arguments: str) -> int:
    return main(list(arguments), REGISTRY)


def shell(*arguments: str, code: str | None = None) -> subprocess.CompletedProcess[str]:
    """A process of its own, as a user starts it."""
    paths = os.pathsep.join([str(HERE.parent / "src"), str(HERE)])
    command = [sys.executable, *(["-c", code] if code else ["-m", "wbmpc"]), *arguments]
    return subprocess.run(command, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": paths}, timeout=300)


FAKE_MAIN = (
    "import sys; from fake_experiment import REGISTRY; from wbmpc.cli import main; sys.exit(main(None, REGISTRY))"
)
