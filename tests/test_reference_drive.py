"""The drive from which bases learn their wheels before a run. Truth: the radii that the simulated robot was made with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planar_driving import write_robot
from wbmpc.bases import base_type
from wbmpc.errors import InputError, RunAborted
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.simulation.any_perturbation import AnyPerturbation
from wbmpc.tasks import reference_drive
from wbmpc.tasks.loop import make_system
from wbmpc.tasks.settings import MujocoPlant, TaskSettings

WHEELS = [((0.0, 0.2), (0.0, 1.0, 0.0)), ((0.0, -0.2), (0.0, 1.0, 0.0))]
#: Radii that differ, and nothing else.
PLANT = AnyPerturbation.none(wheel_radius_each=0.01)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    return load_robot(write_robot(tmp_path_factory.mktemp("driving"), WHEELS, {"type": "differential"}))


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Strokes of 1 m and 1 rad, and no calibration that was kept before."""
    for name, value in (("STRAIGHT", 1.0), ("TURN", 1.0), ("STANDING", 0.5), ("BENDS", 0)):
        monkeypatch.setattr(reference_drive, name, value)
    monkeypatch.setenv("WBMPC_CACHE_DIR", str(tmp_path))


def test_a_run_knows_the_radii_that_its_robot_has(robot: RobotModel, short: None, monkeypatch: Any) -> None:
    plant = MujocoPlant(**dict(PLANT), calibration="drive")
    settings = TaskSettings(robot=robot.description.source, plant=plant)
    kind = base_type("differential")
    made = make_system(robot, kind.mpc(robot), settings, 0)
    true, known = made.plant.draw.radius - 1.0, made.controller.odometry.wheels
    assert abs(true[0] - true[1]) > 4e-3
    assert known.radius[0] - known.radius[1] == pytest.approx(true[0] - true[1], abs=1e-3)
    assert (known.radius + known.speed[0]).mean() == pytest.approx(true.mean(), abs=1.5e-3)
    # wheels get the speeds with which the base does what the plan says
    straight = made.controller.wheel_matrix() @ np.array([0.3, 0.0])
    assert straight[0] / straight[1] == pytest.approx((1.0 + true[1]) / (1.0 + true[0]), abs=1e-3)
    monkeypatch.setattr(reference_drive, "drive", None)  # the second time it is kept
    again = reference_drive.calibration(robot, PLANT, 0)
    assert again is not None and np.array_equal(again["radius"], known.radius)


def test_orders_lead_back_and_forth_with_every_speed_of_the_base() -> None:
    for name, directions in (("differential-ur10", 2), ("mecanum-ur10", 3)):
        orders = np.array(reference_drive.strokes(load_robot(name)))
        whole, orders = orders, orders[: 4 * directions + 1]
        moving = orders[np.abs(orders[:, 1:]).max(axis=1) > 0.0]
        assert len(moving) == 2 * directions and len(orders) == 4 * directions + 1
        np.testing.assert_allclose((moving[:, :1] * moving[:, 1:]).sum(axis=0), 0.0, atol=1e-12)
        bends = whole[len(orders) :]  # of a base that cannot go to the side: all pressed to the same one
        assert len(bends) == (4 * reference_drive.BENDS + 1) * (directions == 2)
        assert (bends[:, 1] * bends[:, 3] >= 0.0).all()
        np.testing.assert_allclose((bends[:, :1] * bends[:, 1:]).sum(axis=0), 0.0, atol=1e-12)


def test_a_drive_that_ends_early_gives_no_calibration(robot: RobotModel, short: None, monkeypatch: Any) -> None:
    monkeypatch.setattr(reference_drive, "drive", lambda *a: (None, "the robot fell at 3.00 s"))
    with pytest.raises(RunAborted, match="reference drive for the calibration: the robot fell"):
        reference_drive.calibration(robot, PLANT, 0)


def test_a_base_without_wheels_has_nothing_to_learn() -> None:
    assert reference_drive.calibration(load_robot("panda"), PLANT, 0) is None
    with pytest.raises(
        InputError, match=r"'panda' .* offers no calibration of its wheels \('calibrate'\); valid: .*differential"
    ):
        base_type("fixed").calibrate(load_robot("panda"), {}, "log")
