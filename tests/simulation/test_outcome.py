"""How runs end, seen when the robot rests. Truth: a ball robot without torques falls, a robot on four wheels stands; first-order lags
on paper."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from wbmpc.bases.ball.messages import BallCommand
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.errors import DisturbanceTooLarge
from wbmpc.experiment import Outcome, Part, Scenario, run_parts
from wbmpc.log import Log
from wbmpc.model.robot import load_robot
from wbmpc.result import Metric
from wbmpc.simulation.any_perturbation import AnyPerturbation
from wbmpc.simulation.contacts import Touch
from wbmpc.simulation.lockstep import Ending, run_lockstep
from wbmpc.types import Timing

SWERVE, BALL = load_robot("swerve-ur10"), load_robot("rezero")


class GivesUp:
    """Commands ``still`` and gives up after 0.1 s."""

    def __init__(self, still: Any) -> None:
        self.still = still

    def measure(self, measurement: Any) -> None:
        if measurement.time > 0.1:
            raise DisturbanceTooLarge("a force that lasts; motors off")

    def command(self, t: float, plans: Any) -> Any:
        return self.still

    def stop(self) -> Any:
        return self.still


def ended(plant: Any, still: Any) -> Ending:
    timing = Timing.of(plant.timestep, 400.0, 80.0, 0.0)
    return run_lockstep(plant, GivesUp(still), None, timing, 1.0, lambda *_: None)  # type: ignore[arg-type]


def test_a_robot_that_is_given_up_has_fallen_if_it_lies_in_the_end() -> None:
    """A push that goes on when the run ends pushes no longer."""
    plant = BallPlant(BALL.description, perturbation=AnyPerturbation.none())
    plant.push([60.0, 0.0, 0.0])
    ending = ended(plant, BallCommand(np.zeros(6)))
    assert ending.fell and "motors off" in ending.reason and plant.world.tilt > 0.35
    assert not plant.data.xfrc_applied.any() and plant.time > 1.0
    assert ending.contacts[0].touches  # with the floor
    stands = ended(SwervePlant(SWERVE.description, perturbation=AnyPerturbation.none()), SwerveCommand.stop(4, 6))
    assert not stands.fell and stands.reason and not stands.contacts[0].touches


@pytest.mark.parametrize(
    ("ending", "touched", "outcome"),
    [
        (Ending(), False, "completed"),
        (Ending(), True, "collided"),
        (Ending("stopped"), False, "gave_up"),
        (Ending("stopped", stuck=True), False, "stuck"),
        (Ending("stopped", stuck=True, declined=True), False, "declined"),
        (Ending("stopped", stuck=True, declined=True), True, "collided"),
        (Ending("stopped"), True, "collided"),
        (Ending("stopped", fell=True), True, "fell"),
        (Ending("stopped", interrupted=True), True, "interrupted"),
    ],
)
def test_one_outcome_for_a_run(ending: Ending, touched: bool, outcome: str) -> None:
    from wbmpc.experiment import run_scenario

    touches = [Touch(1.0, "base", "door")] if touched else []
    contacts = SimpleNamespace(touches=touches, clearance=0.02)
    given = replace(ending, contacts=(contacts,))  # type: ignore[arg-type]

    def build(settings: Any, seed: int) -> Scenario:
        log = Log()
        log.add("a", 0.0, 0.0)
        return Scenario.single(log, lambda _: Outcome(given), lambda _: {"a": Metric(1.0, "m")}, lambda _: [], [])

    result = run_scenario("x", build, SimpleNamespace(model_dump=lambda mode: {}), 0)
    assert result.outcome == outcome and result.completed == (outcome == "completed") == (not result.reason)
    assert result.metrics["contacts_unwanted"].value == len(touches) and result.metrics["clearance_min"].value == 0.02
    assert result.metrics["fell"].value == float(ending.fell)


def test_what_a_baseline_touches_is_a_fault_and_no_collision_of_the_run() -> None:
    contacts = SimpleNamespace(touches=[Touch(1.0, "base", "door")], clearance=0.02)
    part = Part("ik", lambda _: Outcome(Ending(contacts=(contacts,))), baseline=True)  # type: ignore[arg-type]
    run = run_parts(Scenario(Log(), [part], lambda _: {}, lambda _: [], []))
    assert run.collision == "" and run.faults == ["ik: base touches door at 1.00 s"]


def test_every_drive_has_the_lag_that_was_drawn_for_it() -> None:
    """What a drive has taken of a constant command after a time t is 1 − exp(−t / lag)."""
    plant, time = SwervePlant(SWERVE.description, seed=4, settle=0.0), 0.02
    ones = SwerveCommand(np.full(4, 0.3), np.full(4, 0.3), np.full(6, 0.1), np.zeros(4))
    plant.step(ones, round(time / plant.timestep))
    lags = -time / np.log(1.0 - plant.data.act / plant.data.ctrl)
    order = [plant.model.actuator(i).name for i in range(plant.model.nu)]
    drawn = {}
    for group, values in (
        ("wheel", plant.draw.wheel_lag),
        ("steer", plant.draw.mount_lag),
        ("arm", plant.draw.arm_lag),
    ):
        drawn |= dict(zip(plant._names[group], values, strict=True))
    np.testing.assert_allclose(lags, [drawn[name] for name in order], rtol=1e-6)
    assert 0.014 <= lags.min() < 0.019 and 0.021 < lags.max() <= 0.026  # 20 ms, each ± 30 %
    assert len({round(float(lag), 9) for lag in lags}) == plant.model.nu
    ball = BallPlant(BALL.description, seed=4)
    ball_lags = ball.model.actuator_dynprm[:, 0]
    np.testing.assert_allclose(ball_lags, [*ball.draw.wheel_lag, *ball.draw.arm_lag])
    assert np.ptp(ball_lags) > 2e-3
