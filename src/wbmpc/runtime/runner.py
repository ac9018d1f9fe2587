"""The real-time runner: a control thread at a fixed rate beside an MPC in a thread or a process of its own.

A tick: read the robot, update the estimator, activate the policies that are due, hand the predicted observation to the
MPC, command the robot. The observation is predicted over the latency that was measured, so that its policy becomes active
at the state that it was computed for. Whatever goes wrong ends in a safe stop: ``stop()`` of the robot at every tick until the
runner is shut down, and a message that says why.
"""

from __future__ import annotations

import logging
import math
import os
import sys
import threading
from collections.abc import Callable
from functools import partial
from multiprocessing.process import BaseProcess
from typing import TypeVar

import numpy as np

from wbmpc.control.protocols import Controller
from wbmpc.errors import InputError, NotFinite, RunAborted
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.runtime.clock import Clock, Loop, Ticker, VirtualClock, WallClock, follow, interleave
from wbmpc.runtime.process import await_ready, set_priority, start_process
from wbmpc.runtime.safety import (
    ROUNDING,
    CommandCheck,
    Latency,
    RealTimeSettings,
    SafeStop,
    check_held_up,
    check_measurement,
    not_finite,
)
from wbmpc.runtime.shared_memory import Board, Mailbox, Sizes, TimedPolicy
from wbmpc.runtime.statistics import Punctuality, Report
from wbmpc.runtime.stop_control import RobotInterface, StopControl, Timed
from wbmpc.runtime.worker import NUMBERS, RECORDS, WORKER_COMMANDS, Worker

#: Commands and measurements of one robot.
C = TypeVar("C")
M = TypeVar("M", bound=Timed)
_LOG = logging.getLogger("wbmpc")
#: For how long [s] at most a tick may end by itself before a shutdown stops the robot; then for how long each loop may end.
_TICK_ENDS, _LOOP_ENDS = 0.5, 5.0


