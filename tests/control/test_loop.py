"""Plans and the lockstep loop. Truth: a list of who should be in force when."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from wbmpc.control import Plans
from wbmpc.errors import InputError, RunAborted
from wbmpc.loop import Timing, run_lockstep
from wbmpc.mpc import Observation


class FakeMPC:
    """Its policies are the times of their observations."""

    def __init__(self, fails_at: float = np.inf) -> None:
        self.fails_at = fails_at

    def update(self, observation: Observation):  # type: ignore[no-untyped-def]
        if observation.t >= self.fails_at:
            raise RunAborted("no plan")
        return observation.t


class FakeAgent:
    def __init__(self) -> None:
        self.measured = 0

    def measure(self, measurement) -> None:  # type: ignore[no-untyped-def]
        self.measured += 1

    def predict(self, t: float, until: float, plans: Plans) -> Observation:
        return Observation(until, np.zeros(1))

    def command(self, t: float, plans: Plans):  # type: ignore[no-untyped-def]
        return plans.current


def fake_plant(falls_after: int = 10**9):  # type: ignore[no-untyped-def]
    plant = SimpleNamespace(steps=0, fell=False)

    def step(command, n: int) -> None:  # type: ignore[no-untyped-def]
        plant.steps += n
        plant.fell = plant.steps > falls_after

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
        ((5e-4, 300.0, 50.0, 0.01), r"control\.rate: 3\.33333 ms is not a whole number of physics steps of 0\.5 ms"),
        ((5e-4, 400.0, 60.0, 0.01), r"mpc\.rate: 16\.6667 ms is not a whole number of controller periods of 2\.5 ms"),
        ((5e-4, 400.0, 50.0, 0.011), r"mpc\.delay: 11 ms is not a whole number of controller periods"),
        ((5e-4, 4000.0, 50.0, 0.01), r"control\.rate"),
        ((5e-4, 400.0, 800.0, 0.01), r"mpc\.rate"),
    ],
)
def test_rates_that_are_not_a_whole_number_of_steps(rates: tuple[float, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Timing.of(*rates)


@pytest.mark.parametrize(("every", "delay"), [(5, 0), (5, 2), (5, 5), (2, 7), (1, 3)])
def test_who_is_in_force(every: int, delay: int) -> None:
    """The newest policy whose computation is over; also when computing takes several MPC periods."""
    timing = Timing(0.01, 3, every, delay)
    agent, plant, seen = FakeAgent(), fake_plant(), []
    reason = run_lockstep(plant, agent, FakeMPC(), timing, 0.5, lambda t, c, p: seen.append((round(t / 0.01), c)))
    assert reason == ""
    assert plant.steps == 150
    assert agent.measured == 50
    for tick, command in seen:
        started = [i for i in range(0, tick + 1, every) if i + delay <= tick]
        newest = (started[-1] + delay if started else delay) * 0.01
        assert command == pytest.approx(newest), tick


def test_plans_look_ahead() -> None:
    plans = Plans()
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
    reason = run_lockstep(
        plant, FakeAgent(), FakeMPC(), timing, 1.0, lambda *a: None, lambda p, text: progress.append(p)
    )
    assert reason == "the robot fell at 0.10 s"
    assert plant.steps == 33


def test_an_aborted_mpc_ends_the_run() -> None:
    reason = run_lockstep(fake_plant(), FakeAgent(), FakeMPC(0.5), Timing(0.01, 3, 5, 1), 1.0, lambda *a: None)
    assert reason == "no plan"


def test_progress_ends_at_one() -> None:
    progress: list[float] = []
    run_lockstep(
        fake_plant(),
        FakeAgent(),
        FakeMPC(),
        Timing(0.01, 3, 5, 1),
        1.0,
        lambda *a: None,
        lambda p, text: progress.append(p),
    )
    assert progress[-1] == 1.0
    assert progress == sorted(progress)
