"""The lockstep loop: plant, controller and MPC in virtual time, with a modeled computation delay. Repeatable."""

from __future__ import annotations

import logging
import math
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, TypeVar, cast

import numpy as np

from wbmpc.checks import not_negative, real_number
from wbmpc.control.protocols import RobotController
from wbmpc.errors import (
    DisturbanceTooLarge,
    EndedByUser,
    FallPredicted,
    NotFinite,
    RobotStuck,
    RunAborted,
    SensorFailure,
    WayDeclined,
    described,
)
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.simulation.contacts import Contacts
from wbmpc.types import Plant, SimulatedRobot, Timing

#: Commands and measurements of one robot.
C = TypeVar("C")
M = TypeVar("M")
_LOG = logging.getLogger("wbmpc")
Progress = Callable[[float, str], None]
#: How long [s] the robot is held at a stop after a run that ended early, at least, and until it rests, at most.
STOP_TIME, LONGEST_STOP = 0.5, 5.0
#: Name of the loop of a drive that calibrates the robot before its run.
PREPARATION = "calibration drive, before the run"
#: Of a run [s]: what is longer is a mistake.
LONGEST_RUN = 1e6


@dataclass(frozen=True)
class Ending:
    """How a run ended: an empty ``reason`` when nothing ended it early; ``fell``, ``stuck``, ``declined`` (stuck in front of what it did not
    enter) and ``interrupted`` (by the user: Ctrl-C, a view) say what kind of end it was. ``contacts``: of its simulated robots, where they
    are monitored."""

    reason: str = ""
    fell: bool = False
    interrupted: bool = False
    contacts: tuple[Contacts, ...] = field(default=(), compare=False, repr=False)
    stuck: bool = False
    declined: bool = False

    @classmethod
    def of(cls, *plants: Plant[Any, Any], reason: str = "") -> Ending:
        """Of a run of ``plants`` that was ended for a ``reason``, or went to its end."""
        fell = any(plant.fell for plant in plants)
        return cls(reason or ("the robot fell" if fell else ""), fell, contacts=contacts_of(*plants))


#: Of a tick that is not the last one.
_GOES_ON = Ending()


def contacts_of(*plants: Plant[Any, Any]) -> tuple[Contacts, ...]:
    """What is known of the contacts of simulated robots, of those that have physics."""
    worlds = [getattr(plant, "world", None) for plant in plants if plant.has_physics]
    found = [getattr(world, "contacts", None) for world in worlds]
    return tuple(contacts for contacts in found if contacts is not None)


@dataclass(frozen=True)
class Running:
    """What runs: the loop's parts (``controller``, ``mpc`` None: there is none) and its ``duration`` [s].

    ``interrupted`` says whether Ctrl-C was pressed (or the process was asked to end); ``name`` distinguishes loops of one run.
    """

    plant: SimulatedRobot
    controller: RobotController | None
    mpc: MPC | None
    timing: Timing
    duration: float
    interrupted: Callable[[], bool] = lambda: False
    name: str = ""


class Watcher(Protocol):
    """Sees a run as it goes: recordings, live views. ``tick`` is called once per controller period, with the plant as it is
    before the command acts; it may wait, since time is virtual, and end the run by raising :class:`RunAborted`, or
    :class:`EndedByUser` where no other loop of the same run shall follow."""

    def begin(self, running: Running) -> None: ...
    def tick(self, t: float, command: Any, plans: PolicyQueue) -> None: ...
    def end(self, ending: Ending) -> None: ...


@dataclass(frozen=True)
class Watch:
    """A progress function with watchers: experiments pass it on to the loop, which calls them. ``name``: of the loop."""

    progress: Progress | None
    watchers: tuple[Watcher, ...] = ()
    name: str = ""

    def __call__(self, fraction: float, note: str) -> None:
        if self.progress is not None:
            self.progress(fraction, note)


def part(progress: Progress | None, k: int, count: int, name: str = "") -> Progress | None:
    """The progress of the ``k``-th of ``count`` parts of a run, its notes after ``name``; watchers come along."""
    if progress is None:
        return None
    report = lambda share, note: progress((k + share) / count, f"{name}: {note}" if name else note)
    return Watch(report, progress.watchers, name) if isinstance(progress, Watch) else report


def _watchers(progress: Progress | None) -> tuple[tuple[Watcher, ...], str]:
    return (progress.watchers, progress.name) if isinstance(progress, Watch) else ((), "")


_PREPARING: ContextVar[Progress | None] = ContextVar("preparing", default=None)


