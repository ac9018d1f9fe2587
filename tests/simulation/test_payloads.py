"""Masses at the end effector and on the body, a sloping floor. Truth: statics by hand; the arm's lever by the planner's kinematics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.robots import load_description
from wbmpc.simulation.any_perturbation import AnyPerturbation

ROBOT = load_robot("swerve-ur10")
G = 9.81


def plant(**settings: float) -> SwervePlant:
    return SwervePlant(ROBOT.description, None, AnyPerturbation.none(**settings), 3)


def rest(p: SwervePlant, seconds: float) -> None:
    for _ in range(round(seconds / 0.0025)):
        p.step(SwerveCommand.stop(), 5)


@pytest.mark.parametrize(
    ("settings", "added"), [({}, 0.0), ({"payload": 10.0}, 10.0), ({"body_payload": 150.0}, 150.0)]
)
def test_the_ground_carries_what_the_robot_carries(settings: dict[str, float], added: float) -> None:
    p = plant(**settings)
    rest(p, 0.5)
    assert p.truth().wheel_force.sum() / G == pytest.approx(100.87 + added, abs=0.05)


def test_a_payload_pulls_the_arm_down_because_nobody_feeds_its_weight_forward() -> None:
    mass, p = 8.0, plant(payload=8.0)
    rest(p, 0.3)
    x, name, h = p.truth().state, ROBOT.input.groups["arm"][1], 1e-6
    moved = x.copy()
    moved[ROBOT.state["arm"].start + 1] += h
    lever = (ROBOT.pose(moved)[0] - ROBOT.pose(x)[0])[2] / h
    gain = 12.0 * ROBOT.description.limits.effort[name]
    speed = p.truth().joint_speeds[name]
    # a servo of that gain, beside 1 N m s/rad of damping, with the weight's torque on it
    assert abs(lever) > 0.3
    assert speed == pytest.approx(-mass * G * lever / (gain + 1.0), rel=0.02)
    q = plant()
    rest(q, 0.3)
    assert abs(q.truth().joint_speeds[name]) < 1e-3 * abs(speed)


def test_a_load_lies_in_the_middle_of_the_body_and_turns_with_it() -> None:
    light, heavy = plant(), plant(body_payload=150.0)
    for p in (light, heavy):
        rest(p, 0.5)
    more = heavy.truth().wheel_force - light.truth().wheel_force
    # the tires sink in, and an unsymmetrical load would show as different shares
    assert more == pytest.approx(np.full(4, 150.0 * G / 4), rel=0.05)
    box = heavy.model.body("body_payload").id
    assert heavy.model.body_inertia[box] == pytest.approx(
        [150 / 12 * (0.5**2 + 0.2**2), 150 / 12 * (0.6**2 + 0.2**2), 150 / 12 * (0.6**2 + 0.5**2)]
    )


def test_on_a_slope_weight_pulls_downhill_and_the_robot_stands() -> None:
    slope, p = np.radians(3.0), plant(slope=float(np.radians(3.0)))
    start = p.truth().pose
    rest(p, 0.5)
    truth = p.truth()
    assert truth.wheel_force.sum() / G == pytest.approx(100.87 * np.cos(slope), abs=0.05)
    assert np.abs(truth.pose - start).max() < 2e-3 and truth.tilt < 1e-3
    up = p.measure().accel
    assert np.linalg.norm(up) == pytest.approx(G, rel=1e-3)
    assert np.arccos(up[2] / np.linalg.norm(up)) == pytest.approx(slope, abs=2e-3)
    # what it shows is the reaction: uphill
    assert np.arctan2(-up[1], -up[0]) == pytest.approx(p.draw.downhill, abs=0.1)


def test_every_seed_slopes_another_way() -> None:
    ways = [AnyPerturbation().draw(np.random.default_rng(k), [], 4, 6).downhill for k in range(100)]
    assert min(ways) < -2.8 and max(ways) > 2.8


@pytest.mark.parametrize(
    "name",
    [
        "payload",
        "body_payload",
        "slope",
        "steer_offset",
        "dry_friction",
        "brake_delay",
        "encoder_counts",
        "steer_noise",
    ],
)
def test_a_ball_robot_rejects_them(name: str) -> None:
    """What it does not have; nothing of it (0) is what it has."""
    with pytest.raises(InputError, match=f"plant.{name}: .*'rezero'.* does not read it; valid: "):
        BallPlant(
            load_description("rezero"),
            perturbation=AnyPerturbation.none(**{name: 7 if name == "encoder_counts" else 0.4}),
        )


@pytest.mark.parametrize("name", ["wheel_rotor", "arm_rotor", "spring_damping", "torque_gain", "torque_damping"])
def test_rigid_drives_have_no_rotors(name: str) -> None:
    with pytest.raises(ValueError, match=rf"{name}\n.*not permitted"):
        AnyPerturbation(drives={"kind": "rigid", name: 0.7})
    assert getattr(AnyPerturbation(drives={"kind": "elastic", name: 0.7}).drives, name) == 0.7


@pytest.mark.parametrize(("plant", "robot"), [(BallPlant, "rezero"), (SwervePlant, "swerve-ur10")])
def test_a_rejected_start_is_no_command(plant: Any, robot: str) -> None:
    with pytest.raises(InputError, match=r"^start: 'state"):
        plant(load_description(robot), np.zeros(3))
