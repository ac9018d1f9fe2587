"""From goals to references. Truth: straight lines and arcs by hand, rigid motion of the end effector with the base, speed limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import ArrayLike

from wbmpc import lie
from wbmpc.bases.common.ros import references_of
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.robots import load_description
from wbmpc.ros2.goals import LEASH, STEP, EndEffectorTrack, Planner, Task, Track, base_track, end_effector_track
from wbmpc.ros2.settings import Goals, Speeds

ROBOT, BALL = load_robot("swerve-ur10"), load_robot("rezero")
SPEEDS = Speeds(base=0.4, turn=0.5, end_effector=0.2)
PLANNER = Planner(ROBOT, SPEEDS)
HAND, TURNED = ROBOT.pose(ROBOT.home)


def at(x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> np.ndarray:
    """The home with its base elsewhere."""
    state = ROBOT.home.copy()
    state[ROBOT.state["base"]] = x, y, yaw
    return state


def check_rigid(task: Task) -> None:
    """The end effector of a carried task is where the base, standing there, has it."""
    for k in (0, len(task.base.poses) // 2, -1):
        position, turned = ROBOT.pose(at(*task.base.poses[k]))
        np.testing.assert_allclose(task.end_effector.positions[k], position, atol=1e-9)
        assert abs(task.end_effector.orientations[k] @ turned) == pytest.approx(1.0, abs=1e-12)


def test_a_base_goal_is_a_straight_way_within_the_speeds() -> None:
    task = PLANNER.to_base(at(1.0, 2.0, 0.3), 5.0, np.array([2.0, 0.0, 0.3 + 2 * np.pi + 1.0]))
    poses, times = task.base.poses, task.base.times
    np.testing.assert_allclose(poses[[0, -1]], [[1.0, 2.0, 0.3], [2.0, 0.0, 1.3]], atol=1e-12)
    along = (poses[:, :2] - [1.0, 2.0]) @ np.array([-2.0, -1.0])  # across the line
    np.testing.assert_allclose(along, 0.0, atol=1e-12)
    rates = np.diff(poses, axis=0) / np.diff(times)[:, None]
    assert 0.95 * 0.4 < np.hypot(rates[:, 0], rates[:, 1]).max() <= 0.4 + 1e-9
    assert np.abs(rates[:, 2]).max() <= 0.5 and times[0] == 5.0
    check_rigid(task)


def test_the_twists_move_the_poses() -> None:
    task = PLANNER.to_base(at(0.0, 0.0, 0.2), 0.0, np.array([1.0, -0.5, 2.0]))
    pose = task.base.poses[0]
    for twist, h in zip(task.base.twists, np.diff(task.base.times)):
        pose = lie.se2_step(pose, twist * h)
    np.testing.assert_allclose(pose, task.base.poses[-1], atol=1e-9)
    references = references_of(task, ROBOT)
    assert references["state"].values.shape[1] == ROBOT.state.size
    np.testing.assert_array_equal(references["input"].values[:, ROBOT.input["base"]], task.base.twists)


def test_a_speed_is_an_arc() -> None:
    twist = np.array([0.5, 0.0, 0.25])  # radius 2 m, to the left
    start = at(0.0, 0.0, np.pi / 2)
    task = PLANNER.drive(start, 3.0, twist, under_way(twist, start, 3.0))
    s = task.base.times - 3.0
    circle = np.stack([-2.0 + 2.0 * np.cos(0.25 * s), 2.0 * np.sin(0.25 * s)], axis=1)
    np.testing.assert_allclose(task.base.poses[:, :2], circle, atol=1e-9)
    np.testing.assert_allclose(task.base.twists[:-1], np.tile([0.5, 0.0, 0.25], (s.size - 1, 1)), atol=1e-9)
    assert s[-1] > 10.0  # longer than the horizon
    check_rigid(task)


def under_way(twist: ArrayLike, start: np.ndarray | None = None, t: float = 0.0) -> Task:
    """A speed without a beginning, from a state and a time on."""
    x, s = at() if start is None else start, np.arange(0.0, 12.0, 0.1)
    poses = np.array([lie.se2_step(x[ROBOT.state["base"]], np.asarray(twist) * k) for k in s])
    return PLANNER._carry(Track(t + s, poses), PLANNER._held(x), "base at a speed")


def test_a_speed_begins_within_an_acceleration() -> None:
    base = PLANNER.drive(at(), 3.0, np.array([0.5, 0.0, 0.0])).base
    change = np.diff(base.twists[:-1, 0])
    assert change.max() <= 1.0 * STEP + 1e-9 and np.all(change >= -1e-9)
    np.testing.assert_allclose(np.interp(3.5, base.times, base.poses[:, 0]), 0.5 * 0.5 * 0.5, atol=1e-4)


def test_the_same_speed_again_moves_no_reference() -> None:
    """A stream of one speed, and a robot that stays 30 mm behind: the reference goes on as if it were asked once."""
    twist, task = np.array([0.2, 0.0, 0.1]), None
    once = PLANNER.drive(at(), 0.0, twist)
    for t in np.arange(0.0, 5.0, 0.05):
        x = at() if task is None else at(*lie.se2_step(task.base.at(t)[0], [-0.03, 0.0, 0.0]))
        task = PLANNER.drive(x, t, twist, task)
    assert task is not None
    for t in (5.0, 8.0, 10.0):
        np.testing.assert_allclose(task.base.at(t)[0], once.base.at(t)[0], atol=2e-3)
        np.testing.assert_allclose(task.base.at(t)[1], twist, atol=1e-9)
    check_rigid(task)  # the end effector too is where the first message found it in the base


def test_the_reference_waits_for_a_robot_that_is_held() -> None:
    task = PLANNER.drive(at(0.4), 4.0, np.array([0.2, 0.0, 0.0]), under_way([0.2, 0.0, 0.0]))  # 0.8 m by then
    assert task.base.poses[0, 0] == pytest.approx(0.45) and task.base.at(4.0)[1][0] == pytest.approx(0.2)


def test_another_speed_goes_on_from_the_one_before() -> None:
    task = PLANNER.drive(at(0.39), 2.0, np.array([0.2, 0.1, 0.0]), under_way([0.2, 0.0, 0.0]))
    np.testing.assert_allclose(task.base.poses[0], [0.4, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(task.base.twists[:-1, 0], 0.2, atol=1e-9)
    np.testing.assert_allclose(task.base.at(2.2)[1], [0.2, 0.1, 0.0], atol=1e-9)


def test_slowing_down_ends_after_half_the_way() -> None:
    task = PLANNER.slow_down(at(0.4), 1.0, under_way([0.4, 0.0, 0.0]))
    assert task.base.times[-1] == pytest.approx(1.4) and task.base.poses[-1, 0] == pytest.approx(0.4 + 0.5 * 0.4 * 0.4)
    assert np.all(np.diff(task.base.twists[:-1, 0]) < 0.0)
    assert PLANNER.slow_down(at(), 1.0, None).base.times.size == 1  # at rest already


@pytest.mark.parametrize(("way", "moved"), [(0.2, 0.0), (1.0, 1.0 - LEASH)])
def test_a_far_hand_takes_the_base_along(way: float, moved: float) -> None:
    task = PLANNER.to_end_effector(at(), 0.0, HAND + [way, 0.0, 0.1], TURNED)
    np.testing.assert_allclose(task.end_effector.positions[[0, -1]], [HAND, HAND + [way, 0.0, 0.1]], atol=1e-12)
    np.testing.assert_allclose(task.base.poses[-1], [moved, 0.0, 0.0], atol=1e-9)
    speed = np.linalg.norm(np.diff(task.end_effector.positions, axis=0), axis=1) / np.diff(task.end_effector.times)
    assert speed.max() <= 0.2 + 1e-9 and not task.carried


def test_too_high_is_rejected() -> None:
    """The UR10 stands on the base: its data sheet's reach of 1.3 m, the wrist and the tool from a shoulder at 0.64 m."""
    assert 0.5 < PLANNER.shoulder < 0.8 and 1.3 < PLANNER.reach < 1.9
    with pytest.raises(InputError, match=r"out of reach: height 2.60 m"):
        PLANNER.to_end_effector(at(), 0.0, HAND + [0.0, 0.0, 1.8], TURNED)


