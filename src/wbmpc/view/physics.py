"""A simulated robot that runs in real time in a process of its own, behind the runner's robot interface."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np

from wbmpc.errors import RunAborted
from wbmpc.interrupts import interrupts_blocked
from wbmpc.runtime.clock import WallClock
from wbmpc.runtime.shared_memory import Board, Mailbox
from wbmpc.simulation.scene import SceneReader
from wbmpc.view.process import RATE
from wbmpc.view.snapshot import GROUND, ground

#: What the simulation sends: numbers, and records of the end effector's true position [m] at times [s] of the machine's clock.
NUMBERS, RECORDS = ("ready", "end", "fell", "behind", "tilt"), ("time", "x", "y", "z")
#: How often the process looks for a command and sends a measurement [s]; a record every so many looks.
POLL_PERIOD, EVERY = 1e-3, 10
#: What the physics shows: pose of the base, and what acts between robot and floor, all in the world; its own time and the
#: clock's [s] (nan before the first command).
SEEN = {"base": (7,), **GROUND, "time": (), "clock": ()}
#: Physics that is later than this [s] lets the time go, and counts it.
PATIENCE = 0.05


def shapes(message: Any) -> dict[str, tuple[int, ...]]:
    """Fields of a dataclass of numbers and arrays, for a mailbox; what is None does not travel."""
    return {name: np.shape(value) for name, value in values(message).items()}


def values(message: Any) -> dict[str, Any]:
    """A dataclass as fields of a message."""
    fields_of_message = {f.name: getattr(message, f.name) for f in fields(message)}
    return {name: value for name, value in fields_of_message.items() if value is not None}


def build(kind: type, message: dict[str, np.ndarray]) -> Any:
    """The dataclass of a message."""
    arguments = {f.name: message[f.name] for f in fields(kind) if f.name in message}
    return kind(**{name: v if v.ndim else float(v) for name, v in arguments.items()})


class Simulated:
    """The runner's side of it. ``make`` makes the plant, in the other process; the robot stands until the first command.

    ``stop``: the command of a safe stop; ``core``: where the process runs (None: anywhere), ``fifo``: before all
    other processes; ``seen``: where it shows what acts on it (:data:`SEEN`; None: in a mailbox of its own); ``patience`` [s]: a process
    that sends nothing for longer is one that is held up. Times are the clock's.
    """

    def __init__(
        self, make: Callable[[], Any], measurement: Any, stop: Any, clock: WallClock, core: int | None,
        fifo: bool = False, record: int = 20_000, seen: Mailbox | None = None,
        patience: float = np.inf,
    ) -> None:  # fmt: skip
        self.patience = patience
        self.clock, self._stop, self._kind = clock, stop, type(measurement)
        self.measurements, self.commands = Mailbox.shared(shapes(measurement)), Mailbox.shared(shapes(stop))
        self.pushes, self.seen = Mailbox.shared({"force": (3,)}), seen or Mailbox.shared(SEEN)
        self.board, self._started, self._measured = Board.shared(NUMBERS, RECORDS, record), False, measurement
        boxes = (self.measurements, self.commands, self.pushes, self.seen)
        arguments = (make, type(stop), boxes, self.board, core, fifo)
        self.process = multiprocessing.get_context("spawn").Process(target=simulate, args=arguments, daemon=True)
        with interrupts_blocked():
            self.process.start()
        while not self.board["ready"]:
            if not self.process.is_alive():
                raise RunAborted("the physics did not start")
            time.sleep(0.01)

    def read(self) -> Any:
        """The newest measurement, its time on the runner's clock; a state that was late is later by its way here."""
        message = self.measurements.read()
        if message is not None:
            self._measured = build(self._kind, message.values)
        stamp = self._measured.time - self.clock.origin
        if message is None:
            self._check_alive(self.clock.now() - stamp)
        if not hasattr(self._measured, "age"):
            return replace(self._measured, time=stamp)
        return replace(self._measured, time=stamp, age=self._measured.age + max(self.clock.now() - stamp, 0.0))

    def _check_alive(self, silent: float) -> None:
        """Raise :class:`RunAborted` if the process has ended, or has sent nothing for too long [s]: the measurement's age alone would
        not say why."""
        if not self.process.is_alive():
            raise RunAborted(f"the process of the physics has ended with exit code {self.process.exitcode}")
        if silent > self.patience:
            why = "the machine is too busy, or its process was held up"
            raise RunAborted(
                f"the physics has sent nothing for {silent:.3f} s, the limit is {self.patience:g} s: {why}"
            )

    def write(self, command: Any) -> None:
        """The command that holds from now on; the first one lets the physics go."""
        if self.board["fell"]:
            raise RunAborted(f"the robot fell because {self.board.text}")
        self._started = True
        self.commands.write(**values(command))

    def stop(self) -> None:
        """The command of a safe stop; nothing before the first command."""
        if self._started:
            self.commands.write(**values(self._stop))

    def push(self, force: np.ndarray) -> None:
        """A force (3) [N] on the base in world axes from now on."""
        self.pushes.write(force=force)

    def falls(self, seconds: float) -> bool:
        """Whether it has fallen, or does within ``seconds`` [s]: one that balances goes on for a while after its motors are off."""
        deadline = time.monotonic() + seconds
        while not self.board["fell"] and self.process.is_alive() and time.monotonic() < deadline:
            time.sleep(0.02)
        return bool(self.board["fell"])

    def close(self) -> None:
        """End the process, also one that is held up: the command would wait for it at its end."""
        self.board["end"] = 1.0
        self.process.join(5.0)
        if self.process.is_alive():
            self.process.kill()
            self.process.join(5.0)

    def end_effector(self) -> tuple[np.ndarray, np.ndarray]:
        """Times (n) [s] on the runner's clock and true positions (n, 3) [m] of the end effector."""
        records = [self.board.samples(name) for name in RECORDS]
        return records[0] - self.clock.origin, np.stack(records[1:], axis=1)