class RealTimeRunner(StopControl):
    """``robot`` and ``controller`` run in the control thread; ``mpc`` in a thread, or in a process if it is a function that makes
    one (importable, for it runs there; then ``sizes`` are needed, ``Sizes.of(ocp)``).

    ``parameters``: model parameters (as of the solver) that the controller estimates, sent with every observation. The controller must not
    use the solver's memory of ``mpc``: it gets an MPC of its own. ``setup`` is called in that process first. ``watch(t, late, plans)``
    is called in the control thread after each command, with the tick's time and by how much it began late [s]; it must not wait, and is
    dropped when it fails. ``state`` says in a message what the runner does, or why it stopped; ``error`` is the
    exception behind it. In virtual time use :meth:`run`.

    ``settings`` and ``clock`` (None: defaults, the wall clock). To read: ``plans``: the active policy and the next ones; ``punctuality`` of
    the ticks, which ``ticker`` counts; ``latency``: from measurement to policy [s]; ``kept``: why the last policy is kept beyond its time,
    ``""`` when it is not; ``remote``: whether the MPC is in another process; ``ticking``: whether a tick is
    under way; ``own``: counts and times of the control thread,
    ``board``: those of the MPC. Between both: ``observations``, ``policies``, ``worker_commands``.
    """

    def __init__(
        self, robot: RobotInterface[M, C], controller: Controller[M, C], mpc: MPC | Callable[[], MPC],
        settings: RealTimeSettings | None = None, clock: Clock | None = None, *, sizes: Sizes | None = None,
        parameters: Callable[[], np.ndarray] | None = None, setup: Callable[[], None] | None = None,
        watch: Callable[[float, float, PolicyQueue], None] | None = None,
    ) -> None:  # fmt: skip
        super().__init__(robot, settings or RealTimeSettings(), clock or WallClock())
        self.controller, self.mpc, self.parameters, self.watch = controller, mpc, parameters, watch
        self.remote, self.setup = not hasattr(mpc, "solver"), setup
        if self.remote and (sizes is None or isinstance(self.clock, VirtualClock)):
            raise InputError("runner: an MPC in another process needs 'sizes' and the wall clock")
        size = sizes or Sizes.of(mpc.solver.ocp, mpc.solver.problem)  # type: ignore[union-attr]
        mailbox, board = (Mailbox.shared, Board.shared) if self.remote else (Mailbox, Board)
        self.observations, self.policies = mailbox(size.observation()), mailbox(size.policy())
        self.board, self.worker_commands = board(NUMBERS, RECORDS, self.settings.records), board(WORKER_COMMANDS)
        own = ("latency", "ready", "jitter", "tick", "sent")
        self.own = Board(("ticks", "misses", "skipped", "policies", "late", "clamped"), own, self.settings.records)
        self.punctuality = Punctuality()
        self.plans, self.latency, self._check_command = PolicyQueue(), Latency(self.settings), CommandCheck()
        self.ticker = Ticker(self.settings.period)
        self._no_parameters = np.zeros(size.parameters)
        self._answered, self._until = 0, 0.0
        #: why the last policy is kept beyond its time; empty when it is not
        self.kept = ""
        self._current: TimedPolicy | None = None
        self._worker: Worker | None = None
        self._process: BaseProcess | None = None
        self._threads: list[threading.Thread] = []

    # ------------------------------------------------------------------ life
    def start(self) -> None:
        """Begin by the wall clock; returns when all threads run. The MPC's process is ready before time 0."""
        self._check_new()
        try:
            self._launch()
        except BaseException:
            self.shutdown()
            raise

    def _check_new(self) -> None:
        if self.state != "not started":
            raise InputError(f"runner: can be started once; it is: {self.state}")

    def _launch(self) -> None:
        if self.remote:
            offset = self.settings.mpc_offset
            self._process = start_process(
                self.mpc, self.observations, self.policies, self.board, self.worker_commands, offset, self.setup  # type: ignore[arg-type]
            )  # fmt: skip
            await_ready(self._process, self.board)
        loops = self._begin()
        runs: list[Callable[[], None]] = [partial(follow, self.clock, loops[0])]
        if len(loops) > 1:  # of the two only the controller's waits end with a spin: it keeps the interpreter
            clock = WallClock(self.clock.origin, spin=0.0) if isinstance(self.clock, WallClock) else self.clock
            runs.append(partial(self._mpc_thread, clock, loops[1]))
        if getattr(self.clock, "in_turns", False):  # one thread: nothing depends on the machine's speed
            runs = [partial(interleave, self.clock, loops, math.inf)]
        runs[0] = partial(self._control_thread, runs[0])
        self._threads = [threading.Thread(target=run, daemon=True) for run in runs]
        if not getattr(self.clock, "in_turns", False):  # there a tick may wait for a solve
            self._threads.append(threading.Thread(target=self._watch, daemon=True))
        for thread in self._threads:
            thread.start()
        if self.settings.priority:
            set_priority(self._threads[0], self.settings.priority)

    def run(self, seconds: float) -> Report:
        """Run for ``seconds`` [s] or until it has stopped, then shut down, also after Ctrl-C. In virtual time the stop's ticks go on
        to the end."""
        self._check_new()
        try:
            if isinstance(self.clock, VirtualClock):
                interleave(self.clock, self._begin(), seconds)
            else:
                self._launch()
                self._stopped.wait(seconds)
        finally:
            self.shutdown()
        return self.report()

    def shutdown(self) -> None:
        """End all loops. The robot is stopped as soon as no tick runs; only then the MPC is waited for, which may hang."""
        self.worker_commands["end"] = 1.0
        self._ended.set()
        try:
            for thread in self._threads[:1]:  # the controller's, which also stops the robot when it ends
                if thread.is_alive():
                    thread.join(min(self.settings.watchdog, _TICK_ENDS))
        finally:
            self._stop_robot()
        for thread in self._threads:
            if thread.is_alive():
                thread.join(_LOOP_ENDS)
        if self._process is not None:
            self._process.join(_LOOP_ENDS)
            if self._process.is_alive():
                self._process.kill()
        if not self._stopped.is_set():
            self.state = f"shut down after {self.clock.now():.1f} s"

    def __enter__(self) -> RealTimeRunner:
        self.start()
        return self

    def __exit__(self, *ignored: object) -> None:
        self.shutdown()

    @property
    def stopped(self) -> bool:
        """Whether there was a safe stop."""
        return self._stopped.is_set()

    @property
    def process_id(self) -> int:
        """Of the process in which the MPC runs."""
        return os.getpid() if self._process is None else self._process.pid or 0

    def _begin(self) -> list[Loop]:
        self.clock.restart()
        self.state, self._beat = "standing by for the first policy", self.clock.now()
        self.worker_commands["origin"] = getattr(self.clock, "origin", 0.0)
        self.worker_commands["begin"] = 1.0
        if self.remote:
            return [self._control()]
        s = self.settings
        self._worker = Worker(
            self.mpc, self.observations, self.policies, self.board, self.worker_commands, self.clock, s.mpc_offset  # type: ignore[arg-type]
        )  # fmt: skip
        return [self._control(), self._worker.loop()]

    # ------------------------------------------------------------------ control
    def _control_thread(self, run: Callable[[], None]) -> None:
        try:
            run()
        except BaseException as error:  # also what means to end an interpreter: here it would end a thread, unnoticed
            self._raised(error)
        finally:
            self._stop_robot()  # whatever becomes of the thread that shuts down

    def _mpc_thread(self, clock: Clock, loop: Loop) -> None:
        assert self._worker is not None
        try:
            follow(clock, loop)
        except BaseException as error:
            self._worker.fail(error)

    def _control(self) -> Loop:
        """The controller's loop: a tick, or the stop, at every deadline."""
        own, clock, usual = self.own, self.clock, sys.getswitchinterval()
        while not self.worker_commands["end"]:
            due = self.ticker.due
            yield due
            if self.worker_commands["end"]:
                break
            start = clock.now()
            own.sample("jitter", start - due)
            self._beat = start
            self.punctuality.begin(due, start)
            self.ticking = True
            if not self._stopped.is_set():
                try:
                    check_held_up(start - due, 0.0, self.settings.watchdog)
                    self._tick(due)
                    check_held_up(0.0, clock.now() - start, self.settings.watchdog)
                except (RunAborted, NotFinite) as reason:  # on purpose, by this runner or by the robot: a message
                    self.halt(str(reason))
                except (Exception, SystemExit) as error:
                    self._raised(error)
            self.ticking = False
            if self._stopped.is_set():
                self._stop_robot()
            end = clock.now()
            own.sample("tick", end - start)
            own.count("ticks")
            skipped = self.ticker.over(end)
            own.count("misses", int(skipped > 0))
            own.count("skipped", skipped)
            self._beat = self.ticker.due  # until then no tick has to run
        sys.setswitchinterval(usual)  # the clock may have changed it

    def _tick(self, due: float) -> None:
        now, over = self.clock.now, self.punctuality.over
        measurement = self.robot.read()
        check_measurement(measurement, self.clock.now(), self.settings.max_observation_age)
        self._check_worker()
        over(now())
        self.controller.measure(measurement)
        over(now())
        self._collect()
        self._activate(due)
        self._observe(due)
        over(now())
        if not self._in_force(due):
            self._stop_robot()
            return
        previous = self._cuts()
        command = self.controller.command(due, self.plans)
        self._check_command(command)
        if self._stopped.is_set() or self._ended.is_set():  # from another thread, while this tick hung
            return
        over(now())
        # the drives of a process that was held up until now have stopped by themselves: what was right before sets them going again
        check_held_up(0.0, now() - self._beat, self.settings.watchdog)
        self.robot.write(command)
        over(now())
        self.own.sample("sent", self.punctuality.sent())
        # controllers that cut in their own way say so; else the policy knows
        self.own.count("clamped", int(getattr(self.controller, "clamped", self._cuts() > previous)))
        if self.watch is not None:
            self._show(due)

    def _cuts(self) -> int:
        """How often the active policy has cut an input to its hard bounds."""
        policy = self.plans.current
        return 0 if policy is None or policy.limits is None else policy.limits.count

    def _show(self, due: float) -> None:
        """Let the watcher see this tick; what goes wrong there is reported once, and the robot goes on."""
        assert self.watch is not None
        try:
            self.watch(due, self._beat - due, self.plans)
        except (Exception, SystemExit) as error:
            self.watch = None
            _LOG.error("the watchdog has ended: %s: %s", type(error).__name__, error, exc_info=error)

    def _check_worker(self) -> None:
        if self.board["failed"]:
            if not self.kept:
                self.error = self._worker.error if self._worker is not None else None
            self._without_mpc(f"the MPC raised {self.board.text}")
        elif self._process is not None and self.own["ticks"] % 20 == 0 and not self._process.is_alive():
            self._without_mpc(f"the MPC's process has ended with exit code {self._process.exitcode}")

    def _without_mpc(self, reason: str) -> None:
        """No new policies: a stop, or with ``keep_last_policy`` a robot that goes on with the last one, which is said once."""
        if not self.settings.keep_last_policy or self.plans.current is None:
            raise SafeStop(reason)
        if not self.kept:
            self.kept = reason
            self.state = f"running on the last policy since {self.clock.now():.3f} s: {reason}"
            _LOG.error("%s", self.state)

    def _collect(self) -> None:
        """Queue the newest policy; the delay of the first answer to an observation counts for the latency."""
        policy = TimedPolicy.take(self.policies)
        if policy is None:
            return
        if policy.observation != self._answered:
            self._answered = policy.observation
            delay = policy.ready - policy.observed
            self.own.sample("ready", delay)
            self.latency.add(delay)
        self.plans.add(policy.valid_from, policy)

    def _activate(self, due: float) -> None:
        self.plans.activate(due)
        previous, policy = self._current, self.plans.current
        if policy is None or policy is previous:
            return
        assert isinstance(policy, TimedPolicy)
        self.own.count("policies")
        self.own.count("late", int(due > policy.valid_from + 1e-6))
        self.own.sample("latency", self.clock.now() - policy.observed)
        self._current = policy
        if previous is None or (self.kept and not self.board["failed"]):
            self.state, self.kept = "running", ""

    def _observe(self, due: float) -> None:
        """Hand over the state predicted for when the policy can be there; that time never goes back."""
        self._until = max(self._until, due + self.latency.ticks * self.settings.period)
        seen = self.controller.predict(due, self._until, self.plans)
        parameters = self._no_parameters if self.parameters is None else self.parameters()
        for name, value in (("predicted state", seen.x), ("vector of model parameters", parameters)):
            if not_finite(name, value) is not None:
                raise SafeStop(f"the {name} is not finite")
        self.observations.write(observed=due, valid_from=self._until, t=seen.t, x=seen.x, parameters=parameters)

    def _in_force(self, due: float) -> bool:
        """Whether there is a policy, young enough; a stop if not."""
        policy, s = self.plans.current, self.settings
        if policy is None:
            if due > s.patience + ROUNDING:
                raise SafeStop(f"no policy within {s.patience:g} s ({self._failed()})")
            return False
        assert isinstance(policy, TimedPolicy)
        limit = s.max_policy_age or policy.end - float(policy.times[0])
        age = due - policy.valid_from
        if age > limit + ROUNDING:
            self._without_mpc(f"the policy is {age:.3f} s old, the limit is {limit:g} s ({self._failed()})")
        return True

    def _failed(self) -> str:
        """How many solves failed, and why the last one that did."""
        why = self.board.text
        return f"{int(self.board['failures'])} solves failed{', the last one: ' if why else ''}{why}"

    # ------------------------------------------------------------------ figures
    def report(self) -> Report:
        """Counts and times up to now."""
        return Report.of(self.state, self.clock.now(), self.own, self.board, self.punctuality)
