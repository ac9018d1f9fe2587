"""The MPC's side of the real-time runner: newest observation, one solve, policy straight from the solver's memory."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from multiprocessing.connection import wait

import numpy as np

from wbmpc.errors import described
from wbmpc.mpc.mpc import MPC
from wbmpc.runtime.clock import Clock, Loop, Ticker, WallClock, follow
from wbmpc.runtime.shared_memory import Board, Mailbox, Message
from wbmpc.types import Observation

#: What the worker counts, and its records [s].
NUMBERS = (
    "ready", "updates", "misses", "skipped", "failures", "repeated", "failed", "limit_violations",
    "worst_limit_violation", "initial_state_mismatches", "worst_initial_state_mismatch",
)  # fmt: skip
RECORDS = ("solve_time", "update_time")
#: What the runner sends to the worker: when 0 is, whether to begin and to end.
WORKER_COMMANDS = ("origin", "begin", "end")


class Worker:
    """One MPC between two mailboxes at its own rate.

    ``offset`` [s]: by how much its ticks follow the controller's, so that the observation of the same tick is there.
    A solve that fails is counted and publishes nothing; the next one starts from the last good plan.
    """

    def __init__(
        self, mpc: MPC, observations: Mailbox, policies: Mailbox, board: Board, worker_commands: Board, clock: Clock,
        offset: float,
    ) -> None:  # fmt: skip
        self.mpc, self.observations, self.policies = mpc, observations, policies
        self.board, self.worker_commands, self.clock = board, worker_commands, clock
        self.ticker = Ticker(mpc.period, offset)
        self._message: Message | None = None
        self.error: BaseException | None = None
        self._answered, self._ready = 0, 0.0
        plan = mpc.solver.trajectory()
        self._start = plan.x, plan.u

    def loop(self) -> Loop:
        """Tick until the runner says that it is the end, or something is raised: then the board has the reason."""
        board, clock = self.board, self.clock
        while not self.worker_commands["end"]:
            yield self.ticker.due
            polled = False
            try:
                polled = self._poll()
                if polled:
                    start = clock.now()
                    usable = self._solve()
                    computing = clock.computing()
                    if computing > 0.0:
                        yield start + computing
                    if usable:
                        self._publish()
                        self._count_limit_violations()
                        self._count_initial_state_mismatches()
                    board.sample("update_time", clock.now() - start)
            except (Exception, SystemExit) as error:
                self.fail(error)
                return
            skipped = self.ticker.over(clock.now())
            if polled and skipped and board["updates"] > 1:  # the first solve iterates to convergence
                board.count("misses")
                board.count("skipped", skipped)

    def fail(self, error: BaseException) -> None:
        """Say that this worker has ended, and why."""
        self.error = error
        report(self.board, error)

    def _poll(self) -> bool:
        """Take the newest observation; whether there has been one."""
        message = self.observations.read()
        if message is not None:
            self._message = message
        elif self._message is not None:
            self.board.count("repeated")
        return self._message is not None

    def _solve(self) -> bool:
        assert self._message is not None
        values = self._message.values
        if values["parameters"].size:
            self.mpc.solver.set_parameters(values["parameters"])
        observation = Observation(float(values["t"]), values["x"])
        usable = self.mpc.advance(observation)
        self.board.count("updates")
        self.board.sample("solve_time", self.mpc.solve_time)
        if not usable:
            self.board.count("failures")
            if self.mpc.fault:
                self.board.text = self.mpc.fault
            self._recover(observation)
        return usable

    def _recover(self, observation: Observation) -> None:
        last = self.policies.last
        if last is None:
            self.mpc.reset(*self._start)
        else:
            self.mpc.recover(observation, last["x"], last["u"], float(last["times"][0]))

    def _publish(self) -> None:
        assert self._message is not None
        values, slot = self._message.values, self.policies.begin()
        plan = self.mpc.solver.trajectory(copy=False)
        np.add(plan.grid, values["t"], out=slot["times"])
        slot["x"][...], slot["u"][...] = plan.x, plan.u
        slot["gain"][...] = self.mpc.solver.gain
        limits, (active, moving) = self.mpc.limits, self.mpc.input_rows()
        for name in ("lower", "upper", "matrix", "offset"):
            slot[name][...] = getattr(limits, name)
        if active is not None:
            slot["active"][...] = active
        if moving is not None:
            slot["moving"][...] = moving
        slot["observation"][...] = self._message.number
        for name in ("observed", "valid_from"):
            slot[name][...] = values[name]
        if self._answered != self._message.number:
            self._answered, self._ready = self._message.number, self.clock.now()
        slot["ready"][...] = self._ready
        slot["limit_violation"][...] = self.mpc.limit_violation
        self.policies.commit()

    def _count_limit_violations(self) -> None:
        """Policies whose states are outside hard limits are used, and reported."""
        share, board = self.mpc.limit_violation, self.board
        assert self._message is not None
        if share > 0.0:
            board.count("limit_violations")
            if share > board["worst_limit_violation"]:
                board["worst_limit_violation"] = share
                board.note = f"{self.mpc.limit_violation_message()}, at {self._message.values['t']:.3f} s"

    def _count_initial_state_mismatches(self) -> None:
        """So are plans that start elsewhere than where they were asked to."""
        mismatch, board = self.mpc.solver.initial_state_mismatch, self.board
        if mismatch > 0.0:
            board.count("initial_state_mismatches")
            board["worst_initial_state_mismatch"] = max(board["worst_initial_state_mismatch"], mismatch)


def report(board: Board, error: BaseException) -> None:
    """Put on the board that and why the worker has ended."""
    board.text = described(error)
    board["failed"] = 1.0


#: How often [s] the MPC's process looks whether its parent is there.
_POLL_PERIOD = 0.25


def end_with_parent() -> None:
    """End this process when the one that started it has gone, however that ended, also by SIGKILL.

    A thread waits for the pipe that the parent holds open, and checks the parent's number as well, since a process that
    the parent has forked may hold that pipe too. (Linux's parent-death signal comes when the parent's *thread* ends.)
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    number, pipe = parent.pid, parent.sentinel

    def watch() -> None:
        while os.getppid() == number and not wait([pipe], _POLL_PERIOD):
            pass
        os._exit(1)  # no process is left to report to

    threading.Thread(target=watch, daemon=True, name="parent").start()


def serve(
    make: Callable[[], MPC], observations: Mailbox, policies: Mailbox, board: Board, worker_commands: Board,
    offset: float, setup: Callable[[], None] | None,
) -> None:  # fmt: skip
    """A worker in a process of its own, by the wall clock, as long as the process that started it is there."""
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's Ctrl-C is for the parent, which ends this process
    clock = WallClock()
    try:
        if setup is not None:
            setup()
        worker = Worker(make(), observations, policies, board, worker_commands, clock, offset)
    except (Exception, SystemExit) as error:
        report(board, error)
        raise
    board["ready"] = 1.0
    while not (worker_commands["begin"] or worker_commands["end"]):
        clock.wait(clock.now() + 1e-3)
    clock.origin = worker_commands["origin"]
    # nothing below makes reference cycles: collections would only delay a solve
    gc.collect()
    gc.disable()
    follow(clock, worker.loop())
    if worker.error is not None:
        raise worker.error
