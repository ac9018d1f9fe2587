"""Closed loops among obstacles. Truth of clearances: the robot's own file in MuJoCo at fine time steps (:mod:`clearing`)."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import wbmpc as wb
from clearing import TrueDistance, keep_clear, reach_problem, run, write_arm
from wbmpc.bases import base_type
from wbmpc.bases.swerve.system import make_mpc
from wbmpc.clearance.rows import Clearance
from wbmpc.mpc.braking import braking_plan, braking_time

CYLINDER, BOX = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX
MARGIN = 0.03


def reaching(
    robot: wb.RobotModel, goal: np.ndarray, world: wb.Obstacles | None, frames: list[str] | None = None
) -> wb.MPC:
    """An MPC that brings the end effector to a position; without ``world`` it knows nothing of obstacles."""
    ocp = reach_problem(robot)
    if world is not None:
        keep_clear(ocp, wb.residuals.Clearance(robot, frames, slots=1, margin=MARGIN))
    mpc = wb.MPC(ocp, rate=25.0, obstacles=world)
    mpc.reference["end_effector"] = wb.Reference.poses([0.0], goal, robot.pose(robot.home)[1])
    mpc.reset(robot.home)
    return mpc


def pillar_world(place: np.ndarray) -> wb.Obstacles:
    world = wb.Obstacles()
    world.set("pillar", wb.shapes.Cylinder((0, 0, -0.5), (0, 0, 0.5), 0.05), position=place)
    return world


@pytest.mark.parametrize("known", [True, False])
def test_an_arm_goes_around_a_pillar(tmp_path: Path, known: bool) -> None:
    robot = wb.load_robot(write_arm(tmp_path))
    home = robot.pose(robot.home)[0]
    goal = np.array([0.1, home[0], home[2]])  # a quarter turn to the left, through the pillar
    place = np.array([0.43, 0.43, 0.3])
    mpc = reaching(robot, goal, pillar_world(place) if known else None)
    truth = TrueDistance(robot, [(CYLINDER, [0.05, 0.5])])
    ran = run(mpc, robot, truth, lambda t: [place], lambda t: None, 3.0)
    if known:
        assert ran.least > MARGIN - 0.010 and ran.missed < 0.02
    else:
        assert ran.least < 0.0


#: Bodies of the robot that drives which the frame of its chassis carries.
DRIVEN = ("chassis", "left_wheel", "right_wheel")


def only(truth: TrueDistance, bodies: tuple[str, ...]) -> None:
    """Measure these bodies alone."""
    truth.own = [g for g in truth.own if truth.model.body(truth.model.geom_bodyid[g]).name in bodies]


def driving(robot: wb.RobotModel, world: wb.Obstacles, ahead: float) -> wb.MPC:
    """The same with a robot that drives: its chassis alone keeps clear."""
    return reaching(robot, robot.pose(robot.home)[0] + [ahead, 0, 0], world, [robot.description.base.body])


def test_what_appears_within_the_stopping_distance_is_not_touched() -> None:
    robot, world = wb.load_robot("differential-ur10"), wb.Obstacles()
    mpc = driving(robot, world, 3.0)
    place, seen = np.array([1.7, 0.0, 0.2]), 1.2  # 0.2 m ahead at 0.8 m/s

    def change(t: float) -> None:
        if t >= seen and "box" not in world:
            world.set("box", wb.shapes.Box((0.1, 0.3, 0.2)), position=place)

    truth = TrueDistance(robot, [(BOX, [0.1, 0.3, 0.2])])
    only(truth, DRIVEN)
    ran = run(mpc, robot, truth, lambda t: [place], change, 1.8, seen_from=seen)
    assert ran.least > 0.0
    assert ran.mpc.statistics.failures == 0


def test_a_moving_obstacle_passes_and_the_robot_goes_on() -> None:
    robot, world = wb.load_robot("differential-ur10"), wb.Obstacles()
    mpc = driving(robot, world, 1.2)
    shape, speed = wb.shapes.Cylinder((0, 0, 0), (0, 0, 1.5), 0.15), 0.6
    place = lambda t: np.array([0.9, -1.6 + speed * t, 0.75])
    change = lambda t: world.set("person", shape, position=place(t) - [0, 0, 0.75], velocity=(0, speed, 0), seen=t)
    truth = TrueDistance(robot, [(CYLINDER, [0.15, 0.75])])
    only(truth, DRIVEN)
    ran = run(mpc, robot, truth, lambda t: [place(t)], change, 4.0)
    assert ran.least > MARGIN - 0.010 and ran.missed < 0.02


@pytest.mark.parametrize("velocity", [(-0.252, -0.294), (-0.65, 0.9)])
def test_a_swerve_robot_at_rest_evades_who_walks_through_it(velocity: tuple[float, float]) -> None:
    """In three seconds the person would be in the middle of the robot. Truth: distances of its shapes along the motion, and that no solve fails."""
    robot, world = wb.load_robot("swerve-ur10"), wb.Obstacles()
    mpc = make_mpc(robot, world)
    person, v = wb.shapes.Cylinder((0, 0, 0), (0, 0, 1.8), 0.2), np.array([*velocity, 0.0])
    x, places, states = robot.home.copy(), [], []
    for k in range(180):
        t = 0.02 * k
        places.append([0.1, 0.05, 0.0] + (t - 3.0) * v)
        world.set("person", person, position=places[-1], velocity=v, seen=t)
        states.append(x)
        x = mpc.solver.simulate(x, mpc.update(wb.Observation(t, x)).u[0], 0.02)
    truth = TrueDistance(robot, [(CYLINDER, [0.2, 0.9])])
    assert min(truth(x, [p + [0, 0, 0.9]]) for x, p in zip(states, places, strict=True)) > 0.01
    assert mpc.statistics.failures == 0


def test_a_ball_robot_steps_aside_for_who_comes_head_on() -> None:
    """Somebody walks through the place that it holds. Truth: distances of its shapes along the motion; it is not pushed along, for the end
    effector stays within a step of its place."""
    robot, world = wb.load_robot("rezero"), wb.Obstacles()
    mpc = base_type("ball").mpc(robot, obstacles=world)
    person, v = wb.shapes.Cylinder((0, 0, 0), (0, 0, 1.8), 0.2), np.array([-0.5, 0.0, 0.0])
    home, ground = robot.pose(robot.home)[0], robot.description.base.ground
    x, places, states = robot.home.copy(), [], []
    for k in range(300):
        t = 0.02 * k
        places.append([1.5, 0.03, ground] + t * v)
        world.set("person", person, position=places[-1], velocity=v, std=0.015, velocity_std=0.02, seen=t)
        states.append(x)
        x = mpc.solver.simulate(x, mpc.update(wb.Observation(t, x)).u[0], 0.02)
    truth = TrueDistance(robot, [(CYLINDER, [0.2, 0.9])])
    assert min(truth(s, [p + [0, 0, 0.9]]) for s, p in zip(states, places, strict=True)) > 0.01
    away = [float(np.linalg.norm(robot.pose(s)[0] - home)) for s in states]
    assert max(away) < 1.0 and away[-1] < 0.05 and mpc.statistics.failures == 0


def test_a_plan_that_stays_in_an_obstacle_is_searched_again_from_itself_and_then_from_a_stop() -> None:
    """Solves that change nothing stand for those that are stuck: the start of each search is what is left in the solver."""
    robot, world = wb.load_robot("differential-ur10"), wb.Obstacles()
    mpc = driving(robot, world, 3.0)
    rows, solver, nothing = mpc._clear, mpc.solver, lambda age, passes: None
    grid = solver.node_times(0.0)
    u = np.zeros((len(grid) - 1, robot.input.size))
    u[:, robot.input["base"]] = [0.5, 0.0]
    x = np.tile(robot.home, (len(grid), 1))
    x[:, robot.state["base"]] += np.outer(0.5 * grid, [1.0, 0.0, 0.0])
    solver.warm_start(x, u)
    world.set("box", wb.shapes.Box((0.1, 0.3, 0.2)), position=(0.5 + 0.5 * grid[-1], 0.0, 0.2))
    rows.update_snapshot(0.0)
    assert [rows.search_is_due(t) for t in (0.0, 0.02, 0.06)] == [False, False, True]
    plan = solver.trajectory()
    assert not rows.search(0.06, x[0], plan, nothing, lambda: False)
    assert np.array_equal(solver.trajectory().x, x)
    assert not rows.search_is_due(0.08) and rows.search_is_due(0.16)
    assert rows.search(0.16, x[0], plan, nothing, lambda: False)  # the stop is clear
    ends = solver.trajectory().x[-2:, robot.state["base"]]
    assert np.abs(ends[1] - ends[0]).max() < 1e-9 and 0.0 < ends[1, 0] < 0.5
    assert not rows.search_is_due(0.18)


def test_the_policy_says_what_its_plan_is_nearest_to(tmp_path: Path) -> None:
    robot = wb.load_robot(write_arm(tmp_path))
    place = np.array([0.85, 0.0, 0.3])
    mpc = reaching(robot, robot.pose(robot.home)[0], pillar_world(place))
    policy = mpc.update(wb.Observation(0.0, robot.home))
    clearance = policy.clearance
    assert isinstance(clearance, Clearance) and clearance.other == "pillar"
    truth = TrueDistance(robot, [(CYLINDER, [0.05, 0.5])])
    least = [truth(x, [place]) for x in policy.x]
    assert clearance.distance == pytest.approx(min(least), abs=1e-5)
    assert clearance.node == int(np.argmin(least)) and clearance.time == policy.times[clearance.node]
    assert mpc.solve_info["clearance"] == clearance.distance
    mpc.update(wb.Observation(0.04, robot.home))
    assert "pillar" in str(mpc.clearance)


def test_obstacles_come_and_go_without_a_new_solver(tmp_path: Path) -> None:
    robot, world = wb.load_robot(write_arm(tmp_path)), wb.Obstacles()
    mpc = reaching(robot, robot.pose(robot.home)[0], world)
    solver, kernel = mpc.solver, mpc.solver.kernel
    for k, count in enumerate((0, 3, 60, 1, 0)):
        world.clear()
        for i in range(count):
            world.set(f"ball {i}", wb.shapes.Sphere(0.05), position=(0.9 + 0.2 * i, 0, 0.3))
        clearance = mpc.update(wb.Observation(0.04 * k, robot.home)).clearance
        assert clearance is not None and np.isfinite(clearance.distance) == (count > 0)
    assert mpc.solver is solver and solver.kernel is kernel


def test_an_arm_does_not_fold_into_its_foot(tmp_path: Path) -> None:
    """Truth: MuJoCo's distance between the forearm and the foot of the file. Without rows the arm goes through."""
    robot = wb.load_robot(write_arm(tmp_path))
    least = {}
    for keep in (True, False):
        ocp = reach_problem(robot)
        if keep:
            keep_clear(ocp, wb.residuals.SelfClearance(robot, [("foot", "fore"), ("foot", "upper")], margin=0.02))
        mpc = wb.MPC(ocp, rate=25.0)
        mpc.reference["end_effector"] = wb.Reference.poses([0.0], [0.02, 0.0, 0.06], [1, 0, 0, 0])
        mpc.reset(robot.home)
        truth = TrueDistance(robot, [(CYLINDER, [0.08, 0.05])])  # the foot once more
        only(truth, ("fore",))
        least[keep] = run(mpc, robot, truth, lambda t: [np.array([0.0, 0.0, 0.05])], lambda t: None, 3.0).least
    assert least[True] > 0.01 and least[False] < 0.0


