"""The base type ``omnidirectional``. Truth: MuJoCo's kinematics and rolling rollers, textbook formulas of mecanum and omni wheels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

from effort import some
from planar_driving import RADIUS, Wheel, drive, follow_line, ideal_plant, kinematics_error, write_robot
from wbmpc.bases import base_type
from wbmpc.bases.omnidirectional.plant import ROLLERS
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.simulation.any_perturbation import AnyPerturbation

ROBOT = load_robot("mecanum-ur10")
#: Of the built-in robot's file: half the distances of the wheels along x and y [m], radius [m].
LX, LY, WHEEL = 0.3, 0.28, 0.1
#: (vx, vy, wz) for 2 s each.
TWISTS = ((0.3, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.5), (0.2, -0.15, 0.3))
OMNI: dict[str, Any] = {"type": "omnidirectional", "rollers": "omni"}


def mecanum_rates(vx: float, vy: float, w: float) -> np.ndarray:
    """LF, RF, LB, RB [rad/s], as textbooks have them."""
    turn = (LX + LY) * w
    return np.array([vx - vy - turn, vx + vy + turn, vx + vy - turn, vx - vy + turn]) / WHEEL


def ring(count: int, radius: float = 0.25, start: float = 0.0) -> list[Wheel]:
    """Omni wheels on a ring that roll along it, counterclockwise at positive rates."""
    angles = start + 2.0 * np.pi * np.arange(count) / count
    return [((radius * np.cos(a), radius * np.sin(a)), (-np.cos(a), -np.sin(a), 0.0)) for a in angles]


def ring_rates(angles: np.ndarray, vx: float, vy: float, w: float, radius: float = 0.25) -> np.ndarray:
    """Of the wheels of :func:`ring`: speed along the ring over the wheel's radius."""
    return (-np.sin(angles) * vx + np.cos(angles) * vy + radius * w) / RADIUS


def rollers(tmp_path: Path, angles: list[float]) -> RobotModel:
    """The built-in robot with rollers at other angles [deg]."""
    source = Path(ROBOT.description.source)
    data = yaml.safe_load(source.read_text())
    data["base"]["rollers"] = angles
    data["model"] = str(ROBOT.description.model)
    (tmp_path / "other.yaml").write_text(yaml.safe_dump(data))
    return load_robot(tmp_path / "other.yaml")


def test_kinematics_are_those_of_the_file():
    assert kinematics_error(ROBOT) < 1e-9


def test_the_wheel_matrix_is_the_textbooks(tmp_path: Path):
    for twist in TWISTS:
        assert ROBOT.base.rates @ twist == pytest.approx(mecanum_rates(*twist))
    same = rollers(tmp_path, [-45.0, 45.0, 45.0, -45.0])
    assert same.base.rates == pytest.approx(ROBOT.base.rates)


def within(moved: np.ndarray, twist: tuple[float, ...]) -> bool:
    """Whether 2 s of driving went where the twist leads, to 4 % of the way (lengths [m], turns [rad] alike)."""
    expected = 2.0 * np.array(twist)
    return bool(np.abs(moved - expected).max() < 0.04 * np.linalg.norm(expected))


def test_mecanum_wheels_drive_the_twist_in_the_world():
    plant = ideal_plant(ROBOT)
    for twist in TWISTS:
        assert within(drive(plant, mecanum_rates(*twist), 2.0), twist)
    assert plant.truth().tilt < 0.002
    assert plant.truth().wheel_force.sum() == pytest.approx(plant.weight, rel=0.05)


def test_rollers_that_stand_the_other_way_drive_elsewhere(tmp_path: Path):
    plant = ideal_plant(rollers(tmp_path, [45.0, -45.0, -45.0, 45.0]))
    moved = drive(plant, mecanum_rates(0.0, 0.3, 0.0), 2.0)
    assert not within(moved, (0.0, 0.3, 0.0)) and moved[1] < -0.3


def test_three_omni_wheels_drive_the_twist_in_the_world(tmp_path: Path):
    robot = load_robot(write_robot(tmp_path, ring(3), OMNI))
    angles, plant = 2.0 * np.pi * np.arange(3) / 3, ideal_plant(robot)
    assert kinematics_error(robot) < 1e-9
    for twist in TWISTS:
        assert robot.base.rates @ twist == pytest.approx(ring_rates(angles, *twist))
        assert within(drive(plant, ring_rates(angles, *twist), 2.0), twist)


