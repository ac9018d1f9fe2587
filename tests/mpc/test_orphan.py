"""The MPC's process without its parent. Truth: the kernel's list of processes after a real SIGKILL."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from realtime_toys import wait_for

PARENT = """
import os, threading, time
from functools import partial
from realtime_toys import ToyController, ToyRobot, make_mpc, problem
from wbmpc import RealTimeRunner, RealTimeSettings, WallClock
from wbmpc.runtime.shared_memory import Sizes

def main():
    clock = WallClock()
    settings = RealTimeSettings(max_observation_age=60.0, watchdog=60.0, max_policy_age=60.0)
    runner = RealTimeRunner(ToyRobot(clock), ToyController(1 / 400), make_mpc, settings, clock, sizes=Sizes.of(problem()))
    starter = threading.Thread(target=runner.start)  # a thread that has ended is no parent that has
    starter.start()
    starter.join()
    while runner.board["updates"] < 5:
        time.sleep(0.01)
    if os.fork() == 0:  # another child, which holds all that the parent has open
        time.sleep(8.0)
        os._exit(0)
    print(runner.process_id, flush=True)
    while True:
        time.sleep(1.0)
        print(int(runner.board["updates"]), flush=True)

if __name__ == "__main__":
    main()
"""


def runs(process: int) -> bool:
    """Whether it is there, and not only its entry (a container may have nobody who takes it away)."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.wallclock
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
def test_it_ends_when_the_parent_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    path = os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])
    environment = {**os.environ, "PYTHONPATH": path}
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, env=environment, text=True) as parent:
        try:
            assert parent.stdout is not None
            child = int(parent.stdout.readline())
            solved = int(parent.stdout.readline())  # a second after the thread that started it has ended
            assert runs(child) and solved > 5
            os.kill(parent.pid, signal.SIGKILL)
            parent.wait()
            start = time.perf_counter()
            assert wait_for(lambda: not runs(child), 5.0)
            assert time.perf_counter() - start < 2.0  # 0.25 s; more on a busy machine
        finally:
            parent.kill()
            with suppress(ProcessLookupError, UnboundLocalError):
                os.kill(child, signal.SIGKILL)
