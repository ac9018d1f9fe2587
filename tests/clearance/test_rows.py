"""Clearance rows. Truth: distances measured at the state itself, and their finite differences."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import wbmpc as wb
from wbmpc.clearance.nearest import Poses
from wbmpc.clearance.rows import ObstacleRows, SelfRows
from wbmpc.model.robot import RobotModel
from wbmpc.obstacles.pairs import draw_states
from wbmpc.obstacles.world import Snapshot
from wbmpc.ocp.symbols import Symbols

ROBOTS = ("differential-ur10", "rezero")
GRID = np.linspace(0.0, 2.0, 9)


def evaluate(robot: RobotModel, residual: wb.residuals.Residual) -> ca.Function:
    """Rows and their derivative by the state, of state and parameters."""
    x, u, p = (
        ca.SX.sym(n, k) for n, k in (("x", robot.state.size), ("u", robot.input.size), ("p", residual.reference))
    )
    h = residual(Symbols(x, u, ca.SX(0, 1), ca.SX(robot.mode.size, 1), p, x, u))
    return ca.Function("rows", [x, p], [h, ca.jacobian(h, x)])


def rows_of(residual: wb.residuals.Residual) -> ObstacleRows | SelfRows:
    return (ObstacleRows if isinstance(residual, wb.residuals.Clearance) else SelfRows)(residual)


def world_about(x: float) -> Snapshot:
    world = wb.Obstacles()
    world.set("pillar", wb.shapes.Cylinder((x, 0.9, 0), (x, 0.9, 1.5), 0.1))
    world.set("shelf", wb.shapes.Box((0.3, 0.1, 0.3)), position=(x + 0.5, -0.9, 0.8), velocity=(0.05, 0, 0))
    world.set("floor", wb.shapes.HalfSpace((0, 0, 1), -0.4))
    world.set(
        "stone", wb.shapes.ConvexMesh(np.random.default_rng(0).normal(size=(12, 3)) * 0.1), position=(x + 0.9, 0, 0.4)
    )
    return world.snapshot(0.0)


def distances(rows: ObstacleRows, snapshot: Snapshot, t: float, x: np.ndarray) -> np.ndarray:
    """(F, O) beyond the margins."""
    near, margin = rows.measure(snapshot, Poses(np.array([t]), *rows.finder.kinematics(x[None])))
    return (near.distance - margin)[0]


@pytest.mark.parametrize("name", ROBOTS)
def test_rows_have_the_value_and_the_slope_of_the_distance(name: str) -> None:
    robot = wb.load_robot(name)
    residual = wb.residuals.Clearance(robot, slots=4, margin=0.04)
    rows, function = rows_of(residual), evaluate(robot, residual)
    snapshot, compared = world_about(0.6), 0
    for k, seed in ((0, 1), (4, 2), (8, 3)):
        x = robot.home.copy()
        x[robot.state["arm"]] += np.random.default_rng(seed).uniform(-0.4, 0.4, x[robot.state["arm"]].shape)
        h, slope = (np.array(v) for v in function(x, rows.refresh(snapshot, GRID, np.tile(x, (len(GRID), 1)))[k]))
        truth = distances(rows, snapshot, GRID[k], x)
        for f, part in enumerate(residual.groups.values()):  # of long frames ends come behind the obstacles
            own, finite = h[part][:4, 0], np.isfinite(truth[f])
            np.testing.assert_allclose(own, np.where(finite, truth[f], 1.0), atol=1e-6)
            for o in np.flatnonzero(finite & (truth[f] > 0.0)):
                step = 1e-4 * np.random.default_rng(f).normal(size=robot.state.size)
                ends = [distances(rows, snapshot, GRID[k], x + s * step)[f, o] for s in (1, -1)]
                assert slope[part][o] @ step == pytest.approx(0.5 * (ends[0] - ends[1]), abs=3e-6)
                compared += 1
    assert compared >= 3


def test_the_nearest_obstacles_beyond_their_margins_take_the_slots() -> None:
    robot = wb.load_robot("rezero")
    residual, snapshot = wb.residuals.Clearance(robot, slots=2), world_about(0.6)
    parameters = rows_of(residual).refresh(snapshot, GRID[:2], np.tile(robot.home, (2, 1)))
    h = np.array(evaluate(robot, residual)(robot.home, parameters[0])[0]).ravel()
    truth = distances(rows_of(residual), snapshot, 0.0, robot.home)
    for f in range(len(rows_of(residual).index)):
        expected = np.sort(np.minimum(truth[f], 1.0))[:2]
        np.testing.assert_allclose(np.sort(h[2 * f : 2 * f + 2]), expected, atol=1e-6)


def test_margins_grow_with_the_spread_of_the_prediction() -> None:
    robot = wb.load_robot("rezero")
    world = wb.Obstacles()
    residual = wb.residuals.Clearance(robot, slots=1, margin=0.03)
    values = []
    for spread in ({}, {"std": 0.01, "velocity_std": 0.05}):
        world.set("ball", wb.shapes.Sphere(0.1, (0.6, 0, 0.3)), seen=0.0, **spread)
        parameters = rows_of(residual).refresh(world.snapshot(0.0), GRID, np.tile(robot.home, (len(GRID), 1)))
        values.append([np.array(evaluate(robot, residual)(robot.home, p)[0])[0, 0] for p in parameters])
    # twice the standard deviation of the position at each time
    np.testing.assert_allclose(values[0] - np.array(values[1]), 2.0 * np.hypot(0.01, 0.05 * GRID), atol=1e-9)


def test_parameters_of_zeros_are_no_obstacle() -> None:
    robot = wb.load_robot("rezero")
    for residual in (wb.residuals.Clearance(robot), wb.residuals.SelfClearance(robot)):
        h, slope = evaluate(robot, residual)(robot.home, np.zeros(residual.reference))
        assert np.array_equal(np.array(h), np.ones((residual.size, 1))) and not np.array(slope).any()


def test_pairs_come_nearer_no_faster_than_joints_brake() -> None:
    """Truth: differences of the measured distance h along the motion under an input; T is the time in which the slowest joint stops from
    its full speed L with its share of the limit a: L / (0.6 a)."""
    robot = wb.load_robot("panda")
    residual = wb.residuals.SelfClearance(robot, margin=0.01)
    limits, arm = robot.limits, robot.input["arm"]
    assert residual.approach == pytest.approx(float(np.max(limits.input_upper[arm] / (0.6 * limits.input_rate[arm]))))
    x, u = ca.SX.sym("x", robot.state.size), ca.SX.sym("u", robot.input.size)
    r, none = ca.SX.sym("r", residual.reference), ca.SX(0, 1)
    h = ca.Function("h", [x, u, r], [residual(Symbols(x, u, none, none, r, x, u))])
    rng, rows, checked = np.random.default_rng(3), rows_of(residual), 0
    for state in draw_states(robot, 300, seed=1):
        rates = rng.uniform(limits.input_lower, limits.input_upper)
        parameters, distance = rows.refresh(state[None])[0], rows.measure(state[None])[0].copy()
        ends = [rows.measure((state + s * 1e-5 * rates)[None])[0].copy() for s in (1.0, -1.0)]
        near = (distance < 0.2) & (distance > 0.002)
        slope = (ends[0][near] - ends[1][near]) / 2e-5
        expected = distance[near] - np.array(residual.margins)[near] + residual.approach * slope
        np.testing.assert_allclose(np.array(h(state, rates, parameters))[near, 0], expected, atol=2e-4)
        checked += int(near.sum())
    assert checked > 50
    plain = wb.residuals.SelfClearance(robot, margin=0.01, approach=0.0)
    assert not ca.depends_on(plain(Symbols(x, u, none, none, r, x, u)), u)
    assert (
        wb.residuals.SelfClearance(wb.load_robot("rezero")).approach == 0.0
    )  # its torques are limited, not its accelerations


def test_rows_of_two_bodies_do_not_depend_on_where_the_base_is() -> None:
    robot = wb.load_robot("rezero")
    residual = wb.residuals.SelfClearance(
        robot, [("base", "arm_upper_link"), ("base", "arm_forearm_link")], margin=0.02
    )
    rng = np.random.default_rng(0)
    states = np.tile(robot.home, (4, 1))
    states[:, robot.state["base"]] = 0.3 * rng.normal(size=(4, 5))
    states[:, robot.state["arm"]] = [[0.0, 1.9, 0.9], [1.0, 1.7, 1.0], [-1.0, -1.9, -0.8], [2.0, 1.8, 1.2]]
    parameters, function = rows_of(residual).refresh(states), evaluate(robot, residual)
    distance, checked = rows_of(residual).measure(states), 0
    for k in range(len(states)):
        h, slope = (np.array(v) for v in function(states[k], parameters[k]))
        near = (distance[k] < 0.25) & (distance[k] > 0.0)
        np.testing.assert_allclose(h[near, 0], (distance[k] - residual.margins)[near], atol=1e-6)
        step = 1e-4 * rng.normal(size=robot.state.size)
        ends = [rows_of(residual).measure((states[k] + s * step)[None])[0] for s in (1, -1)]
        np.testing.assert_allclose((slope @ step)[near], 0.5 * (ends[0] - ends[1])[near], atol=3e-6)
        checked += int(near.sum())
    assert checked >= 4
    columns = set(np.array(function.sparsity_out(1).get_triplet()[1]).tolist())
    assert columns.isdisjoint(range(*robot.state["base"].indices(robot.state.size)))


def test_what_happens_between_two_nodes_counts() -> None:
    """A base that passes a corner between nodes: truth is the distance at the middle."""
    robot = wb.load_robot("differential-ur10")
    residual = wb.residuals.Clearance(robot, ["chassis"], slots=1, margin=0.03)
    states = np.tile(robot.home, (2, 1))
    states[:, 0] = [-0.6, 0.6]
    world = wb.Obstacles()
    world.set("post", wb.shapes.Cylinder((0, 0.45, 0), (0, 0.45, 0.3), 0.05))
    snapshot, grid, function = world.snapshot(0.0), np.array([0.0, 1.5]), evaluate(robot, residual)
    parameters = rows_of(residual).refresh(snapshot, grid, states)
    middle = min(
        distances(rows_of(residual), snapshot, 0.0, np.r_[s, robot.home[1:]])[0, 0] for s in np.linspace(-0.6, 0.6, 9)
    )
    ends = [distances(rows_of(residual), snapshot, 0.0, x)[0, 0] for x in states]
    assert middle < min(ends) - 0.02
    for x, p in zip(states, parameters):
        # states between the nodes are at most 0.08 m apart
        assert float(function(x, p)[0][0]) == pytest.approx(middle, abs=0.01)


def test_a_thin_wall_that_a_plan_jumps_over_keeps_it_on_its_side() -> None:
    robot = wb.load_robot("differential-ur10")
    residual = wb.residuals.Clearance(robot, ["chassis"], slots=1, margin=0.03)
    front = 0.4  # of the chassis' box, in the file
    states = np.tile(robot.home, (6, 1))
    states[:, 0] = [0.0, 0.3, 0.6, 2.5, 2.6, 2.7]  # the wall is at 1.5: nodes 3 to 5 are behind it
    world = wb.Obstacles()
    world.set("wall", wb.shapes.Box((0.01, 3, 1)), position=(1.5, 0, 0.5))
    parameters = rows_of(residual).refresh(world.snapshot(0.0), np.linspace(0, 3, 6), states)
    function = evaluate(robot, residual)
    for x, p in zip(states[2:], parameters[2:]):
        h, slope = function(x, p)
        assert float(h[0]) == pytest.approx(1.49 - front - x[0] - 0.03, abs=1e-5)
        assert float(slope[0, 0]) == pytest.approx(-1.0)  # back is out


def test_somebody_who_walks_over_a_standing_robot_makes_it_leave_the_track() -> None:
    """Rows of nodes that are run over point across the track. Truth: distances of the robot that is moved by what they lack, at all times."""
    robot = wb.load_robot("differential-ur10")
    residual = wb.residuals.Clearance(robot, ["chassis"], slots=1)
    rows, grid = rows_of(residual), np.linspace(0.0, 4.0, 21)
    world, states = wb.Obstacles(), np.tile(robot.home, (21, 1))
    person = wb.shapes.Cylinder((0, 0, 0), (0, 0, 1.8), 0.2)
    world.set("person", person, position=(0.1, 2.0, -0.3), velocity=(0, -1.0, 0), seen=0.0)
    snapshot, function = world.snapshot(0.0), evaluate(robot, residual)
    values = [function(x, p) for x, p in zip(states, rows.refresh(snapshot, grid, states))]
    h, slope = np.array([float(v[0][0]) for v in values]), np.array([np.array(v[1])[0] for v in values])
    lack, lateral = -h.min(), np.abs(slope[h < -0.01])
    assert lack > 0.2 and (lateral[:, 1] < 1e-9).all() and (lateral[:, 0] > 1.0 - 1e-9).all()
    side = slope[np.argmin(h), 0]
    states[:, 0] += side * (lack + 1e-6)
    assert min(distances(rows, snapshot, t, x)[0, 0] for t, x in zip(grid, states)) > -1e-6
    # the other side takes more
    states[:, 0] -= 2.0 * side * (lack + 1e-6)
    assert min(distances(rows, snapshot, t, x)[0, 0] for t, x in zip(grid, states)) < -0.1


def test_all_frames_leave_a_track_to_the_same_side() -> None:
    """Somebody walks through the front of a standing robot: its front legs alone would go ahead, its body back. Truth: the signs of the
    rows' slopes by the base's position across the track."""
    robot = wb.load_robot("swerve-ur10")
    residual = wb.residuals.Clearance(robot, slots=1)
    rows, grid = rows_of(residual), np.linspace(0.0, 4.0, 21)
    world, states = wb.Obstacles(), np.tile(robot.home, (21, 1))
    world.set(
        "person",
        wb.shapes.Cylinder((0, 0, 0), (0, 0, 1.8), 0.2),
        position=(0.4, 2.5, 0.0),
        velocity=(0, -1.2, 0),
        seen=0.0,
    )
    function = evaluate(robot, residual)
    values = [function(x, p) for x, p in zip(states, rows.refresh(world.snapshot(0.0), grid, states))]
    h, slope = np.array([np.array(v[0]).ravel() for v in values]), np.array([np.array(v[1]) for v in values])
    across = slope[..., robot.state["base"]][..., 0][h < -0.05]
    assert across.size > 5 and len(np.unique(np.sign(across))) == 1


@pytest.mark.parametrize("aside", [0.0, 0.75])
def test_who_runs_ahead_of_somebody_leaves_the_track_in_the_end(aside: float) -> None:
    """A plan keeps its distance from a person who walks behind the robot for all of the horizon; with ``aside`` [m] between their tracks the
    person passes. Truth: slopes along and across the track, and distances of the robot that is moved by what rows lack."""
    robot, speed = wb.load_robot("differential-ur10"), 0.5
    residual = wb.residuals.Clearance(robot, ["chassis"], slots=1)
    rows, grid = rows_of(residual), np.linspace(0.0, 4.0, 21)
    world, states = wb.Obstacles(), np.tile(robot.home, (21, 1))
    states[:, 0] += speed * grid
    person = wb.shapes.Cylinder((0, 0, 0), (0, 0, 1.8), 0.2)
    world.set("person", person, position=(-0.66, 0.05 + aside, -0.3), velocity=(speed, 0, 0), seen=0.0)
    snapshot, function = world.snapshot(0.0), evaluate(robot, residual)
    values = [function(x, p) for x, p in zip(states, rows.refresh(snapshot, grid, states))]
    h, slope = np.array([float(v[0][0]) for v in values]), np.array([np.array(v[1])[0, :2] for v in values])
    assert distances(rows, snapshot, 0.0, states[0])[0, 0] > 0.0
    late = (grid >= 3.0) & (aside == 0.0)
    assert (np.abs(slope[late, 1]) > 1.0 - 1e-9).all() and (h[~late] > 0.0).all()
    assert ((slope[~late, 0] > 0.9) if aside == 0.0 else (slope[:, 0] < 0.7)).all()
    if late.any():
        assert len(np.unique(np.sign(slope[late, 1]))) == 1 and h[late].max() < -0.4
        states[late, 1] += slope[-1, 1] * (1e-6 - h[late].min())
        assert min(distances(rows, snapshot, t, x)[0, 0] for t, x in zip(grid[late], states[late])) > -1e-6


def test_a_grid_keeps_the_robot_from_what_is_in_it() -> None:
    """Truth: the distance to the plane that the grid holds, less its error and what balls around the shapes add."""
    robot = wb.load_robot("differential-ur10")
    residual = wb.residuals.Clearance(robot, ["chassis"], slots=1, margin=0.0)
    x = -1.0 + 0.05 * np.arange(61)
    values = np.broadcast_to((1.5 - x)[:, None, None], (61, 41, 20))
    world = wb.Obstacles()
    world.set("map", wb.shapes.DistanceGrid((-1.0, -1.0, -0.2), 0.05, values))
    states = np.tile(robot.home, (2, 1))
    states[:, 0] = [0.7, 0.9]
    parameters = rows_of(residual).refresh(world.snapshot(0.0), np.array([0.0, 1.0]), states)
    for state, p in zip(states, parameters):
        h, slope = evaluate(robot, residual)(state, p)
        true = 1.5 - 0.4 - state[0]
        assert true - 0.5 * np.sqrt(3) * 0.05 - 0.07 < float(h[0]) < true - 0.5 * np.sqrt(3) * 0.05 + 1e-9
        assert float(slope[0, 0]) == pytest.approx(-1.0)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda r: wb.residuals.Clearance(r, ["nose"]), "unknown frame with shapes 'nose'"),
        (lambda r: wb.residuals.Clearance(r, []), "at least one"),
        (lambda r: wb.residuals.Clearance(r, slots=0), "slots: a whole number from 1 on is needed"),
        (lambda r: wb.residuals.Clearance(r, margin=-0.1), "'margin' must not be negative"),
        (lambda r: wb.residuals.SelfClearance(r, [("base", "nose")]), "unknown frame with shapes 'nose'"),
        (lambda r: wb.residuals.SelfClearance(r, []), "at least one pair"),
    ],
)
def test_a_wrong_residual_is_named(make, words: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(wb.InputError, match=words):
        make(wb.load_robot("rezero"))
