"""Other ways when an MPC is stuck, and routes that it follows. Truth: MuJoCo's distances at recorded poses, the robot's kinematics, closed
forms of a clock."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import wbmpc as wb
from planar_driving import write_robot
from test_tasks import WHEELS
from wbmpc.bases import base_type
from wbmpc.configuration import configure
from wbmpc.default_problem import default_mpc
from wbmpc.mpc.alternatives import _way
from wbmpc.mpc.route import carried_poses, carried_states, carrying_base, swung_poses, timed_route
from wbmpc.registry import load
from wbmpc.result import RunResult


@pytest.fixture(scope="module")
def driving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_robot(tmp_path_factory.mktemp("driving"), WHEELS, {"type": "differential"})


def head_on(driving: Path, folder: Path, half: float, *more: str) -> RunResult:
    """A wall of half length ``half`` [m] across the way of the end effector, higher than the robot."""
    scene = folder / "scene.yaml"
    scene.write_text(f"obstacles: {{wall: {{box: {{half: [0.05, {half}, 2]}}, position: [1.4, 0.02, 0]}}}}\n")
    keys = [
        f"robot={driving}",
        "plant=kinematic",
        f"obstacles={scene}",
        "settle_time=0.1",
        "mpc.rate=20",
        "mpc.intervals=20",
    ]
    keys += ["path.length=2.2", "path.speed=0.4", "path.ramp=0.3", *more]
    experiment = load("obstacles-static")
    return experiment.run(configure(experiment.config_type, keys, "x"), 0, None)


def test_a_robot_goes_around_a_wall_that_stops_its_mpc(driving: Path, tmp_path: Path) -> None:
    alone = head_on(driving, tmp_path, 0.6, "when_stuck=wait", "reference.patience=2")
    assert alone.metrics["passed"].value == 0.0 and alone.metrics["goal_missed"].value > 1.0
    result = head_on(driving, tmp_path, 0.6, "reference.patience=12")
    m, margin = result.metrics, wb.load_robot(driving).description.collision.margin
    assert result.completed and m["passed"].value == 1.0 and m["alternatives_taken"].value >= 1.0
    assert m["obstacle_clearance_min"].value > margin - 0.01


def test_a_robot_goes_around_a_wall_right_behind_which_its_way_ends(driving: Path, tmp_path: Path) -> None:
    """It cannot turn at its goal: it goes past and backs to it. That takes longer than it may wait."""
    result = head_on(driving, tmp_path, 0.6, "reference.patience=6", "path.length=1.7")
    m = result.metrics
    assert result.completed and m["passed"].value == 1.0 and m["alternatives_taken"].value >= 1.0
    assert m["obstacle_contacts"].value == 0.0 and m["obstacle_clearance_min"].value > 0.02


def test_a_way_backs_off_once_and_then_turns_and_goes_on() -> None:
    """Truth: distances between the places in closed form."""
    poses = [np.array([1.0, 0.5, 0.2]), np.array([0.6, 0.4, 0.2]), np.array([0.6, 1.4, 0.0]), np.array([2.6, 1.4, 0.0])]
    way = _way(poses)
    lengths = np.linalg.norm(np.diff(way[:, :2], axis=0), axis=1)
    assert lengths.sum() == pytest.approx(np.hypot(0.4, 0.1) + 1.0 + 2.0)
    np.testing.assert_allclose(way[:2], poses[:2])


def test_a_robot_in_front_of_a_wall_without_end_declines_within_two_seconds(driving: Path, tmp_path: Path) -> None:
    """All other ways were tried, and none was found; it can turn back. Truth: the recorded places of the end effector."""
    result = head_on(driving, tmp_path, 30.0, "reference.patience=25")
    m, times, tool = result.metrics, result.log.times("end_effector"), result.log.array("end_effector")
    assert result.outcome == "declined" and "no other way" in result.reason and m["alternatives_taken"].value == 0.0
    assert m["goal_missed"].value > 1.0
    stands = times[-1] - times[np.flatnonzero(np.linalg.norm(tool - tool[-1], axis=1) > 0.05)[-1]]
    assert m["standing_time_max"].value == pytest.approx(stands, abs=0.06) and stands <= 2.0


def test_a_robot_that_has_entered_a_dead_end_is_stuck(driving: Path, tmp_path: Path) -> None:
    """A passage of 0.516 m for a body of 0.44 m by 0.16 m: with its margin it needs 0.528 m to turn. A wall is across it."""
    scene = tmp_path / "dead-end.yaml"
    sides = ", ".join(f"side{y}: {{box: {{half: [3, 0.05, 2]}}, position: [2, {y}, 0]}}" for y in (-0.308, 0.308))
    scene.write_text(f"obstacles: {{wall: {{box: {{half: [0.05, 3, 2]}}, position: [1.4, 0, 0]}}, {sides}}}\n")
    result = head_on(driving, tmp_path, 30.0, "reference.patience=25", f"obstacles={scene}")
    assert result.outcome == "stuck" and result.metrics["obstacle_contacts"].value == 0.0


def test_a_robot_waits_for_a_wall_that_passes_and_is_not_stuck(
    driving: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A wall leaves a passage at 0.1 m/s; up to then nothing leads past it."""
    scene = tmp_path / "scene.yaml"
    wall = "box: {half: [0.05, 1.2, 2]}, position: [0.9, 0.5, 0], velocity: [0, 0.1, 0]"
    sides = ", ".join(f"side{y}: {{box: {{half: [3, 0.05, 2]}}, position: [1, {y}, 0]}}" for y in (-0.7, 0.7))
    scene.write_text(f"obstacles: {{wall: {{{wall}}}, {sides}}}\n")
    keys = [f"robot={driving}", "plant=kinematic", f"obstacles={scene}", "settle_time=0.1", "mpc.rate=20"]
    keys += ["mpc.intervals=20", "path.length=1.0", "path.speed=0.4", "path.ramp=0.3", "reference.patience=12"]
    experiment = load("obstacles-moving")
    with caplog.at_level("INFO", "wbmpc"):
        result = experiment.run(configure(experiment.config_type, keys, "x"), 0, None)
    m = result.metrics
    assert m["passed"].value == 1.0 and m["reference_delay"].value > 2.0
    assert m["alternative_searches"].value == 0.0 and "stuck" not in caplog.text
    assert m["obstacle_contacts"].value == 0.0


