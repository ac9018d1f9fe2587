"""Swerve bases that the library has never seen, built from their descriptions only, drive a short way.

Truth: the reference's end pose against MuJoCo's true pose of the base; rigid-body geometry of the ring of modules.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from driving import Motion, drive
from effort import some
from own_bases import write_base
from wbmpc.bases.swerve.brake_control import BrakeControl
from wbmpc.bases.swerve.brake_monitor import BrakeMonitor
from wbmpc.bases.swerve.brake_supervision import SupervisionSettings
from wbmpc.bases.swerve.configurations import corners
from wbmpc.bases.swerve.perturbation import SwervePerturbation
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.stability import assess, configuration_positions
from wbmpc.studies.pankert2022 import brakes as swerve_brakes
from wbmpc.studies.pankert2022 import unified as swerve_unified
from wbmpc.studies.pankert2022.directions import beyond_range, reject_directions
from wbmpc.studies.pankert2022.mission import at_home
from wbmpc.studies.pankert2022.rolling import RollingController
from wbmpc.studies.pankert2022.unified import rear_triangles
from wbmpc.studies.pankert2022.unified_settings import SwerveUnifiedSettings

BASES = {"3 fixed": (3, False), "4 on hinges": (4, True), "6 fixed": (6, False), "6 on hinges": (6, True)}
SWING = 0.15


@pytest.mark.parametrize("base", some(["3 fixed", "4 on hinges", "6 fixed"], [0]))
def test_it_drives_forward_sideways_and_turns(base: str, tmp_path: Path) -> None:
    """Body twist (0.15, 0.12 m/s, 0.2 rad/s) for 2 s from rest; the odometry says the same within 1.5 %."""
    path = write_base(tmp_path, *BASES[base])
    motion = Motion((0.15, 0.12, 0.2), 2.0, start=1.0)
    result = drive(motion, str(path), perturbation=SwervePerturbation(), seed=2)
    assert result.reason == ""
    way = np.linalg.norm(result.reference * [1, 1, 0.8])
    assert way > 0.35
    missing = np.linalg.norm((result.truth - result.reference) * [1, 1, 0.8])
    assert missing <= 0.05 * way, f"{result.truth} instead of {result.reference}"
    lost = np.linalg.norm((result.truth - result.odometry) * [1, 1, 0.8])
    assert lost <= 0.015 * way, f"the odometry says {result.odometry}, the base is at {result.truth}"


@pytest.mark.parametrize("base", BASES)
def test_geometry_is_that_of_the_ring(base: str, tmp_path: Path) -> None:
    modules, hinged = BASES[base]
    robot = load_robot(write_base(tmp_path, modules, hinged))
    g = robot.base.geometry
    assert (g.modules, g.legs_move, "leg" in robot.state) == (modules, hinged, hinged)
    angles = 0.4 + 2.0 * np.pi * np.arange(modules) / modules
    reach = 0.35 + 0.03 * (np.arange(modules) % 2) + 0.3
    places = reach[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    np.testing.assert_allclose(g.steer_axes(np.zeros(modules)), places, atol=1e-12)
    assert robot.state.size == 3 + modules * (2 + hinged) + 2


@pytest.mark.parametrize("modules", some([3, 6], [0]))
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
    plant = SwervePlant(robot.description, robot.state.split(x), SwervePerturbation(), 3)
    watching = SupervisionSettings(monitor=monitor)
    controller = RollingController(robot, np.zeros(3), period, goals, brakes=brakes.commanded, supervision=watching)
    for k in range(1000):
        controller.measure(plant.measure())
        plant.step(controller.drive(k * period), 5)
    truth = plant.truth()
    np.testing.assert_allclose(truth.state[leg], 0.5 - SWING * sent, atol=0.02)
    assert np.hypot(*truth.pose[:2]) < 0.01 and abs(truth.pose[2]) < 0.02
    assert monitor.faults == []


def test_what_a_base_with_few_modules_cannot_do_is_said(tmp_path: Path) -> None:
    two = load_robot(write_base(tmp_path, 2, True))
    with pytest.raises(InputError, match=r"needs a base that stands on 3 feet or more; .* stands on 2$"):
        assess(two)
    with pytest.raises(InputError, match=r"stands on 2 wheels.*casters are not simulated"):
        SwervePlant(two.description)
    with pytest.raises(InputError, match=r"stands on 2 wheels.*3 modules or more"):  # no advice about legs.goal
        swerve_unified.EXPERIMENT.run(SwerveUnifiedSettings(robot=str(tmp_path / "ring.yaml")), 0)
    five = write_base(tmp_path, 5, True)
    with pytest.raises(InputError, match=r"unknown configuration .X.; valid: 5 angles in rad"):
        configuration_positions(load_robot(five), "X")
    with pytest.raises(InputError, match=r"unknown configuration.*legs\.goal: angles, as \[0.2, 0.2, 0.2, 0.2, 0.2\]"):
        swerve_unified.EXPERIMENT.run(SwerveUnifiedSettings(robot=str(five)), 0)
    with pytest.raises(InputError, match=r"unknown configuration"):
        swerve_brakes.EXPERIMENT.run(swerve_brakes.SwerveBrakesSettings(robot=str(five)), 0)
    four = swerve_brakes.SwerveBrakesSettings(robot=str(write_base(tmp_path, 4, True, 0.25 * np.pi)))
    with pytest.raises(InputError, match=r"configuration A: .* outside its limits -1.2 to 1.2"):
        swerve_brakes.EXPERIMENT.run(four, 0, lambda share, text: pytest.fail("simulated before it was rejected"))


# ---------------------------------------------------------------------- steering ranges
def test_a_steering_range_of_less_than_half_a_turn_is_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Wheels 0 and 2 point along 45° of the body at angle 0, 1 and 3 along 135°: the range decides what they reach."""
    wide, short = (
        write_base(tmp_path / n, 4, False, 0.25 * np.pi, r) for n, r in (("a", (-1.57, 1.57)), ("b", (-1.2, 1)))
    )
    load_robot(wide)
    assert caplog.messages == []
    robot = load_robot(short)
    assert "'m0_steer' (and 3 more) turns from -1.2 to 1 rad" in caplog.messages[0]
    t, none = np.array([0.0, 0.5]), np.zeros((2, 4))

    def ask(angle: float, speed: float = 0.2) -> None:
        twists = np.array([[0.0, 0.0, 0.0], [speed * np.cos(angle), speed * np.sin(angle), 0.0]])
        reject_directions(robot, t, twists, none, none)

    for angle in (1.2, 1.7, 0.1, -0.3, 0.1 + np.pi):
        ask(angle)
    ask(0.7, speed=0.01)  # hardly moves
    with pytest.raises(InputError, match=r"at 0.50 s .*'m1_steer' to roll along 40° .*misses that by 26°"):
        ask(0.7)  # needs 0.7 - 2.356 = -1.656 or 1.485 rad
    with pytest.raises(InputError, match=r"'m0_steer' to roll along 126° .*misses that by 24°"):
        ask(2.2)


