"""What the runner asks of the operating system: the MPC's process, and the control thread's place before others."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable
from multiprocessing.process import BaseProcess

from wbmpc.errors import InputError
from wbmpc.interrupts import interrupts_blocked
from wbmpc.mpc.mpc import MPC
from wbmpc.runtime.clock import WallClock
from wbmpc.runtime.shared_memory import Board, Mailbox
from wbmpc.runtime.worker import serve

#: For how long [s] a process may load and build its MPC.
_READY = 60.0


def start_process(
    make: Callable[[], MPC], observations: Mailbox, policies: Mailbox, board: Board, worker_commands: Board,
    offset: float, setup: Callable[[], None] | None,
) -> BaseProcess:  # fmt: skip
    """Begin a process that serves an MPC, see :func:`wbmpc.runtime.worker.serve`."""
    arguments = (make, observations, policies, board, worker_commands, offset, setup)
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=serve, args=arguments, daemon=True)
    with interrupts_blocked():
        process.start()
    return process


def await_ready(process: BaseProcess, board: Board) -> None:
    """Wait until such a process is ready. Raises :class:`InputError` with its reason if it does not come up."""
    waiting = WallClock()
    while not board["ready"] and process.is_alive() and waiting.now() < _READY:
        waiting.wait(waiting.now() + 5e-3)
    if not board["ready"]:
        code = process.exitcode
        ended = f"no answer within {_READY:g} s" if code is None else f"it ended with exit code {code}"
        process.kill()
        raise InputError(f"runner: the MPC's process did not come up: {board.text or ended}")


def set_priority(thread: threading.Thread, level: int) -> None:
    """Put a thread that runs into the kernel's real-time class, at 1 to 99. Raises :class:`InputError` without the right to."""
    try:
        os.sched_setscheduler(thread.native_id or 0, os.SCHED_FIFO, os.sched_param(level))
    except OSError as error:
        raise InputError(
            f"real time: priority {level} is not to be had ({error.strerror}): it needs the right to it"
            " (CAP_SYS_NICE, or rtprio in limits.conf); 0 needs none"
        ) from error
