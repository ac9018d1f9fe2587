"""Brakes in time, their faults, and the brake tests of the simulated robot. Truth: 200 N m of the paper, Coulomb friction."""

from __future__ import annotations

import numpy as np
import pytest

from effort import thorough
from wbmpc.bases.swerve.brakes import BRAKE_TORQUE, Brakes
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.perturbation import StuckBrake, SwervePerturbation
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.registry import REGISTRY


def test_torque_rises_and_falls_within_the_delay() -> None:
    brakes = Brakes(2, delay=0.1)
    assert brakes.states == ["closed", "closed"]
    brakes.command([1.0, 0.0])
    torques = np.array([brakes.advance(0.01) for _ in range(12)])
    assert torques[:, 1] == pytest.approx(BRAKE_TORQUE)
    assert torques[[0, 4, 9, 11], 0] == pytest.approx([180.0, 100.0, 0.0, 0.0], abs=1e-9)
    brakes.command([0.0, 0.0])
    assert brakes.advance(0.05)[0] == pytest.approx(100.0) and brakes.states[0] == "closing"
    brakes.command([1.0, 0.0])
    assert brakes.states[0] == "opening"
    assert Brakes(1).advance(0.001) == pytest.approx([BRAKE_TORQUE])


def test_a_stuck_brake_does_not_answer_until_it_is_repaired() -> None:
    brakes = Brakes(2)
    brakes.fail(1, "closed")
    brakes.command([1.0, 1.0])
    assert brakes.advance(0.001) == pytest.approx([0.0, BRAKE_TORQUE])
    brakes.fail(1, None)
    assert brakes.advance(0.001) == pytest.approx([0.0, 0.0])
    brakes.fail(0, "open")
    brakes.command([0.0, 0.0])
    assert brakes.advance(0.001) == pytest.approx([0.0, BRAKE_TORQUE])
    with pytest.raises(InputError, match="no leg 2"):
        brakes.fail(2, "open")
    with pytest.raises(InputError, match="valid: open, closed"):
        brakes.fail(0, "rusty")


@thorough
def test_the_experiment_reaches_its_goals() -> None:
    """Fig. 4 of the paper: closed brakes hold the pushed robot, open ones do not, least of all in H."""
    experiment = REGISTRY["swerve-brakes"]
    result = experiment.run(experiment.config_type(), 3, None)
    m = {name: metric.value for name, metric in result.metrics.items()}
    assert {n: x.met for n, x in result.metrics.items() if x.met is False} == {}
    assert 195.0 < m["brake_slip_torque"] < 206.0
    assert m["displacement_closed"] < 3e-4 < 0.02 < m["displacement_open"] == m["displacement_open_H"]
    assert m["displacement_open"] > 5.0 * max(m["displacement_open_X"], m["displacement_open_A"])
    # Coulomb: the force that slides the robot is friction times weight, which is drawn within 5 %
    assert 0.6 * 950.0 < m["slide_force"] < 0.9 * 1045.0
    shares = [result.log.array(f"slide_{n}")[-1, 2] for n in "HXA"]
    assert shares == pytest.approx(np.ones(3), abs=0.06)
    for plot in result.plots:
        assert all(len(s.x) == len(s.y) > 0 for s in plot.series)


def test_a_brake_fails_as_the_settings_say() -> None:
    robot = load_robot("swerve-ur10")
    settings = SwervePerturbation.none(brake_fault=StuckBrake(kind="open", leg=2, time=0.01))
    plant = SwervePlant(robot.description, None, settings)
    plant.step(SwerveCommand.stop(4, 6), 10)
    assert plant.brakes.engaged == pytest.approx(np.ones(4))
    for _ in range(2):  # it is looked at once a command
        plant.step(SwerveCommand.stop(4, 6), 15)
    assert plant.brakes.engaged == pytest.approx([1.0, 1.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("name", "leg", "words"),
    [
        ("swerve-ur10", 4, "no leg 4 with a brake; valid: 0"),
        ("swerve-fixed-ur10", 0, "valid: a robot with legs that move"),
    ],
)
def test_a_brake_that_is_not_there_cannot_fail(name: str, leg: int, words: str) -> None:
    settings = SwervePerturbation(brake_fault=StuckBrake(kind="closed", leg=leg))
    with pytest.raises(InputError, match=words):
        SwervePlant(load_robot(name).description, None, settings)
