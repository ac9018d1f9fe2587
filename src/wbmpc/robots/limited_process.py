"""A program for a file from outside, in a process of its own with limits of time and memory.

What C code does holds up signals of its process. The parent only waits: Ctrl-C and SIGTERM end both at once, and the program ends
with its parent.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

#: Of the processor [s] for the program's work: with what its parent does then, a command stays below 10 s. Of the clock in all, for
#: what waits; a busy computer, which gives a study at low priority a twentieth of a processor, is no fault of a model.
PROCESSOR, CLOCK = 2.0, 120.0
_PROGRAM = Path(__file__).with_name("limited_program.py")


class OutOfTime(Exception):
    """The program has been ended at the limit that the message names."""


def run_limited(order: Mapping[str, Any], clock: float = CLOCK) -> dict[str, Any]:
    """The answer of :mod:`wbmpc.robots.limited_program` to an order; ``{"error": …}`` where it ended without one.

    ``clock``: how long it may take [s]. Raises :class:`OutOfTime`.
    """
    command = [sys.executable, "-P", str(_PROGRAM)]
    text = json.dumps({**order, "processor": PROCESSOR, "parent": os.getpid()})
    try:
        run = subprocess.run(command, input=text, capture_output=True, text=True, timeout=clock)
    except subprocess.TimeoutExpired:
        raise OutOfTime(f"{clock:g} s") from None
    if run.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        raise OutOfTime(f"{PROCESSOR:g} s of the processor")
    try:
        return dict(json.loads(run.stdout))
    except ValueError:  # it has been ended, or memory was not enough
        return {"error": (run.stderr.strip().splitlines() or [f"exit status {run.returncode}"])[-1]}
