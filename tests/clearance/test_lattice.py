"""Routes of the base. Truth: distances of MuJoCo's shapes on the way, and closed forms."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
import pytest

import wbmpc as wb
from clearing import TrueDistance
from planar_driving import write_robot
from test_tasks import WHEELS
from wbmpc.clearance.lattice import HEADINGS, MOVES

BOX = mujoco.mjtGeom.mjGEOM_BOX
MARGIN = 0.05


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> wb.RobotModel:
    return wb.load_robot(write_robot(tmp_path_factory.mktemp("driving"), WHEELS, {"type": "differential"}))


def walls(boxes: list[tuple[list[float], list[float]]]) -> wb.Obstacles:
    """Boxes by half lengths (3) and places (3) [m]."""
    world = wb.Obstacles()
    for k, (half, place) in enumerate(boxes):
        world.set(f"wall{k}", wb.shapes.Box(half), position=place)
    return world


def test_headings_are_those_of_the_moves() -> None:
    assert len(MOVES) == 16 and len({tuple(m) for m in MOVES.tolist()}) == 16
    length = np.linalg.norm(MOVES, axis=1)
    np.testing.assert_allclose(length * np.array([np.cos(HEADINGS), np.sin(HEADINGS)]), MOVES.T, atol=1e-9)
    assert (np.diff(HEADINGS) > 0.0).all() and HEADINGS[-1] < 2.0 * np.pi


def test_with_nothing_in_the_way_it_turns_goes_and_turns(robot: wb.RobotModel) -> None:
    start, goal = np.array([0.3, -0.2, 0.7]), np.array([2.0, 1.0, -0.4])
    route = wb.plan_route(robot, wb.Obstacles(), start, goal)
    np.testing.assert_allclose(route[0], start)
    np.testing.assert_allclose(np.angle(np.exp(1j * (route[-1] - goal)))[2], 0.0, atol=1e-9)
    np.testing.assert_allclose(route[-1, :2], goal[:2], atol=1e-9)
    way = np.linalg.norm(np.diff(route[:, :2], axis=0), axis=1).sum()
    assert way == pytest.approx(np.hypot(1.7, 1.2), rel=1e-9)
    heading = np.arctan2(1.2, 1.7)
    moves = np.linalg.norm(np.diff(route[:, :2], axis=0), axis=1) > 1e-9
    np.testing.assert_allclose(route[:-1][moves, 2], heading, atol=1e-9)


def test_it_finds_the_way_out_of_a_dead_end(robot: wb.RobotModel) -> None:
    """A niche opens towards the start: straight on is closed. Truth: MuJoCo's distances at 2 cm and 0.02 rad along the route."""
    boxes = [([0.05, 0.8, 0.5], [1.5, 0, 0]), ([0.5, 0.05, 0.5], [1.0, 0.8, 0]), ([0.5, 0.05, 0.5], [1.0, -0.8, 0])]
    world, start, goal = walls(boxes), np.array([0.9, 0.0, 0.0]), np.array([2.6, 0.0, 0.0])
    route = wb.plan_route(robot, world, start, goal, margin=MARGIN)
    truth = TrueDistance(robot, [(BOX, half) for half, _ in boxes])
    places = [np.array(place) for _, place in boxes]
    least = np.inf
    for a, b in itertools.pairwise(route):
        count = int(max(np.linalg.norm((b - a)[:2]) / 0.02, abs(b[2] - a[2]) / 0.02)) + 2
        for pose in np.linspace(a, b, count):
            x = robot.home.copy()
            x[robot.state["base"]] = pose
            least = min(least, truth(x, places))
    # between two poses that are looked at it may come nearer by a part of their distance
    assert MARGIN - 0.01 < least < 0.4
    assert route[:, 0].min() < 0.5  # it backs out of the niche


def test_where_none_leads_it_says_so(robot: wb.RobotModel) -> None:
    around = [
        ([0.05, 2, 1], [2.0, 0, 0]),
        ([0.05, 2, 1], [-2.0, 0, 0]),
        ([2, 0.05, 1], [0, 2.0, 0]),
        ([2, 0.05, 1], [0, -2.0, 0]),
    ]
    start = np.zeros(3)
    with pytest.raises(wb.NoRoute, match="no way leads"):
        wb.plan_route(robot, walls(around), start, [3.5, 0.0, 0.0], cell=0.2)
    with pytest.raises(wb.NoRoute, match="at the goal is not"):
        wb.plan_route(robot, walls(around), start, [1.9, 0.0, 0.0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"goal": [1.0, 0.0]}, "goal"), ({"cell": 0.0}, "cell"), ({"margin": -1.0}, "margin"), ({"bounds": [[1, 1], [0, 0]]}, "bounds"),
     ({"cell": 1e-3}, "cells are too many")],
)  # fmt: skip
def test_bad_arguments_are_named(robot: wb.RobotModel, changes: dict[str, object], message: str) -> None:
    given: dict[str, object] = {"start": np.zeros(3), "goal": [1.0, 0.0, 0.0], **changes}
    with pytest.raises(wb.InputError, match=message):
        wb.plan_route(robot, wb.Obstacles(), **given)  # type: ignore[arg-type]
