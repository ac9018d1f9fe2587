"""Ends of faces along an obstacle. Truth: corners of the chassis' box, turned by hand; MuJoCo's distances in the closed loop."""

from __future__ import annotations

import casadi as ca
import mujoco
import numpy as np
import pytest

import wbmpc as wb
from clearing import TrueDistance, run
from wbmpc.clearance.rows import ObstacleRows
from wbmpc.default_problem import default_mpc
from wbmpc.ocp.symbols import Symbols

#: Of the chassis' box of differential-ur10, in the file: its front [m] and half of its width [m]; how far a wall is in front of it [m].
FRONT, HALF, GAP = 0.4, 0.25, 0.05
MARGIN = 0.03
#: In front of the robot, with its surface at 0.
WALL = {
    "box": wb.shapes.Box((0.05, 3.0, 0.2), center=(0.05, 0.0, 0.0)),
    "half-space": wb.shapes.HalfSpace((-1.0, 0.0, 0.0)),
    "narrow": wb.shapes.Box((0.05, 0.15, 0.2), center=(0.05, 0.0, 0.0)),
    "pillar": wb.shapes.Cylinder((0.1, 0.0, -0.2), (0.1, 0.0, 0.2), 0.1),
}


def rows(shape: str, yaw: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows (2) of the chassis and their slopes by the base's yaw (2) of a robot that stands in front of a shape, turned by ``yaw`` [rad]."""
    robot, world = wb.load_robot("differential-ur10"), wb.Obstacles()
    residual = wb.residuals.Clearance(robot, ["chassis"], slots=1, margin=MARGIN)
    assert residual.size == 2
    world.set("it", WALL[shape], position=(FRONT + GAP, 0.0, 0.0))
    state = robot.home.copy()
    state[2] = yaw
    p = ObstacleRows(residual).refresh(world.snapshot(0.0), np.array([0.0, 0.5]), np.tile(state, (2, 1)))[0]
    x = ca.SX.sym("x", robot.state.size)
    h = residual(Symbols(x, ca.SX(robot.input.size, 1), ca.SX(0, 1), ca.SX(robot.mode.size, 1), ca.DM(p), x, x))
    value, slope = ca.Function("rows", [x], [h, ca.jacobian(h, x)[:, 2]])(state)
    return np.array(value).ravel(), np.array(slope).ravel()


@pytest.mark.parametrize("yaw", [0.0, 0.01, -0.01])
@pytest.mark.parametrize(("shape", "half"), [("box", HALF), ("half-space", HALF)])
def test_both_ends_of_a_face_along_a_wall_have_a_row(shape: str, half: float, yaw: float) -> None:
    value, slope = rows(shape, yaw)
    corners = [FRONT * np.cos(yaw) - y * np.sin(yaw) for y in (-half, half)]
    np.testing.assert_allclose(np.sort(value), np.sort(FRONT + GAP - np.array(corners)) - MARGIN, atol=1e-6)
    # the left end approaches the wall when the robot turns to the right
    np.testing.assert_allclose(np.sort(slope), [-half, half], atol=0.006)


def test_ends_are_those_of_what_two_faces_have_in_common() -> None:
    value, slope = rows("narrow", 0.0)
    np.testing.assert_allclose(value, GAP - MARGIN, atol=1e-6)
    np.testing.assert_allclose(np.sort(slope), [-0.15, 0.15], atol=0.003)


@pytest.mark.parametrize(("shape", "yaw"), [("box", 0.2), ("pillar", 0.0)])
def test_a_nearest_point_that_stays_has_one_row(shape: str, yaw: float) -> None:
    assert np.sort(rows(shape, yaw)[0])[1] == 1.0  # as without an obstacle


def test_a_robot_that_drives_along_a_wall_does_not_plan_to_turn_its_tail_in() -> None:
    """It is drawn to the wall all the way. Truth: MuJoCo's distances of the robot's file to the wall. With one row for the flank plans of
    the last second are up to 88 mm inside, and the robot comes 1.3 m far. (Which of two ways it takes along the wall hangs on the last digits:
    of walls moved by 0.1 µm some have plans that are 10 mm within the margin.)"""
    robot, world, half = wb.load_robot("mecanum-ur10"), wb.Obstacles(), [6.0, 0.05, 0.15]
    truth = TrueDistance(robot, [(mujoco.mjtGeom.mjGEOM_BOX, half)])
    center = np.array([0.0, 0.525, 0.0])
    world.set("wall", wb.shapes.Box(half), position=center)
    mpc, target = default_mpc(robot, obstacles=world), robot.home.copy()
    target[robot.state["base"]] += [2.0, 0.6, 0.0]
    mpc.reference["state"] = wb.Reference.constant(target)
    mpc.solver.set_weight("state", [50.0] * 3 + [0.1] * (robot.state.size - 3))
    position, orientation = robot.pose(target)
    mpc.reference["end_effector"] = wb.Reference.poses([0.0], [position], orientation)
    planned: list[float] = []
    ran = run(mpc, robot, truth, lambda t: [center], lambda t: planned.append(mpc.clearance.distance), 4.0)
    margin = robot.description.collision.margin
    assert margin - 0.005 < ran.least < margin + 0.005
    assert min(planned[-50:]) > 0.5 * margin
    assert ran.x[robot.state["base"]][0] > 1.8
