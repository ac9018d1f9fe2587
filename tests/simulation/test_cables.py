"""Cables on the ball robot's floor. Truth: geometry of a ball that lies on two parallel edges."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from toys import robot
from wbmpc.bases.ball.messages import BallCommand
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.errors import InputError
from wbmpc.simulation.any_perturbation import AnyPerturbation

BALL = robot("rezero")


def test_a_ball_on_a_cable_is_as_much_higher_as_the_cable() -> None:
    home, torque = BALL.base.numeric.equilibrium(BALL.home[5:8])
    state = home.copy()
    state[0] = 0.1  # a cable lies there
    for height in (0.005, 0.01):
        plant = BallPlant(BALL.description, state, torque, AnyPerturbation(floor_cables=height), 0)
        data = plant.data
        touched = [
            plant.model.geom(int(g)).type[0]
            for pair in data.contact.geom
            for g in pair
            if plant.model.geom(int(g)).type[0] == mujoco.mjtGeom.mjGEOM_CAPSULE
        ]
        assert touched  # put down at the floor's height, it is in the cable
        deepest = -min(c.dist for c in data.contact)
        assert deepest == pytest.approx(height, rel=0.01)


def test_between_cables_nothing_changes() -> None:
    home, torque = BALL.base.numeric.equilibrium(BALL.home[5:8])
    ends = []
    for height in (0.0, 0.005):
        plant = BallPlant(BALL.description, home, torque, AnyPerturbation(floor_cables=height), 0)
        for _ in range(20):
            plant.step(BallCommand(torque), 5)
        ends.append(plant.state())
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


def test_swerve_robots_reject_them() -> None:
    with pytest.raises(InputError, match=r"plant\.floor_cables"):
        SwervePlant(robot("swerve-ur10").description, perturbation=AnyPerturbation(floor_cables=0.005))