def test_a_reach_is_that_of_the_arm_in_whatever_order_its_joints_are(tmp_path: Path) -> None:
    """From the last joint on it was 9 cm, and every goal out of it."""
    file = load_description("swerve-ur10").model.with_name("swerve-ur10.yaml")
    data = yaml.safe_load(file.read_text())
    data["arm"]["joints"].reverse()
    (tmp_path / "turned.yaml").write_text(yaml.safe_dump({**data, "model": str(file.with_name("swerve.xml"))}))
    turned = Planner(load_robot(tmp_path / "turned.yaml"), SPEEDS)
    assert (turned.shoulder, turned.reach) == (PLANNER.shoulder, PLANNER.reach)


@pytest.mark.parametrize("height", [-0.4, -0.01])
def test_under_the_floor_is_rejected(height: float) -> None:
    with pytest.raises(InputError, match=rf"height {height:.2f} m, possible 0.00 to"):
        PLANNER.to_end_effector(at(), 0.0, np.array([HAND[0], HAND[1], height]), TURNED)
    ball = Planner(BALL, SPEEDS)  # heights of its tasks are above the ball's middle
    with pytest.raises(InputError, match=r"height -0.01 m, possible 0.00 to"):
        ball.to_end_effector(BALL.home, 0.0, np.array([0.3, 0.0, -ball.lift - 0.01]), TURNED)
    ball.to_end_effector(BALL.home, 0.0, np.array([0.3, 0.0, -ball.lift]), TURNED)


