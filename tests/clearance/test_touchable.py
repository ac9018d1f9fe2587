"""Obstacles that some frames may touch, and distance grids that move."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import wbmpc as wb
from wbmpc.clearance.nearest import with_sides
from wbmpc.clearance.rows import ObstacleRows
from wbmpc.default_problem import default_mpc
from wbmpc.model.robot import RobotModel


def lowest(floor: bool) -> float:
    """Height [m] above the floor that the tool has at least when it is asked to go 0.3 m below. Truth: the file's forward kinematics."""
    own, world = wb.load_robot("differential-ur10").description, wb.Obstacles()
    alone = own.model_copy(update={"collision": own.collision.model_copy(update={"floor": False})})
    robot = RobotModel(alone)
    ground = robot.description.base.ground
    if floor:
        world.set("floor", wb.shapes.HalfSpace((0, 0, 1), ground), ignore=["chassis"])
    mpc = default_mpc(robot, obstacles=world)
    position, orientation = robot.pose(robot.home)
    goal = np.array([position[0], position[1], ground - 0.3])
    mpc.reference["end_effector"] = wb.Reference.poses([0.0], [goal], orientation)
    x, found = robot.home.copy(), np.inf
    for k in range(round(3.0 * mpc.rate)):
        policy = mpc.update(wb.Observation(k / mpc.rate, x))
        x = mpc.solver.simulate(x, policy(k / mpc.rate, x), mpc.period)
        found = min(found, float(robot.pose(x)[0][2]) - ground)
    return found


def test_the_arm_keeps_off_the_floor_on_which_the_wheels_stand() -> None:
    assert lowest(floor=False) < -0.1
    assert 0.03 < lowest(floor=True) < 0.3


def test_files_say_too_what_may_touch(tmp_path: Path) -> None:
    path, world = tmp_path / "scene.yaml", wb.Obstacles()
    path.write_text("obstacles: {floor: {half_space: {normal: [0, 0, 1]}, ignore: [chassis]}}")
    world.load(path)
    world.move("floor", (0, 0, -0.1))
    assert world.snapshot(0.0).obstacles[0].ignore == ("chassis",)


def test_frames_that_a_robot_has_not_are_named() -> None:
    robot, world = wb.load_robot("rezero"), wb.Obstacles()
    world.set("floor", wb.shapes.HalfSpace((0, 0, 1)), ignore=["wheels"])
    rows = ObstacleRows(wb.residuals.Clearance(robot))
    with pytest.raises(wb.InputError, match=r"obstacle 'floor', ignore: unknown frame with shapes 'wheels'"):
        rows.refresh(world.snapshot(0.0), np.zeros(1), robot.home[None])


def test_a_grid_that_moves_is_the_grid_where_it_is_then() -> None:
    """Truth: the same grid, standing at each of the places."""
    robot, axis = wb.load_robot("differential-ur10"), np.arange(-0.5, 0.51, 0.05)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    ball = wb.shapes.DistanceGrid((-0.5, -0.5, -0.5), 0.05, np.sqrt(x**2 + y**2 + z**2) - 0.2)
    times, turn = np.array([0.0, 0.5, 1.0]), np.array([np.cos(0.2), 0.0, 0.0, np.sin(0.2)])
    states, rows = np.tile(robot.home, (3, 1)), ObstacleRows(wb.residuals.Clearance(robot))
    world = wb.Obstacles()
    place, velocity = np.array([1.0, 0.1, 0.3]), np.array([-0.25, 0.05, 0.0])
    world.set("it", ball, position=place, orientation=turn, velocity=velocity, seen=0.0)
    moving = rows.refresh(with_sides(world.snapshot(0.0)), times, states)
    assert np.abs(np.diff(moving, axis=0)).max() > 0.01
    for k, t in enumerate(times):
        world.set("it", ball, position=place + t * velocity, orientation=turn)
        there = rows.refresh(with_sides(world.snapshot(0.0)), times, states)
        np.testing.assert_allclose(moving[k], there[k], atol=1e-9)
