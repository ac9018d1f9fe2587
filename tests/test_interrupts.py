"""Ctrl-C in a terminal goes to all processes of a command. Truth: what the system's signals do to real processes, and the mask that
a thread has while it starts one, which the process inherits."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from multiprocessing.process import BaseProcess
from typing import Any

import casadi as ca
import numpy as np
import pytest

from interrupting import in_time, interrupted
from realtime_toys import make_mpc
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.runtime.clock import WallClock
from wbmpc.runtime.process import start_process
from wbmpc.runtime.shared_memory import Board, Mailbox
from wbmpc.simulation.lockstep import interrupt_noted
from wbmpc.types import Observation

#: The first process of a program: that which keeps account of shared memory starts with it.
STARTS = """
import multiprocessing, os, signal, time
from wbmpc.interrupts import interrupts_blocked
if __name__ == "__main__":
    process = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(0.1,))
    with interrupts_blocked():
        process.start()
    signal.signal(signal.SIGINT, lambda number, frame: print("heard", flush=True))
    os.killpg(0, signal.SIGINT)
    process.join()
    print("exit code", process.exitcode)
"""


def test_a_process_takes_no_interrupt_from_its_first_instruction_on(tmp_path: Any) -> None:
    (tmp_path / "starts.py").write_text(STARTS)
    run = [sys.executable, str(tmp_path / "starts.py")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(run, env=environment, capture_output=True, text=True, start_new_session=True, timeout=120.0)
    assert (done.stdout, done.stderr) == ("heard\nexit code 0\n", "")


def view_process() -> None:
    pytest.importorskip("viser")
    from wbmpc.view.core import Window
    from wbmpc.view.realtime import scene_of
    from wbmpc.view.user_commands import Controls

    window = Window("test", "127.0.0.1", 8080, lambda url: None)
    window.start(scene_of(load_robot("panda"))[1].scene, Controls("test", (), False, False), {"x": ()})


def physics_process() -> None:
    physics = pytest.importorskip("wbmpc.view.physics")
    box = Observation(0.0, np.zeros(2))  # any message
    physics.Simulated(lambda: None, box, box, WallClock(), None)


def mpc_process() -> None:
    box, board = Mailbox.shared({"x": ()}), Board.shared(("ready",))
    start_process(make_mpc, box, box, board, board, 0.0, None)


class _Started(Exception):
    pass


@pytest.mark.parametrize("start", [view_process, physics_process, mpc_process])
def test_processes_of_a_command_start_with_interrupts_blocked(
    start: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    masks = []

    def started(process: BaseProcess) -> None:
        masks.append(signal.pthread_sigmask(signal.SIG_BLOCK, ()))
        raise _Started

    monkeypatch.setattr(BaseProcess, "start", started)
    with pytest.raises(_Started):
        start()
    assert signal.SIGINT in masks[0] and signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_a_second_signal_acts_wherever_it_comes() -> None:
    """Also before the first one has been noted as a whole: it waited forever for a lock that the first one had taken."""

    def raise_second() -> None:
        signal.raise_signal(signal.SIGINT)

    step, more, came = 0, True, 0
    with in_time(60):
        while more:
            step += 1
            try:
                with interrupt_noted() as noted:
                    _, more = interrupted(lambda: signal.raise_signal(signal.SIGINT), raise_second, step)
                    assert noted()
            except KeyboardInterrupt:
                came += 1
    assert came > 3


class _Asked:
    """What CasADi asks for a matrix while Ctrl-C comes: it drops what that raises."""

    def __SX__(self) -> ca.SX:
        signal.raise_signal(signal.SIGINT)
        raise AssertionError("went on")


@pytest.mark.parametrize("ask", [RobotModel.pose, RobotModel.poses])
def test_ctrl_c_in_the_first_pose_of_a_robot_is_not_lost(
    ask: Callable[[RobotModel, np.ndarray], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = load_robot("panda")
    monkeypatch.setattr(robot, "frame_pose", lambda *given: ca.sin(_Asked()))
    with pytest.raises(KeyboardInterrupt):
        ask(robot, robot.home)