@contextmanager
def preparing(progress: Progress | None) -> Iterator[None]:
    """While a run is built: the ``progress`` of what drives before it, which :func:`preparation` gives."""
    token = _PREPARING.set(progress)
    try:
        yield
    finally:
        _PREPARING.reset(token)


def preparation() -> Progress | None:
    """Of a drive before the run that is being built, with its ``live`` watchers alone: the drive is no part of the run's recording."""
    outer = _PREPARING.get()
    if outer is None:
        return None
    report = lambda share, note: outer(0.0, f"{PREPARATION}: {note}")
    return Watch(report, tuple(w for w in _watchers(outer)[0] if getattr(w, "live", False)), PREPARATION)


@contextmanager
def interrupt_noted() -> Iterator[Callable[[], bool]]:
    """Gives a function that says whether Ctrl-C was pressed: what is being done (a tick, a run's files) is finished first, so
    that it stays whole.

    The same holds for every signal whose handler has an attribute ``noted``, which is called then. A second signal acts at once.
    Nothing is changed outside the main thread, or where the signals have other handlers.
    """
    pressed: list[int] = []  # no lock, for which a second signal in the middle would wait forever
    previous: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        handlers: dict[int, Any] = {
            number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        }
        previous = {n: h for n, h in handlers.items() if h is signal.default_int_handler or hasattr(h, "noted")}

    def note(number: int, frame: Any) -> None:
        if pressed:
            raise KeyboardInterrupt
        pressed.append(number)
        getattr(previous[number], "noted", lambda: None)()

    for number in previous:
        signal.signal(number, note)
    try:
        yield lambda: bool(pressed)
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _running(plant: Plant[Any, Any], controller: RobotController | None, *rest: Any) -> Running:
    """Loops take any plant and controller; what is watched has what can be shown as well."""
    return Running(cast("SimulatedRobot", plant), controller, *rest)


@contextmanager
def watched(
    plant: Plant[Any, Any], period: float, duration: float, progress: Progress | None,
    controller: RobotController | None = None,
) -> Iterator[Callable[[float, Any], None]]:  # fmt: skip
    """For experiments that step a plant themselves: its watchers see this loop as they see :func:`run_lockstep`'s.

    Gives ``tick(t, command)``, to be called every ``period`` [s], ``t`` [s] after the loop's start, before the plant steps. It
    raises :class:`EndedByUser` once Ctrl-C was pressed, so that a run ends between two steps.
    """
    watchers, name = _watchers(progress)
    plans, ending = PolicyQueue(), Ending("an error of the program")
    with interrupt_noted() as interrupted:
        timing = Timing(period, round(period / plant.timestep), 1, 0)
        for watcher in watchers:
            watcher.begin(_running(plant, controller, None, timing, duration, interrupted, name))

        def tick(t: float, command: Any) -> None:
            if interrupted():
                raise EndedByUser(f"interrupted at {t:.2f} s")
            for watcher in watchers:
                watcher.tick(t, command, plans)
            if progress is not None and round(t / period) % 40 == 0:
                progress(min(t / duration, 1.0), f"{t:.1f} of {duration:.1f} s")

        try:
            yield tick
            ending = Ending.of(plant)
        except RunAborted as error:
            ending = Ending(str(error), interrupted=isinstance(error, EndedByUser))
            raise
        finally:
            for watcher in watchers:
                watcher.end(ending)


