"""Wheels that carry little slip where others roll. Truth: MuJoCo's contact forces, a box in closed form, a way that is written down."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planar_driving import HEIGHT, ideal_plant, write_robot
from wbmpc.bases.planar_motion.controller import PlanarController, WheelTrust
from wbmpc.bases.planar_motion.messages import PlanarCommand, PlanarMeasurement
from wbmpc.constants import GRAVITY
from wbmpc.model.robot import load_robot
from wbmpc.obstacles.pairs import draw_states

CORNERS = [((x, y), (0.0, 1.0, 0.0)) for x in (0.3, -0.3) for y in (0.25, -0.25)]


def test_loads_at_rest_are_those_of_the_simulator() -> None:
    robot = load_robot("panda-omni")
    trust, none, plant = WheelTrust.of(robot), np.zeros(robot.input.size), ideal_plant(robot)
    forces = []
    for _ in range(20):
        plant.step(PlanarCommand.stop(3, 7), 10)
        forces.append(plant.truth().wheel_force)
    mean = np.mean(forces, axis=0)
    assert trust is not None
    np.testing.assert_allclose(trust.shares(robot.home, none, none), mean / mean.mean(), atol=0.05)


def test_loads_move_with_accelerations(tmp_path: Path) -> None:
    """A box whose mass is h above the floor: its front wheels lose a h / (g x) of their load when it accelerates ahead."""
    robot = load_robot(write_robot(tmp_path, CORNERS, {"type": "omnidirectional", "rollers": "mecanum"}))
    light = [replace(link, mass=0.0) for link in robot.tree.links]
    mast = np.array([0.0, 0.0, 0.8 - HEIGHT])
    robot.base.tree = replace(
        robot.tree, links=(replace(light[0], mass=40.0, com=mast, inertia=np.zeros((3, 3))), *light[1:])
    )
    trust, none = WheelTrust(robot), np.zeros(robot.input.size)
    change = none.copy()
    change[0] = 1.5
    part = 1.5 * 0.8 / (GRAVITY * 0.3)
    np.testing.assert_allclose(
        trust.shares(robot.home, none, change), [1 - part, 1 - part, 1 + part, 1 + part], atol=1e-6
    )
    np.testing.assert_allclose(trust(robot.home, none, change), trust.shares(robot.home, none, change) ** 2, atol=1e-9)


def test_a_wheel_that_carries_little_is_not_believed() -> None:
    """It spins by a fifth more than it rolls, while the arm leans to the other wheels, and the base drives aside for a meter."""
    robot = load_robot("panda-omni")
    trust, none = WheelTrust.of(robot), np.zeros(robot.input.size)
    assert trust is not None
    state = min(draw_states(robot, 200), key=lambda x: float(trust.shares(x, none, none).min()))
    spins = int(np.argmin(trust.shares(state, none, none)))
    twist, off = np.array([0.2, 0.46, 0.0]), {}
    for believed in (True, False):
        controller = PlanarController(robot, np.zeros(3), 0.0025)
        if believed:
            assert controller._trust is not None
        else:
            controller._trust = None
        for k in range(1201):  # 1 s of rest, in which the gyro's bias is found
            turned = robot.base.rates @ twist * 0.0025 * max(k - 400, 0)
            turned[spins] *= 1.2
            controller.measure(PlanarMeasurement(0.0025 * k, turned, state[robot.state["arm"]]))
        off[believed] = float(np.linalg.norm(controller.pose[:2] - 2.0 * twist[:2]))
    assert off[True] < 0.2 * off[False] and off[False] > 0.03


@pytest.mark.parametrize("name", ["pr2", "ur5"])
def test_robots_whose_wheels_loads_are_unknown_have_no_weights(name: str) -> None:
    assert WheelTrust.of(load_robot(name)) is None
