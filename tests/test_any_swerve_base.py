"""Swerve bases that the library has never seen, built from their descriptions only, drive a short way.

Truth: the reference's end pose against MuJoCo's true pose of the base; rigid-body geometry of the ring of modules.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from driving import Motion, drive
from own_bases import write_base
from wbmpc.control import BrakeControl, RollingAgent
from wbmpc.errors import InputError
from wbmpc.estimation import BrakeMonitor
from wbmpc.model import load_robot
from wbmpc.plant import Perturbation, SwervePlant
from wbmpc.stability import assess, leg_angles

BASES = {"3 fixed": (3, False), "4 on hinges": (4, True), "6 fixed": (6, False), "6 on hinges": (6, True)}
SWING = 0.15


@pytest.mark.parametrize("base", ["3 fixed", "4 on hinges", "6 fixed"])
def test_it_drives_forward_sideways_and_turns(base: str, tmp_path: Path) -> None:
    """Body twist (0.15, 0.12 m/s, 0.2 rad/s) for 3 s from rest; the odometry says the same within 1 %."""
    path = write_base(tmp_path, *BASES[base])
    motion = Motion((0.15, 0.12, 0.2), 3.0, start=1.5)
    result = drive(motion, str(path), perturbation=Perturbation(), seed=2)
    assert result.reason == ""
    way = np.linalg.norm(result.reference * [1, 1, 0.8])
    assert way > 0.6
    missing = np.linalg.norm((result.truth - result.reference) * [1, 1, 0.8])
    assert missing <= 0.05 * way, f"{result.truth} instead of {result.reference}"
    lost = np.linalg.norm((result.truth - result.odometry) * [1, 1, 0.8])
    assert lost <= 0.015 * way, f"the odometry says {result.odometry}, the base is at {result.truth}"


@pytest.mark.parametrize("base", BASES)
def test_geometry_is_that_of_the_ring(base: str, tmp_path: Path) -> None:
    modules, hinged = BASES[base]
    robot = load_robot(write_base(tmp_path, modules, hinged))
    g = robot.base.geometry
    assert (g.modules, g.has_hinge, "leg" in robot.state) == (modules, hinged, hinged)
    angles = 0.4 + 2.0 * np.pi * np.arange(modules) / modules
    reach = 0.35 + 0.03 * (np.arange(modules) % 2) + 0.3
    places = reach[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    np.testing.assert_allclose(g.steer_axes(np.zeros(modules)), places, atol=1e-12)
    assert robot.state.size == 3 + modules * (2 + hinged) + 2


@pytest.mark.parametrize("modules", [3, 6])
def test_open_legs_of_any_number_swing_and_closed_ones_stand(modules: int, tmp_path: Path) -> None:
    """Every other leg is opened at 0.5 s and sent from 0.5 to 0.35 rad by its wheel; the base stands, and no brake is at fault."""
    robot = load_robot(write_base(tmp_path, modules, True))
    x, leg = robot.home.copy(), robot.state["leg"]
    x[leg], x[robot.state["steer"]] = 0.5, x[robot.state["steer"]] - 0.5
    sent, period = np.arange(modules) % 2 == 0, 0.0025
    brakes = BrakeControl(robot)
    brakes.set(0.5, sent.astype(float), x[leg])

    def goals(t: float) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
        share, rate = np.clip(t - 1.0, 0.0, 1.0), float(1.0 < t < 2.0)
        return (np.zeros(3), np.zeros(3)), (0.5 - SWING * share * sent, -SWING * rate * sent)

    monitor = BrakeMonitor(robot.state.groups["leg"], limit=robot.limits.input_upper[robot.input["leg"]])
    plant = SwervePlant(robot.description, robot.state.split(x), Perturbation(), 3)
    agent = RollingAgent(robot, np.zeros(3), period, goals, brakes=brakes.commanded, monitor=monitor)
    for k in range(1000):
        agent.measure(plant.measure())
        plant.step(agent.drive(k * period), 5)
    truth = plant.truth()
    np.testing.assert_allclose(truth.state[leg], 0.5 - SWING * sent, atol=0.02)
    assert np.hypot(*truth.pose[:2]) < 0.01 and abs(truth.pose[2]) < 0.02
    assert monitor.faults == []


def test_what_a_base_with_few_modules_cannot_do_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"3 modules or more, not one of 2$"):
        assess(load_robot(write_base(tmp_path, 2, True)))
    with pytest.raises(InputError, match=r"configuration X is of bases with two front and two rear legs"):
        leg_angles(load_robot(write_base(tmp_path, 3, True)), "X")