def simulate(
    make: Callable[[], Any], kind: type, boxes: tuple[Mailbox, ...], board: Board, core: int | None, fifo: bool
) -> None:
    """The process: physics as fast as the wall clock, a measurement at every look; until the runner's process ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the runner, which then ends this
    parent, (measurements, commands, pushes, seen) = os.getppid(), boxes
    if core is not None:
        os.sched_setaffinity(0, {core})
    if fifo:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(5))  # after controller and MPC
    plant, clock, command, offset, polls = make(), WallClock(origin=0.0, spin=0.0), None, 0.0, 0
    due, shown = clock.now(), -np.inf
    reader = SceneReader(plant.model, plant.description.base.body)
    while not board["end"] and os.getppid() == parent:
        push = pushes.read()
        if push is not None:
            plant.push(push.values["force"])
        message = commands.read()
        if message is not None:
            offset = clock.now() - plant.time if command is None else offset
            command = build(kind, message.values)
        now = clock.now()
        if command is not None and not plant.fell:
            late = now - offset - plant.time
            if late > PATIENCE:
                board.count("behind")
                offset, late = offset + late, 0.0
            steps = int(late / plant.timestep)
            if steps > 0:
                plant.step(command, steps)
        measured = values(plant.measure())
        # the physics is behind the clock by less than a step; while the robot stands time goes on for it too
        measured["time"] = now if command is None else plant.time + offset
        measurements.write(**measured)
        if command is not None and polls % EVERY == 0:
            _record(plant, board, measured["time"])
        if now - shown > 1.0 / RATE:
            shown = now
            _show(plant, reader, seen, now if command is not None else np.nan)
        board["ready"] = 1.0
        polls, due = polls + 1, max(due + POLL_PERIOD, clock.now())
        clock.wait(due)


def _show(plant: Any, reader: SceneReader, seen: Mailbox, now: float) -> None:
    contacts = ground(reader.contacts(plant.data))
    seen.write(base=reader.poses(plant.data)[reader.scene.index], time=plant.time, clock=now, **contacts)


def _record(plant: Any, board: Board, time: float) -> None:
    truth = plant.truth()
    for name, value in zip(RECORDS, (time, *truth.tool), strict=True):
        board.sample(name, value)
    board["tilt"] = max(board["tilt"], truth.tilt)
    if plant.fell and not board["fell"]:
        board.text, board["fell"] = plant.fall_reason, 1.0