@pytest.mark.parametrize("span", [(-0.2, 1.4), (-1.0, 1.0), (2.0, 3.0)])
def test_what_a_range_misses_is_that_of_every_half_turn(span: tuple[float, float]) -> None:
    angle = np.linspace(-9.0, 9.0, 181)
    turned = angle[:, None] + np.pi * np.arange(-8, 9)
    missed = np.maximum(np.maximum(span[0] - turned, turned - span[1]), 0.0).min(axis=1)
    np.testing.assert_allclose(beyond_range(angle[:, None], [span[0]], [span[1]])[:, 0], missed, atol=1e-12)
    for low, high in ((-np.inf, np.inf), (0.0, np.inf), (-1.6, 1.6)):
        assert not beyond_range(angle[:, None], [low], [high]).any()


# ---------------------------------------------------------------------- legs
@pytest.mark.parametrize("start", [0.7854, 0.9])
def test_configurations_are_where_legs_point(start: float, tmp_path: Path) -> None:
    """H along ±x and X at 45° outwards, whatever the legs' directions at joint angle 0 and the order of the modules."""
    path = write_base(tmp_path, 4, True, start)
    for turned in (False, True):
        data = yaml.safe_load(path.read_text())
        if turned:
            data["base"]["modules"] = data["base"]["modules"][::-1]
            path.write_text(yaml.safe_dump(data))
        robot = load_robot(path)
        order = (3, 2, 1, 0) if turned else (0, 1, 2, 3)  # LF, LB, RB, RF
        assert corners(robot) == {n: order[k] for n, k in (("LF", 0), ("RF", 3), ("LB", 1), ("RB", 2))}
        g = robot.base.geometry
        for name, headings in (("H", (0, 180, 180, 0)), ("X", (45, 135, -135, -45))):
            try:
                legs = configuration_positions(robot, name)
            except InputError as error:  # 1.2 rad are what a hinge has
                assert start > 0.8 and name == "H" and "outside its limits -1.2 to 1.2" in str(error)
                continue
            away = g.steer_axes(legs) - g.hinge
            want = np.radians(headings)[list(order)]
            np.testing.assert_allclose(away, 0.3 * np.stack([np.cos(want), np.sin(want)], axis=1), atol=1e-9)


@pytest.mark.parametrize("modules", [3, 5])
def test_rear_triangles_have_both_rearmost_feet(modules: int, tmp_path: Path) -> None:
    robot = load_robot(write_base(tmp_path, modules, True))
    legs = np.full(modules, 0.1)
    rear = sorted(range(modules), key=lambda i: robot.base.geometry.steer_axes(legs)[i, 0])[:2]
    found = rear_triangles(robot, legs)
    assert {tuple(sorted(t)) for t in found} == {tuple(sorted((*rear, k))) for k in range(modules) if k not in rear}


def test_legs_that_begin_elsewhere_leave_the_wheels_along_their_directions(tmp_path: Path) -> None:
    robot = load_robot(write_base(tmp_path, 5, True, steering=(-1.8, 1.8)))
    legs = np.array([1.0, -1.1, 0.4, -0.2, 1.1])
    x, g = at_home(robot, legs), robot.base.geometry
    part, home = robot.state["steer"], robot.home
    across = np.sin(x[part] + legs - home[part])
    np.testing.assert_allclose(across, 0.0, atol=1e-12)
    assert np.all(np.abs(x[part]) <= 1.8) and np.array_equal(x[robot.state["leg"]], legs) and g.modules == 5