def test_a_stop_takes_as_long_as_the_limits_say_and_ends_at_rest(tmp_path: Path) -> None:
    """Truth: v² / 2a of a rate that falls evenly, with the file's 6 rad/s²."""
    robot = wb.load_robot(write_arm(tmp_path))
    mpc = reaching(robot, robot.pose(robot.home)[0], wb.Obstacles())
    u = np.array([1.5, 0.0, -0.6])
    duration = braking_time(mpc.ocp.dynamics, robot, robot.home, u)
    assert duration == pytest.approx(1.5 / 6.0)
    plan = braking_plan(mpc.solver, robot.home, u, mpc.ocp.grid, duration)
    np.testing.assert_allclose(plan.x[-1] - robot.home, [1.5**2 / 12, 0.0, -0.6 * 1.5 / 12], atol=1e-9)
    assert not plan.u[mpc.ocp.grid[:-1] >= 0.25].any()


def test_what_stands_in_the_way_at_once_is_answered_by_a_stop(tmp_path: Path) -> None:
    """A wall that cuts the plan and the stop: what is published stands still, and the statistics and the log say so."""
    robot, world = wb.load_robot(write_arm(tmp_path)), wb.Obstacles()
    home = robot.pose(robot.home)[0]
    mpc = reaching(robot, np.array([0.1, home[0], home[2]]), world)
    x = robot.home
    for k in range(12):
        x = mpc.solver.simulate(x, mpc.update(wb.Observation(0.04 * k, x))(0.04 * k, x), 0.04)
    assert abs(mpc.solver.trajectory().u[0, 0]) > 0.5
    angle = x[0] + 0.07  # the arm would need 0.19 rad to stop
    normal = np.array([np.sin(angle), -np.cos(angle), 0.0])
    world.set("wall", wb.shapes.HalfSpace(normal, -0.045))
    policy = mpc.update(wb.Observation(0.48, x))
    # either way the robot stops within its limits
    assert abs(policy(0.48 + 0.35)[0]) < 0.05
    assert policy.state(1.0)[0] <= x[0] + 1.5**2 / 12 + 0.01