def test_the_end_effector_is_carried_by_the_base(driving: Path) -> None:
    """Truth: the robot's kinematics."""
    robot = wb.load_robot(driving)
    base = np.array([[0.4, -1.0, 0.0], [2.0, 0.3, 2.5], [-1.0, 0.7, -7.0]])
    poses = carried_poses(robot, base)
    for x, pose, place in zip(carried_states(robot, base), poses, base, strict=True):
        position, quaternion = robot.pose(x)
        np.testing.assert_allclose(pose[:3], position, atol=1e-9)
        assert abs(pose[3:] @ quaternion) == pytest.approx(1.0, abs=1e-9)
        found = carrying_base(robot, pose)
        np.testing.assert_allclose(found[:2], place[:2], atol=1e-9)
        assert np.cos(found[2] - place[2]) == pytest.approx(1.0, abs=1e-9)


def test_a_route_is_timed_by_its_speeds() -> None:
    """3 m with 0.5 m/s, then a quarter turn with 1 rad/s, and half of the ramp at either end."""
    times, base = timed_route(np.array([[0.0, 0, 0], [3.0, 0, 0], [3.0, 0, 0.5 * np.pi]]), 0.5, 1.0, 1.0)
    assert times[-1] == pytest.approx(6.0 + 0.5 * np.pi + 1.0)
    np.testing.assert_allclose(base[-1], [3.0, 0.0, 0.5 * np.pi], atol=1e-9)
    at = lambda t: np.array([np.interp(t, times, column) for column in base.T])
    np.testing.assert_allclose(at(3.0), [0.5 * 2.5, 0.0, 0.0], atol=1e-3)
    np.testing.assert_allclose(at(7.0), [3.0, 0.0, 0.5], atol=1e-3)


def test_an_mpc_follows_a_route_to_its_end(driving: Path) -> None:
    robot = wb.load_robot(driving)
    mpc = default_mpc(robot)
    start = robot.home[robot.state["base"]][:3]
    goal = start + [0.6, 0.3, np.arctan2(0.3, 0.6)]
    turned = [*start[:2], goal[2]]
    end = wb.follow_route(mpc, robot, [start, turned, goal], 0.2, speed=0.4, turn_speed=1.0)
    x, t, h = robot.home, 0.0, mpc.period
    while t < end + 0.5:
        x = mpc.simulate(x, mpc.update(wb.Observation(t, x))(t, x), h)
        t += h
    np.testing.assert_allclose(x[robot.state["base"]][:3], goal, atol=0.02)
    with pytest.raises(wb.InputError, match="rows of 3 finite numbers"):
        wb.follow_route(mpc, robot, [start])


def found_at_a_gap(robot: wb.RobotModel, reshapes: bool) -> tuple[list[str], int]:
    """Names of winners, and failed searches, of a robot that comes to a low wall with a gap of 1.05 m to the left of its way."""
    world = wb.Obstacles()
    for name, half, y in (("right", 1.625, -1.375), ("left", 1.5, 2.85)):
        world.set(name, wb.shapes.Box((0.05, half, 0.25)), position=(2.2, y, 0.25))
    mpc = base_type("swerve").mpc(robot, world, rate=20.0, intervals=25)
    times = np.linspace(0.0, 10.0, 101)
    base = np.column_stack([1.0 + 0.3 * times, np.zeros((101, 2))])
    poses = carried_poses(robot, base)
    mpc.reference["end_effector"] = wb.Reference.poses(times, poses[:, :3], poses[:, 3:])
    mpc.reference["state"] = wb.Reference(times, carried_states(robot, base))
    pace = wb.PacedReferences(mpc)
    shapes = base_type("swerve").reshaping(robot, mpc, SimpleNamespace()) if reshapes else None  # type: ignore[arg-type]
    others, x = wb.Alternatives(mpc, robot, pace, shapes), carried_states(robot, base[:1])[0]
    for k in range(400):
        t = 0.05 * k
        pace.advance(t, robot.pose(x)[0])
        others.advance(t)
        if others.failed or any(name != "wait" for _, name in others.taken):
            break
        x = mpc.simulate(x, mpc.update(wb.Observation(t, x))(t, x), 0.05)
    return [name for _, name in others.taken if name != "wait"], others.failed


