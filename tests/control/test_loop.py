"""PolicyQueue and the lockstep loop. Truth: a list of who should be in force when; what reaches the drives when a run fails."""

from __future__ import annotations

import os
import signal
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from wbmpc.errors import InputError, NotFinite, RunAborted
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.simulation.lockstep import Ending, run_lockstep
from wbmpc.types import Observation, Plant, Timing


class FakeMPC:
    """Its policies are the times of their observations."""

    def __init__(self, fails_at: float = np.inf) -> None:
        self.fails_at = fails_at

    def update(self, observation: Observation):  # type: ignore[no-untyped-def]
        if observation.t >= self.fails_at:
            raise RunAborted("no plan")
        return observation.t


class FakeController:
    def __init__(self) -> None:
        self.measured = 0

    def measure(self, measurement) -> None:  # type: ignore[no-untyped-def]
        self.measured += 1

    def predict(self, t: float, until: float, plans: PolicyQueue) -> Observation:
        return Observation(until, np.zeros(1))

    def command(self, t: float, plans: PolicyQueue):  # type: ignore[no-untyped-def]
        return SimpleNamespace(drive=plans.current)

    def stop(self):  # type: ignore[no-untyped-def]
        return SimpleNamespace(drive=0.0)


class ErringController(FakeController):
    """At 0.2 s something that is not finite turns up."""

    def __init__(self, where: str) -> None:
        super().__init__()
        self.where = where

    def measure(self, measurement) -> None:  # type: ignore[no-untyped-def]
        super().measure(measurement)
        if self.where == "measure" and self.measured > 20:
            raise NotFinite("the estimate is not finite")

    def command(self, t: float, plans: PolicyQueue):  # type: ignore[no-untyped-def]
        if self.where == "command" and t > 0.195:
            return SimpleNamespace(drive=np.array([1.0, np.nan]))
        return SimpleNamespace(drive=np.array([1.0, 1.0]))


def fake_plant(falls_after: int = 10**9, diverges_after: int = 10**9):  # type: ignore[no-untyped-def]
    plant = SimpleNamespace(
        steps=0,
        fell=False,
        diverged=False,
        commands=[],
        rests=True,
        has_physics=True,
        fall_reason="",
        end_pushes=lambda: None,
    )

    def step(command, n: int) -> None:  # type: ignore[no-untyped-def]
        plant.steps += n
        plant.commands.append((command.drive, n))
        plant.fell = plant.steps > falls_after
        plant.diverged = plant.steps > diverges_after

    plant.step, plant.measure = step, lambda: None
    return plant


def test_timing_counts_whole_steps() -> None:
    timing = Timing.of(5e-4, 400.0, 80.0, 0.010)
    assert (timing.steps, timing.mpc_every, timing.delay) == (5, 5, 4)
    assert timing.period == pytest.approx(0.0025)
    assert Timing.of(5e-4, 400.0, 50.0, 0.0).delay == 0


