"""Does a browser slow the 400 Hz loop of a run with a live view? One run, by the wall clock, in parts: without a browser,
with headless Chromium that draws it, with one that hangs (connected, stopped), and after it was killed. Prints how late
ticks began and what watching cost in the run's own thread, by part, and the ratios to the first part.

    python benchmarks/view_lateness.py [--seconds 15] [--robot swerve-ur10]

The loop and the browser share the machine: with software rendering a browser takes a core of its own. That the loop is late
for want of a core shows in part "busy": no browser, and a process that takes a core as the browser does.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from typing import Any

import numpy as np

from wbmpc.loop import Ending, Running, Watch, run_lockstep
from wbmpc.model import load_robot
from wbmpc.mpc import Plans
from wbmpc.view import session
from wbmpc.view.live import View

FLAGS = [
    "--headless=new", "--no-sandbox", "--no-first-run", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--disable-dev-shm-usage", "--window-size=1000,700", "--disable-background-networking",
]  # fmt: skip
PARTS = ("alone", "busy", "browser", "hangs", "killed")
#: Seconds of each part that do not count: a browser starts.
SETTLING = 4.0


class Parts:
    """A watcher that begins the parts and says which ticks belong to them."""

    def __init__(self, view: View, seconds: float) -> None:
        self.view, self.seconds, self.part = view, seconds, -1
        self.ticks: dict[str, list[int]] = {name: [] for name in PARTS}
        self.helper: subprocess.Popen[bytes] | None = None
        self.profile = tempfile.mkdtemp()

    def begin(self, running: Running) -> None: ...

    def tick(self, t: float, command: Any, plans: Plans) -> None:
        """Change the part when it is time."""
        part = min(int(t / self.seconds), len(PARTS) - 1)
        if part != self.part:
            self.part = part
            self.change(PARTS[part])
        if t - part * self.seconds > SETTLING:
            self.ticks[PARTS[part]].append(len(self.view.lateness) - 1)

    def change(self, name: str) -> None:
        """What each part begins with."""
        if name == "busy":
            self.helper = subprocess.Popen([sys.executable, "-c", "while True: pass"], start_new_session=True)
        elif name == "browser":
            self.stop()
            browser = shutil.which("chromium") or shutil.which("chromium-browser") or "chromium"
            command = [browser, *FLAGS, f"--user-data-dir={self.profile}", self.view.url]
            quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
            self.helper = subprocess.Popen(command, start_new_session=True, **quiet)  # type: ignore[call-overload]
        elif name == "hangs" and self.helper is not None:
            os.killpg(self.helper.pid, signal.SIGSTOP)
        elif name == "killed":
            self.stop()

    def stop(self) -> None:
        """End the helper and its children."""
        if self.helper is not None:
            os.killpg(self.helper.pid, signal.SIGKILL)
            self.helper.wait()
            self.helper = None

    def end(self, ending: Ending) -> None:
        self.stop()


def main() -> None:
    """Run, print a table and one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=15.0, help="of each part")
    parser.add_argument("--robot", default="swerve-ur10", choices=("swerve-ur10", "rezero"))
    given = parser.parse_args()
    view = View("lateness", port=8093)
    parts = Parts(view, given.seconds)
    make = session._ball if given.robot == "rezero" else session._swerve
    plant, agent, mpc, timing = make(load_robot(given.robot), 1)
    watch = Watch(None, (view, parts))
    try:
        run_lockstep(plant, agent, mpc, timing, len(PARTS) * given.seconds, lambda *_: None, watch)
    finally:
        parts.stop()
        view.close()
    late, own = 1e3 * np.array(view.lateness), 1e6 * np.array(view.own_time)
    found = {}
    for name, ticks in parts.ticks.items():
        here = np.array(ticks)
        found[name] = {
            "late over 1 ms [%]": float(100.0 * np.mean(late[here] > 1.0)),
            "99 % late by [ms]": float(np.percentile(late[here], 99)),
            "watching, median [us]": float(np.median(own[here])),
            "watching, 99 % [us]": float(np.percentile(own[here], 99)),
        }
    print(f"{'part':10s}" + "".join(f"{key:>24s}" for key in found["alone"]))
    for name, row in found.items():
        print(f"{name:10s}" + "".join(f"{value:24.2f}" for value in row.values()))
    print(json.dumps(found))


if __name__ == "__main__":
    main()