def run_lockstep(
    plant: Plant[C, M], controller: RobotController[M, C], mpc: MPC | None, timing: Timing, duration: float,
    record: Callable[[float, C, PolicyQueue], None], progress: Progress | None = None,
    done: Callable[[], bool] | None = None,
) -> Ending:  # fmt: skip
    """Run for ``duration`` [s], or until ``done()``, which is asked at every tick. An early end (a fall, numbers that are not finite, no
    plan, Ctrl-C) stops the robot and is returned, not raised. So is every other exception once the robot has been commanded, because the
    robot would continue with its last command; in the first period errors (bad settings) are raised. A robot that is stopped early is
    simulated until it rests, and only then it is decided whether it fell.

    ``mpc`` None: for controllers that need no plan. ``record(t, command, plans)`` is called at every tick, with the plant as it is
    before the command acts; then come the watchers of a ``progress`` that is a :class:`Watch`.
    """
    real_number("run: 'duration'", duration, LONGEST_RUN)
    not_negative("run", duration=duration)
    plans, ticks, ending = PolicyQueue(), round(duration / timing.period), Ending()
    watchers, name = _watchers(progress)
    # what is not finite is found by its value; NumPy's warnings would only repeat it
    with interrupt_noted() as interrupted, np.errstate(over="ignore", invalid="ignore"):
        for watcher in watchers:
            watcher.begin(_running(plant, controller, mpc, timing, duration, interrupted, name))
        for i in range(ticks):
            t = i * timing.period
            if interrupted():
                ending = Ending(f"interrupted at {t:.2f} s", interrupted=True)
                break
            ending = _tick(plant, controller, mpc, timing, i, plans, record, watchers)
            if ending.reason or (done is not None and done()):
                break
            if progress is not None and i % 40 == 0:
                progress((i + 1) / ticks, f"{t:.1f} of {duration:.1f} s")
        if ending.reason and not plant.diverged:
            _come_to_rest(plant, controller, timing, STOP_TIME if ending.interrupted else LONGEST_STOP)
            ending = replace(ending, fell=ending.fell or (plant.fell and not ending.interrupted))
        ending = replace(ending, contacts=contacts_of(plant))
        for watcher in watchers:
            watcher.end(ending)
    if progress is not None and not ending.reason:
        progress(1.0, f"{duration:.1f} s")
    return ending


def _come_to_rest(plant: Plant[C, M], controller: RobotController[M, C], timing: Timing, longest: float) -> None:
    """Stop the robot, which nothing pushes any more, until it rests: for :data:`STOP_TIME` at least, and the ``longest`` time [s] at most."""
    plant.end_pushes()
    for _ in range(max(round(longest / STOP_TIME), 1)):
        plant.step(controller.stop(), round(STOP_TIME / timing.period) * timing.steps)
        if plant.diverged or plant.rests:
            return


def _tick(
    plant: Plant[C, M], controller: RobotController[M, C], mpc: MPC | None, timing: Timing, i: int, plans: PolicyQueue,
    record: Callable[[float, C, PolicyQueue], None], watchers: tuple[Watcher, ...],
) -> Ending:  # fmt: skip
    """One controller period: measure, plan when it is time, command, step. An ending with a reason if it was the last."""
    t = i * timing.period
    try:
        controller.measure(plant.measure())
        plans.activate(t)
        if mpc is not None and i % timing.mpc_every == 0:
            until = t + timing.delay * timing.period
            plans.add(until, mpc.update(controller.predict(t, until, plans)))
            plans.activate(t)
        command = controller.command(t, plans)
        _check(command)
        record(t, command, plans)
        for watcher in watchers:
            watcher.tick(t, command, plans)
        plant.step(command, timing.steps)
    except FallPredicted as error:
        return Ending(f"stopped at {t:.2f} s: {error}", fell=True)
    except (SensorFailure, DisturbanceTooLarge, NotFinite) as error:
        return Ending(f"stopped at {t:.2f} s: {error}")
    except RobotStuck as error:
        return Ending(f"stopped at {t:.2f} s: {error}", stuck=True, declined=isinstance(error, WayDeclined))
    except RunAborted as error:
        return Ending(f"aborted at {t:.2f} s: {error}", interrupted=isinstance(error, EndedByUser))
    except Exception as error:
        if i == 0:
            raise
        _LOG.debug("what was raised at %.2f s:", t, exc_info=error)  # the traceback, for who looks for the mistake
        return Ending(f"stopped at {t:.2f} s: {described(error)}")
    if plant.diverged:
        return Ending(f"the simulation diverged at {t:.2f} s: positions are not finite")
    return Ending(f"the robot fell at {t:.2f} s{_because(plant, mpc)}", fell=True) if plant.fell else _GOES_ON


def _because(plant: Plant[Any, Any], mpc: MPC | None) -> str:
    """Why the robot fell, as far as plant and MPC know."""
    whys = [why for why in (plant.fall_reason, getattr(mpc, "fault", "")) if why]
    return f" because {'; the MPC had no new plan: '.join(whys)}" if whys else ""


def _check(command: Any) -> None:
    """Raise :class:`NotFinite` naming the part of a command that is not finite: it must not reach the drives."""
    for name, values in vars(command).items():
        # what is infinite or no number stays so in a sum
        few = type(values) is np.ndarray and values.ndim == 1
        if not (math.isfinite(sum(values.tolist())) if few else np.isfinite(values).all()):
            bad = np.flatnonzero(~np.isfinite(values))
            raise NotFinite(f"command: '{name}' of drive {bad[0]} is not finite")