def test_a_stop_is_forgotten_with_its_plan(tmp_path: Path) -> None:
    """After a reset stops take as long as limits say; they took 10 ms, the rest of the one that had begun."""
    robot = wb.load_robot(write_arm(tmp_path))
    mpc = reaching(robot, robot.pose(robot.home)[0], wb.Obstacles())
    mpc.update(wb.Observation(0.0, robot.home))
    rows = mpc._clear
    rows._stops_at, rows._search = 0.3, (0.2, 1)
    mpc.reset(robot.home)
    mpc.update(wb.Observation(1.0, robot.home))
    mpc.solver.warm_start(robot.home, np.array([1.5, 0.0, 0.0]))
    assert rows._braking(1.02, robot.home, 0.02)[0] == pytest.approx(1.5 / 6.0)
    assert rows._search is None


def test_what_does_not_fit_is_named(tmp_path: Path) -> None:
    robot = wb.load_robot(write_arm(tmp_path))
    ocp = reach_problem(robot)
    with pytest.raises(wb.InputError, match="no term keeps clear of them"):
        wb.MPC(ocp, obstacles=wb.Obstacles())
    keep_clear(ocp, wb.residuals.Clearance(robot))
    with pytest.raises(wb.InputError, match=r"'clearance' needs obstacles: MPC\(ocp, obstacles="):
        wb.MPC(ocp)