@pytest.mark.parametrize("far", [1e3, 1e9, 1e200])
def test_too_far_is_rejected_at_once(far: float) -> None:
    pose = np.array([far, 0.0, 0.0])
    with pytest.raises(InputError, match=r"the base's goal is .* m away, valid: 0 to 100 m \(key 'goals.base'\)"):
        PLANNER.to_base(at(), 0.0, pose)
    with pytest.raises(InputError, match=r"the base's goal is"):
        PLANNER.along_base_path(at(), 0.0, Track(np.array([0.0, 1.0]), np.stack([np.zeros(3), pose])), None)
    with pytest.raises(
        InputError, match=r"the end effector's goal is .* m away, valid: 0 to 100 m \(key 'goals.end_effector'\)"
    ):
        PLANNER.to_end_effector(at(), 0.0, HAND + pose, TURNED)
    path = EndEffectorTrack(np.array([0.0, 1.0]), np.stack([HAND, HAND + pose]), np.tile(TURNED, (2, 1)))
    with pytest.raises(InputError, match=r"the end effector's goal is"):
        PLANNER.along_end_effector_path(at(), 0.0, path, None)


def test_a_long_way_has_few_samples() -> None:
    """As far as the settings may ever allow: two hours and more by the same speeds."""
    planner = Planner(ROBOT, SPEEDS, Goals(base=1e4, end_effector=1e4))
    base = planner.to_base(at(), 3.0, np.array([9e3, 0.0, 0.0])).base
    assert base.times.size < 3000 and base.times[0] == 3.0
    assert base.times[-1] == pytest.approx(3.0 + 0.5 * np.pi * 9e3 / 0.4)
    assert 0.99 * 0.4 < (np.diff(base.poses[:, 0]) / np.diff(base.times)).max() <= 0.4 + 1e-9
    assert planner.to_end_effector(at(), 0.0, HAND + [9e3, 0.0, 0.0], TURNED).end_effector.times.size < 3000


def test_paths_keep_their_times_or_get_them_from_the_speeds() -> None:
    positions = np.array([[0.0, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.4, 0.4]])
    quaternions = np.tile(TURNED, (3, 1))
    given = np.array([11.0, 11.5, 14.0])
    np.testing.assert_array_equal(end_effector_track(positions, quaternions, given, 10.0, SPEEDS).times, given)
    np.testing.assert_allclose(
        end_effector_track(positions, quaternions, given, 100.0, SPEEDS).times, [100.0, 100.5, 103.0]
    )
    for useless in (None, np.zeros(3)):
        np.testing.assert_allclose(
            end_effector_track(positions, quaternions, useless, 10.0, SPEEDS).times, [10.0, 12.0, 14.0]
        )
    turning = base_track(np.array([[0.0, 0.0, 3.0], [0.0, 0.0, -3.0]]), None, 0.0, SPEEDS)
    assert turning.poses[1, 2] == pytest.approx(2 * np.pi - 3.0)  # the shorter way round
    assert turning.times[1] == pytest.approx((2 * np.pi - 6.0) / 0.5)


def test_a_path_begins_where_the_robot_is() -> None:
    path = Track(np.array([1.0, 2.0]), np.array([[1.0, 0.0, 0.0], [1.2, 0.0, 0.0]]))
    task = PLANNER.along_base_path(at(), 1.0, path, None)
    np.testing.assert_allclose(task.base.poses[[0, -1]], [[0.0, 0.0, 0.0], [1.2, 0.0, 0.0]], atol=1e-12)
    approach = 0.5 * np.pi * 1.0 / 0.4
    assert task.base.times[0] == 1.0 and task.base.times[-1] == pytest.approx(1.0 + approach + 1.0, abs=0.03)
    assert np.all(np.diff(task.base.times) > 0.0)
    end_effector = EndEffectorTrack(
        np.array([0.0, 1.0]), np.stack([HAND, HAND + [0.1, 0.0, 0.0]]), np.tile(TURNED, (2, 1))
    )
    both = PLANNER.along_end_effector_path(at(), 0.0, end_effector, path)
    np.testing.assert_allclose(both.end_effector.positions, end_effector.positions, atol=1e-12)
    assert both.base is path
