"""Does a browser slow the 400 Hz loop of a run with a live view? One run of the real-time runner, by the wall clock, in parts:
without a view's client; with a client that unpacks all that a browser gets but draws nothing; with headless Chromium that draws;
with one that hangs (connected, stopped); after it was killed. Prints how late ticks began, what watching cost in the control
thread, and the ratios to the first part.

    python benchmarks/view_lateness.py [--seconds 15] [--robot swerve-ur10] [--anywhere] [--fifo] [--json FILE]

The machine that this was made on has two cores and no graphics: Chromium then draws in software, which takes more than a core
of its own. So controller and MPC get the first core; physics, the view's server, client and browser share the others, the
browser with the least priority, as a laptop's graphics processor would take its work away. ``--anywhere``: no pinning;
``--fifo``: controller, MPC and physics before all other processes (for machines that others use too).
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.ocp import Reference
from wbmpc.runtime.runner import RealTimeRunner
from wbmpc.view.realtime import RealtimeView
from wbmpc.view.session import runner_of

FLAGS = [
    "--headless=new", "--no-sandbox", "--no-first-run", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--disable-dev-shm-usage", "--window-size=1000,700", "--disable-background-networking",
]  # fmt: skip
PARTS = ("alone", "client", "browser", "hangs", "killed")
#: Seconds of each part that do not count: a browser starts.
SETTLING = 5.0
#: A tick that begins later than this [s] is late.
LATE = 1e-3


class Measured(RealtimeView):
    """A view that notes how late each tick began, and what watching it cost [s]."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.late: list[float] = []
        self.cost: list[float] = []

    def watch(self, t: float, late: float, plans: PolicyQueue) -> None:
        """The view's own, measured."""
        start = time.perf_counter()
        super().watch(t, late, plans)
        self.cost.append(time.perf_counter() - start)
        self.late.append(late)


class Guests:
    """Clients and browsers: processes of their own, on the cores ``cores`` (None: anywhere)."""

    def __init__(self, url: str, cores: set[int] | None) -> None:
        self.url, self.cores, self.profile = url, cores, tempfile.mkdtemp()
        self.process: subprocess.Popen[bytes] | None = None

    def _place(self) -> None:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.nice(19)
        if self.cores is not None:
            os.sched_setaffinity(0, self.cores)

    def change(self, part: str, seconds: float) -> None:
        """What a part begins with."""
        if part == "client":
            script = Path(__file__).with_name("view_client.py")
            self._start([sys.executable, str(script), self.url, "--seconds", str(seconds)])
        elif part == "browser":
            self.stop()
            browser = shutil.which("chromium") or shutil.which("chromium-browser") or "chromium"
            self._start([browser, *FLAGS, f"--user-data-dir={self.profile}", self.url])
        elif part == "hangs" and self.process is not None:
            os.killpg(self.process.pid, signal.SIGSTOP)
        elif part == "killed":
            self.stop()

    def _start(self, command: list[str]) -> None:
        self.process = subprocess.Popen(
            command, process_group=0, preexec_fn=self._place, stdout=sys.stderr, stderr=subprocess.DEVNULL
        )

    def stop(self) -> None:
        """End the process and its children."""
        if self.process is not None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
            self.process = None


def measure(view: Measured, runner: RealTimeRunner, guests: Guests, seconds: float) -> dict[str, dict[str, float]]:
    """All parts, one after another."""
    found = {}
    for part in PARTS:
        guests.change(part, seconds)
        time.sleep(SETTLING)
        first, previous = len(view.late), cpu(view.process.pid)
        time.sleep(seconds - SETTLING)
        if runner.stopped:
            raise SystemExit(runner.state)
        late, cost = np.array(view.late[first:]), 1e6 * np.array(view.cost[first:])
        found[part] = {
            "late over 1 ms [%]": float(100.0 * np.mean(late > LATE)),
            "late: median [us]": float(1e6 * np.median(late)),
            "late: 99 % [us]": float(1e6 * np.percentile(late, 99)),
            "watching: mean [us]": float(cost.mean()),
            "server's processor time [%]": 100.0 * (cpu(view.process.pid) - previous) / (seconds - SETTLING),
        }
    return found


def circle(runner: RealTimeRunner, seconds: float) -> None:
    """The end effector goes round and round, so that there is something to see."""
    mpc: Any = runner.mpc
    home, t = mpc.reference["end_effector"].values[0], np.arange(0.0, seconds, 0.05)
    around = np.stack([np.cos(t) - 1.0, np.sin(t), 0.0 * t], axis=1)
    mpc.reference["end_effector"] = Reference.poses(t, home[:3] + 0.06 * around, home[3:])


def cpu(pid: int) -> float:
    """Processor time [s] that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Run, print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=15.0, help="of each part")
    parser.add_argument("--robot", default="swerve-ur10", choices=("swerve-ur10", "rezero"))
    parser.add_argument("--anywhere", action="store_true", help="every process on any core")
    parser.add_argument("--fifo", action="store_true", help="real-time priority for controller, MPC and physics")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    given = parser.parse_args()
    if given.seconds <= SETTLING:
        parser.error(f"--seconds: must be more than {SETTLING:g}")
    first, *others = sorted(os.sched_getaffinity(0))
    apart = bool(others) and not given.anywhere
    view = Measured("lateness", given.robot, "127.0.0.1", 8093)
    runner, robot = runner_of(given.robot, 1, view)
    circle(runner, (len(PARTS) + 1) * given.seconds)
    guests = Guests(view.url, set(others) if apart else None)
    if apart:
        os.sched_setaffinity(0, {first})
        for pid in (robot.process.pid, view.process.pid):
            os.sched_setaffinity(pid, set(others))
    if given.fifo:
        for pid in (0, robot.process.pid):
            os.sched_setscheduler(pid, os.SCHED_FIFO, os.sched_param(5 if pid else 10))
    gc.collect()
    gc.freeze()
    try:
        with runner:
            found = measure(view, runner, guests, given.seconds)
    finally:
        guests.stop()
        robot.close()
        view.close()
    where = "controller and MPC on a core of their own" if apart else "every process on any core"
    print(f"{given.robot}, {len(others) + 1} cores, {where}, load {os.getloadavg()[0]:.2f} at the end")
    print(f"{'part':10s}" + "".join(f"{key:>30s}" for key in found["alone"]))
    for name, row in found.items():
        print(f"{name:10s}" + "".join(f"{value:30.2f}" for value in row.values()))
    if given.json is not None:
        given.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