@pytest.mark.parametrize(
    ("rates", "message"),
    [
        (
            (5e-4, 300.0, 50.0, 0.01),
            r"control\.rate: 300 Hz \(3\.33333 ms\) is not a whole number of physics steps of 0\.5 ms",
        ),
        (
            (5e-4, 400.0, 60.0, 0.01),
            r"mpc\.rate: 60 Hz \(16\.6667 ms\) is not a whole number of controller periods of 2\.5 ms",
        ),
        ((5e-4, 400.0, 50.0, 0.011), r"mpc\.computation_delay: 0\.011 s is not a whole number of controller periods"),
        ((5e-4, 4000.0, 50.0, 0.01), r"control\.rate"),
        ((5e-4, 400.0, 800.0, 0.01), r"mpc\.rate: 800 Hz is faster than the controller \(control\.rate\), 400 Hz"),
        ((5e-4, 100.0, 200.0, 0.01), r"mpc\.rate: 200 Hz is faster than the controller \(control\.rate\), 100 Hz"),
        ((5e-4, 400.0, 1e-310, 0.01), r"mpc\.rate: inf s is too long, more than a million controller periods"),
        ((5e-4, 400.0, 50.0, 1e300), r"mpc\.computation_delay: 1e\+300 s is too long"),
    ],
)
def test_rates_that_are_not_a_whole_number_of_steps(rates: tuple[float, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Timing.of(*rates)


@pytest.mark.parametrize(("every", "delay"), [(5, 0), (5, 2), (5, 5), (2, 7), (1, 3)])
def test_who_is_in_force(every: int, delay: int) -> None:
    """The newest policy whose computation is over; also when computing takes several MPC periods."""
    timing = Timing(0.01, 3, every, delay)
    controller, plant, seen = FakeController(), fake_plant(), []
    record = lambda t, c, p: seen.append((round(t / 0.01), c.drive))
    assert run_lockstep(plant, controller, FakeMPC(), timing, 0.5, record) == Ending()
    assert plant.steps == 150
    assert controller.measured == 50
    for tick, command in seen:
        started = [i for i in range(0, tick + 1, every) if i + delay <= tick]
        newest = (started[-1] + delay if started else delay) * 0.01
        assert command == pytest.approx(newest), tick


def test_plans_look_ahead() -> None:
    plans = PolicyQueue()
    assert plans.at(0.0) is None
    plans.add(0.3, "first")
    assert plans.current == "first"
    plans.add(0.5, "second"), plans.add(0.7, "third")
    assert [plans.at(t) for t in (0.0, 0.49, 0.5, 0.69, 0.7, 9.0)] == ["first"] * 2 + ["second"] * 2 + ["third"] * 2
    plans.activate(0.2)
    assert plans.current == "first"
    plans.activate(0.7)
    assert plans.current == "third"
    assert plans.at(0.0) == "third"


def test_a_fall_ends_the_run() -> None:
    plant, progress = fake_plant(falls_after=30), []
    timing = Timing(0.01, 3, 5, 1)
    ending = run_lockstep(
        plant, FakeController(), FakeMPC(), timing, 1.0, lambda *a: None, lambda p, text: progress.append(p)
    )
    assert ending == Ending("the robot fell at 0.10 s", fell=True)
    assert plant.commands[-1] == (0.0, 150)  # held at a stop for half a second
    assert plant.steps == 33 + 150


def test_an_aborted_mpc_ends_the_run() -> None:
    plant = fake_plant()
    ending = run_lockstep(plant, FakeController(), FakeMPC(0.5), Timing(0.01, 3, 5, 1), 1.0, lambda *a: None)
    assert ending == Ending("aborted at 0.50 s: no plan")
    assert plant.commands[-1] == (0.0, 150)


@pytest.mark.parametrize(
    ("where", "reason"),
    [
        ("measure", "stopped at 0.20 s: the estimate is not finite"),
        ("command", "stopped at 0.20 s: command: 'drive' of drive 1 is not finite"),
    ],
)
def test_what_is_not_finite_stops_the_robot_and_never_reaches_it(where: str, reason: str) -> None:
    plant, recorded = fake_plant(), []
    ending = run_lockstep(
        plant, ErringController(where), FakeMPC(), Timing(0.01, 3, 5, 1), 1.0, lambda t, c, p: recorded.append(t)
    )
    assert ending == Ending(reason)
    assert plant.commands.pop() == (0.0, 150)
    assert len(plant.commands) == len(recorded) == 20
    assert all(np.isfinite(drive).all() for drive, _ in plant.commands)


class RaisingController(FakeController):
    """Its ``tick``-th measurement (from 1 on) ends in a mistake of the program."""

    def __init__(self, tick: int) -> None:
        super().__init__()
        self.tick = tick

    def measure(self, measurement) -> None:  # type: ignore[no-untyped-def]
        super().measure(measurement)
        if self.measured == self.tick:
            raise ZeroDivisionError("nothing to divide by")


def test_whatever_is_raised_in_a_run_stops_the_robot_and_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    plant, recorded = fake_plant(), []
    with caplog.at_level("DEBUG", "wbmpc"):
        ending = run_lockstep(
            plant, RaisingController(21), FakeMPC(), Timing(0.01, 3, 5, 1), 1.0, lambda t, c, p: recorded.append(t)
        )
    assert ending == Ending("stopped at 0.20 s: ZeroDivisionError: nothing to divide by")
    assert plant.commands.pop() == (0.0, 150)
    assert len(plant.commands) == len(recorded) == 20
    assert "in measure" in caplog.text and "Traceback" in caplog.text


def test_what_is_raised_before_the_first_command_is_raised() -> None:
    plant = fake_plant()
    with pytest.raises(ZeroDivisionError):
        run_lockstep(plant, RaisingController(1), FakeMPC(), Timing(0.01, 3, 5, 1), 1.0, lambda *a: None)
    assert plant.commands == []


def test_a_simulation_that_diverged_is_left_alone() -> None:
    plant = fake_plant(diverges_after=30)
    ending = run_lockstep(plant, FakeController(), FakeMPC(), Timing(0.01, 3, 5, 1), 1.0, lambda *a: None)
    assert ending == Ending("the simulation diverged at 0.10 s: positions are not finite")
    assert plant.steps == 33


def test_ctrl_c_takes_effect_between_ticks_and_stops_the_robot() -> None:
    """The tick in which it comes is finished: recorded and commanded."""
    plant, recorded = fake_plant(), []

    def record(t: float, command: object, plans: PolicyQueue) -> None:
        if t == pytest.approx(0.1):
            os.kill(os.getpid(), signal.SIGINT)
        recorded.append(t)

    ending = run_lockstep(plant, FakeController(), FakeMPC(), Timing(0.01, 3, 5, 1), 1.0, record)
    assert ending == Ending("interrupted at 0.11 s", interrupted=True)
    assert len(recorded) == 11
    assert plant.commands[-1] == (0.0, 150)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_ctrl_c_acts_at_once() -> None:
    def record(t: float, command: object, plans: PolicyQueue) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        run_lockstep(fake_plant(), FakeController(), FakeMPC(), Timing(0.01, 3, 5, 1), 1.0, record)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_other_threads_leave_the_signal_alone() -> None:
    found: list[object] = []
    record = lambda *a: found.append(signal.getsignal(signal.SIGINT))
    arguments = (fake_plant(), FakeController(), FakeMPC(), Timing(0.01, 3, 5, 1), 0.05, record)
    thread = threading.Thread(target=run_lockstep, args=arguments)
    thread.start()
    thread.join()
    assert found == [signal.default_int_handler] * 5


def test_progress_ends_at_one() -> None:
    progress: list[float] = []
    run_lockstep(
        fake_plant(),
        FakeController(),
        FakeMPC(),
        Timing(0.01, 3, 5, 1),
        1.0,
        lambda *a: None,
        lambda p, text: progress.append(p),
    )
    assert progress[-1] == 1.0
    assert progress == sorted(progress)


@pytest.mark.parametrize("member", ["has_physics", "rests", "fall_reason", "end_pushes"])
def test_a_plant_that_lacks_a_part_of_the_protocol_is_not_taken_for_one_with_a_default(member: str) -> None:
    """A wrong name would silently leave the robot pushed, or its contacts uncounted."""
    plant = fake_plant(falls_after=20)
    assert hasattr(Plant, member)
    delattr(plant, member)
    with pytest.raises(AttributeError, match=member):
        run_lockstep(plant, FakeController(), FakeMPC(), Timing(0.01, 3, 5, 1), 0.5, lambda *a: None)