def test_legs_that_fold_lead_through_a_gap_that_is_too_narrow_at_home() -> None:
    """Truth: the gap is narrower than the robot's shapes at home and wider than its body, by its file; without another shape nothing is
    found."""
    robot = wb.load_robot("swerve-ur10")
    wheels = robot.base.geometry.steer_axes(robot.home[robot.state["leg"]])
    body = 2.0 * np.abs(robot.base.geometry.hinge[:, 1]).max()
    assert np.ptp(wheels[:, 1]) > 1.05 > body + 2.0 * robot.description.collision.margin
    assert found_at_a_gap(robot, True) == (["left, narrow"], 0)
    assert found_at_a_gap(robot, False) == ([], 1)


def test_the_end_effector_swings_to_where_it_is_carried(driving: Path) -> None:
    """From where it is, at rest, to where it is at home, no faster than a smooth step of 3 s is. Truth: the robot's kinematics."""
    robot = wb.load_robot(driving)
    start = robot.home.copy()
    start[robot.state["arm"]] += 0.5
    times = np.linspace(0.0, 4.0, 401)
    base = np.column_stack([0.1 * times, np.zeros((401, 2))])
    poses, home = swung_poses(robot, times, base, start), carried_poses(robot, base)
    np.testing.assert_allclose(poses[0, :3], robot.pose(start)[0], atol=1e-9)
    assert abs(poses[0, 3:] @ robot.pose(start)[1]) == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(poses[times >= 3.0], home[times >= 3.0], atol=1e-9)
    beside = poses[:, :3] - home[:, :3]
    speed = np.linalg.norm(np.diff(beside, axis=0), axis=1) / 0.01
    assert speed.max() <= 1.5 * np.linalg.norm(beside[0]) / 3.0 + 1e-6 and speed[0] < 0.02 * speed.max()


def test_references_take_a_detour_and_rejoin(driving: Path) -> None:
    """A clock that runs: the detour of 2 s, then what came 1.5 s after the start, and on."""
    robot = wb.load_robot(driving)
    mpc = default_mpc(robot)
    position, turn = robot.pose(robot.home)
    times = np.linspace(0.0, 6.0, 61)
    mpc.reference["end_effector"] = wb.Reference.poses(times, position + np.outer(times, [0.1, 0, 0]), turn)
    whole, pace = mpc.reference["end_effector"], wb.PacedReferences(mpc)
    for k in range(1, 11):
        pace.advance(0.1 * k, whole.at(0.1 * k)[:3])
    ways = np.array([0.0, 1.0, 2.0])
    aside = wb.Reference.poses(ways, [whole.at(1.0)[:3], position + [0.1, 0.3, 0.0], whole.at(3.0)[:3]], turn)
    np.testing.assert_allclose(pace.running(5.0)["end_effector"].at(5.5), whole.at(1.5), atol=1e-9)
    pace.detour({"end_effector": aside}, 3.0)
    assert pace.end == pytest.approx(6.0)  # 1 + 2 + (6 - 3)
    np.testing.assert_allclose(pace.pose(2.0)[:3], position + [0.1, 0.3, 0.0], atol=1e-9)
    np.testing.assert_allclose(pace.pose(4.0)[:3], whole.at(4.0)[:3], atol=1e-9)


def test_the_base_has_a_weight_while_its_shape_is_narrow(driving: Path) -> None:
    """Without one a base evades what it is to pass, as its arm reaches the path from beside it too."""
    robot = wb.load_robot(driving)
    mpc = default_mpc(robot, obstacles=wb.Obstacles())
    shape = SimpleNamespace(narrowest=robot.home, free=None, narrow=False)
    others = wb.Alternatives(mpc, robot, wb.PacedReferences(mpc), shape)
    part, base = mpc.solver.problem.constant.slices["path.state"], robot.state["base"]
    weights = [mpc.solver.constants[part].copy()]
    for k, narrow in enumerate((True, True, False)):
        shape.narrow = narrow
        others.advance(0.1 * k)
        weights.append(mpc.solver.constants[part].copy())
    np.testing.assert_array_equal(weights[1], weights[2])
    assert (weights[1][base] > 10.0 * weights[0][base]).all() and (weights[1][base] > 0.0).all()
    np.testing.assert_array_equal(weights[3], weights[0])


def test_what_it_needs_is_named(driving: Path) -> None:
    robot = wb.load_robot(driving)
    mpc = default_mpc(robot)
    with pytest.raises(wb.InputError, match="alternatives: valid: an MPC with obstacles"):
        wb.Alternatives(mpc, robot, wb.PacedReferences(mpc))