def test_any_number_of_wheels(tmp_path: Path):
    robot = load_robot(write_robot(tmp_path, ring(5, start=0.3), OMNI))
    angles = 0.3 + 2.0 * np.pi * np.arange(5) / 5
    assert robot.base.rates @ TWISTS[3] == pytest.approx(ring_rates(angles, *TWISTS[3]))
    assert within(drive(ideal_plant(robot), ring_rates(angles, *TWISTS[3]), 2.0), TWISTS[3])


@pytest.mark.parametrize("angle", [0.0, 45.0, -45.0])
def test_rollers_make_a_round_wheel(tmp_path: Path, angle: float):
    """The lowest point of MuJoCo's ellipsoids over a whole turn of a wheel."""
    plant = ideal_plant(rollers(tmp_path, [angle, 45.0, 45.0, -45.0]))
    model, data = plant.model, plant.data
    geoms = [model.geom(f"wheel_LF_roller_{k}").id for k in range(ROLLERS)]
    lowest = []
    data.qpos[3:7] = [1.0, 0.0, 0.0, 0.0]
    for turn in np.linspace(0.0, 2.0 * np.pi, 200):
        data.joint("wheel_LF").qpos[0] = turn
        mujoco.mj_kinematics(model, data)
        hub = data.body("wheel_LF_body").xpos[2]
        below = [
            np.linalg.norm(model.geom_size[g] * data.geom_xmat[g].reshape(3, 3)[2]) - data.geom_xpos[g, 2]
            for g in geoms
        ]
        lowest.append(max(below) + hub)
    assert max(lowest) <= WHEEL + 1e-6 and min(lowest) > WHEEL - 1e-4


@pytest.mark.parametrize("seed", some([0, 1], [0]))
def test_the_end_effector_follows_a_line_while_the_base_drives(seed: int):
    estimated, world, driven = follow_line("mecanum-ur10", seed)
    assert estimated < 5.0 and world < 20.0
    assert driven > 1.5


@pytest.mark.parametrize(
    ("wheels", "base", "words"),
    [
        # all roll along x: nothing holds the base sideways
        ([((0.2, 0.2), (0, 1, 0)), ((0.2, -0.2), (0, 1, 0)), ((-0.2, 0.2), (0, 1, 0))], OMNI, ("base.wheels", "rank 2, 3 is needed")),
        (ring(2), OMNI, ("base.wheels", "do not determine the motion")),
        # the rollers' axles meet in the middle: nothing holds the base against turning
        (
            [((x, y), (0, 1, 0)) for x, y in ((0.2, 0.2), (0.2, -0.2), (-0.2, 0.2), (-0.2, -0.2))],
            {**OMNI, "rollers": [45.0, -45.0, -45.0, 45.0]},
            ("base.wheels", "rank 2, 3 is needed"),
        ),
        (ring(4), {**OMNI, "rollers": "mecanum"}, ("base.rollers", "an angle [deg] for each wheel")),
        (ring(3), {**OMNI, "rollers": [0.0, 0.0]}, ("rollers", "3 angles are needed")),
        (ring(3), {**OMNI, "rollers": [0.0, 0.0, 90.0]}, ("base.rollers", "75")),
        (ring(3), {**OMNI, "rollers": "swedish"}, ("base.rollers", "mecanum")),
    ],
)  # fmt: skip
def test_what_is_no_omnidirectional_base_is_named(tmp_path: Path, wheels: Any, base: Any, words: tuple[str, ...]):
    with pytest.raises(InputError) as error:
        load_robot(write_robot(tmp_path, wheels, base))
    assert all(word in str(error.value) for word in ("robot.yaml", *words)), str(error.value)


def test_a_perturbation_that_the_plant_does_not_read_is_an_error():
    with pytest.raises(InputError, match=r"plant\.floor_cables: .* does not read it; valid: "):
        base_type("omnidirectional").plant(ROBOT, AnyPerturbation(floor_cables=0.01), 0)
