"""Robots on wheels of a base, on a bus. Truth: rolling and rigid motion by hand, the simulated robot's own pose."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from needs import needs_dds

from effort import some
from planar_driving import RADIUS, write_robot
from wbmpc import lie
from wbmpc.bases.planar_motion.controller import PlanarController
from wbmpc.bases.planar_motion.ros import UNSEEN, BusMeasurement, on_bus
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.ros2.goals import Planner
from wbmpc.ros2.joints import Series
from wbmpc.ros2.settings import Speeds, joint_groups, settings_of

#: Half the track [m] of the robot.
HALF = 0.2


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    """Two wheels and an arm of two joints."""
    wheels = [((0.1, HALF), (0.0, 1.0, 0.0)), ((0.1, -HALF), (0.0, 1.0, 0.0))]
    return load_robot(write_robot(tmp_path_factory.mktemp("wheels"), wheels, {"type": "differential"}))


def test_drives_and_encoders_are_the_files(robot: RobotModel) -> None:
    settings = settings_of(robot)()
    topics = settings.command_topics(robot)
    wheels, arm = tuple(robot.description.base.wheel_joints()), robot.description.arm.joints
    assert {n: c.joints for n, c in topics.items()} == {"wheel_controller": wheels, "arm_controller": arm}
    assert joint_groups(robot)["wheel"] == wheels and settings.joint_speeds(robot, "wheel").shape == (2,)
    assert settings.fastest(robot).shape == (3,)


@pytest.mark.parametrize("goal", [(1.0, 0.5, 0.0), (-1.0, 0.0, 0.3), (0.0, 0.8, -2.0), (0.0, 0.0, 1.0)])
def test_a_base_that_cannot_go_sideways_gets_ways_that_it_can_drive(
    goal: tuple[float, float, float], robot: RobotModel
) -> None:
    """What stands on the axle's middle, 0.1 m ahead of the body's frame, moves along the heading only."""
    planner = Planner(robot, Speeds(base=0.4, turn=0.5))
    task = planner.to_base(robot.home, 2.0, np.array(goal))
    times, poses = task.base.times, task.base.poses
    np.testing.assert_allclose(poses[0], np.zeros(3), atol=1e-12)
    np.testing.assert_allclose([*poses[-1][:2], np.cos(poses[-1][2] - goal[2])], [goal[0], goal[1], 1.0], atol=1e-9)
    ahead = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)
    axle, middle = poses[:, :2] + 0.1 * ahead, 0.5 * (ahead[1:] + ahead[:-1])
    moved = np.diff(axle, axis=0)
    assert np.abs(moved[:, 0] * middle[:, 1] - moved[:, 1] * middle[:, 0]).max() < 1e-9
    assert np.all(np.diff(times) > 0.0) and times[0] == 2.0
    assert np.linalg.norm(moved, axis=1).max() <= 0.41 * np.diff(times).max()
    assert np.abs(np.diff(poses[:, 2]) / np.diff(times)).max() <= 0.51


def test_speeds_to_the_side_are_left_out(robot: RobotModel) -> None:
    planner = Planner(robot, Speeds())
    across, ahead = (planner.drive(robot.home, 0.0, np.array(v)).base.poses for v in ([0.2, 0.3, 0.0], [0.2, 0.0, 0.0]))
    np.testing.assert_allclose(across, ahead)


def message(t: float, wheels: float, **keys: Any) -> BusMeasurement:
    return BusMeasurement(t, np.full(2, wheels), np.zeros(2), **keys)


def follower(robot: RobotModel) -> Any:
    return on_bus(PlanarController)(robot, np.zeros(3), 0.0025)


def test_the_estimate_goes_on_over_runs_and_gaps(robot: RobotModel) -> None:
    """Wheels that turn by an angle a move the base by a times their radius, on whatever clock, also over a gap; the covariance grows."""
    c = follower(robot)
    c.measure(message(0.0, 0.0, origin=5.0))
    c.measure(message(0.01, 0.1, origin=5.0))
    np.testing.assert_allclose(c.pose, [0.1 * RADIUS, 0.0, 0.0], atol=1e-12)
    before = c.covariance.copy()
    c.measure(message(0.0, 0.2, origin=5.02))  # another run: the runner's clock restarts
    np.testing.assert_allclose(c.pose, [0.2 * RADIUS, 0.0, 0.0], atol=1e-12)
    assert c.covariance[0, 0] > before[0, 0]
    c.measure(message(1.0, 2.0, origin=5.02))
    np.testing.assert_allclose(c.pose, [2.0 * RADIUS, 0.0, 0.0], atol=1e-12)
    assert c.covariance[0, 0] >= UNSEEN[0] ** 2
    assert c.seen[0].time == 1.0


@pytest.mark.parametrize("rate", [20.0, 400.0])
def test_the_stated_deviation_of_a_way_does_not_depend_on_the_rate_of_messages(robot: RobotModel, rate: float) -> None:
    """Straight ahead for 9 m with a heading that is known within 20 mrad. By hand: independent errors of 10 mm after each metre, and the
    heading's, which are 0.02 of the way aside."""
    c, far = follower(robot), 9.0
    c.covariance = np.diag([0.0, 0.0, 0.02**2])
    for k in range(round(far * rate) + 1):
        c.measure(message(k / rate, k / rate / RADIUS))
    along, aside = np.sqrt(np.diag(c.covariance)[:2])
    assert along == pytest.approx(0.01 * np.sqrt(far), rel=0.02)
    assert aside == pytest.approx(np.hypot(along, 0.02 * far), rel=0.02)
    assert c.covariance[1, 2] == pytest.approx(0.02**2 * far, rel=0.02)


def test_a_wrong_stamp_turns_nobody(robot: RobotModel) -> None:
    """A base that turns by 0.5 rad/s, as wheels and gyro say; one message is stamped 0.3 s ahead, and the next ones are right again. It
    is as uncertain as after a gap. A base that stands then does not follow its gyro."""
    c, turned = follower(robot), 0.0
    c.odometry.gyro._covariance[3, 3] = 0.0  # its bias is known
    for k in range(400):
        t, turned = 0.01 * k, 0.005 * k
        wheel = turned * HALF / RADIUS * np.array([-1.0, 1.0])
        ahead = k == 200  # of which the gyro says nothing
        c.measure(BusMeasurement(t + 0.3 * ahead, wheel, np.zeros(2), turning=None if ahead else 0.5))
        assert c.pose[2] == pytest.approx(turned, abs=0.011)
    assert c.covariance[2, 2] >= UNSEEN[2] ** 2
    for k in range(200):  # its clock was set back; the gyro counts for 0.25 s
        c.measure(BusMeasurement(1.0 + 0.01 * k, wheel, np.zeros(2), turning=0.02))
    assert c.pose[2] == pytest.approx(turned, abs=0.006)


@pytest.mark.parametrize(
    ("rest", "lidar", "speed"), some(list(product((5.0, 0.0), (False, True), (0.0, 0.3))), [0, 3, 5, 6])
)
def test_a_gyro_that_says_nothing_is_within_the_stated_deviation(
    robot: RobotModel, rest: float, lidar: bool, speed: float
) -> None:
    """It says 0 of a base that turns, whose bias it has shown before (after a ``rest`` [s]) or not. Truth: wheels that roll. Contradictions are
    found after 0.2 s; from then on the pose is within three deviations, and poses of another localization correct it."""
    c, rng, wheel, true, h, rate = follower(robot), np.random.default_rng(0), np.zeros(2), np.zeros(3), 0.01, 0.5
    covariance = np.diag([0.02, 0.02, 0.01]) ** 2
    for k in range(round((rest + 6.0) / h)):
        moving, fix = k * h > rest, None
        if moving:
            wheel = wheel + np.array([speed - HALF * rate, speed + HALF * rate]) / RADIUS * h
            true = lie.se2_step(true, robot.base.twist @ [speed, rate] * h)
        if lidar and k % 10 == 5:
            fix = k * h, true + np.sqrt(np.diag(covariance)) * rng.normal(size=3), covariance
        c.fix = lambda fix=fix: fix
        noise = 0.0 if moving else 3e-4 / np.sqrt(h) * rng.normal()
        c.measure(BusMeasurement(k * h, wheel, np.zeros(2), turning=noise))
        if k * h < rest + 0.45:
            continue
        off, deviation = c.pose - true, np.sqrt(c.covariance[2, 2])
        assert abs(lie.wrapped(off[2]) if lidar else off[2]) < 3.0 * deviation, k
        assert np.hypot(*off[:2]) < 3.5 * np.sqrt(np.linalg.eigvalsh(c.covariance[:2, :2])[-1]), k
    assert lidar or deviation > 0.9 * 6.0 * rate


def test_encoders_that_restart_move_nobody(robot: RobotModel) -> None:
    c = follower(robot)
    for k, wheels in enumerate((100.0, 100.1, 0.0, 0.1)):
        c.measure(message(0.01 * k, wheels))
    np.testing.assert_allclose(c.pose, [0.2 * RADIUS, 0.0, 0.0], atol=1e-12)


def test_encoders_of_another_series_move_nobody(robot: RobotModel) -> None:
    """However slowly they seem to have turned meanwhile; in another simulation the robot is at its beginning again."""
    c = follower(robot)
    c.measure(message(0.0, 50.0, series=Series(0, 0)))
    c.measure(message(0.01, 50.1, series=Series(0, 0)))
    c.measure(message(9.0, 0.0, series=Series(1, 0)))
    c.measure(message(9.01, 0.1, series=Series(1, 0)))
    np.testing.assert_allclose(c.pose, [0.2 * RADIUS, 0.0, 0.0], atol=1e-12)
    assert np.all(np.diag(c.covariance) >= UNSEEN**2)
    for k in range(2):
        c.measure(message(0.01 * k, 0.1 * k, series=Series(2, 1)))
    np.testing.assert_allclose(c.pose, [0.1 * RADIUS, 0.0, 0.0], atol=1e-12)


def test_poses_of_another_localization(robot: RobotModel) -> None:
    """The first one says where the robot is; later ones count by their covariance (0: exact)."""
    c, fixes = (
        follower(robot),
        [(0.0, np.array([2.0, 1.0, 0.5]), np.eye(3)), None, (0.0, np.array([3.0, 1.0, 0.5]), np.eye(3))],
    )
    c.fix = lambda: fixes.pop(0) if fixes else None
    c.measure(message(0.0, 0.0))
    np.testing.assert_allclose(c.pose, [2.0, 1.0, 0.5])
    c.measure(message(0.01, 0.0))
    c.measure(message(0.02, 0.0))  # as sure as the estimate: half way
    np.testing.assert_allclose(c.pose, [2.5, 1.0, 0.5])
    np.testing.assert_allclose(c.covariance, 0.5 * np.eye(3))
    fixes.append((0.0, np.array([4.0, 0.0, 0.0]), np.zeros((3, 3))))
    c.measure(message(0.03, 0.0))
    np.testing.assert_allclose(c.pose, [4.0, 0.0, 0.0])


def test_poses_after_ways_that_are_too_short_to_count_leave_the_estimate_unsure(robot: RobotModel) -> None:
    """2.5 m straight ahead with a pose every 5 mm, good to 1 cm: by what the way adds between two poses (1 cm after 1 m, squared) the stated
    deviation settles, and wheels that then turn the base by 0.1 rad more than it does are corrected. Truth: by hand, q = 1e-4 x 5 mm and
    r = 1e-4 give p = (q r)^(1/2) in the long run."""
    c, fixes = follower(robot), list[Any]()
    c.fix = lambda: fixes.pop(0) if fixes else None
    wheels, straight, turned = np.zeros(2), robot.base.rates @ [1.0, 0.0], robot.base.rates @ [0.0, 1.0]
    for k in range(1500):
        fixes.append((0.01 * k, np.array([0.005 * k, 0.0, 0.0]), 1e-4 * np.eye(3)))
        c.measure(BusMeasurement(0.01 * k, wheels.copy(), np.zeros(2)))
        if k == 500:
            assert c.pose == pytest.approx([2.5, 0.0, 0.0], abs=1e-6)
            expected = np.sqrt(np.sqrt(1e-4 * 0.005 * 1e-4))
            assert np.sqrt(c.covariance[0, 0]) == pytest.approx(expected, rel=0.2)
            wheels = wheels + 0.1 * turned
        wheels = wheels + 0.005 * straight
    assert abs(c.pose[2]) < 0.02 and abs(c.pose[1]) < 0.02


def test_a_late_pose_is_of_its_stamp(robot: RobotModel) -> None:
    """A base on an arc, 1 m/s and 0.5 rad/s, and a localization of 10 Hz that is right to a millimeter but 0.2 s late: taken for
    poses of now, they pulled the estimate back by up to that way. The odometry begins elsewhere; the runner's clock restarts."""
    c, fixes = follower(robot), [(0.0, np.array([0.5, 0.0, 0.2]), np.eye(3))]
    c.fix = lambda: fixes.pop(0) if fixes else None
    truth, was, twist = np.array([0.5, 0.3, 0.0]), [], robot.base.twist @ [1.0, 0.5]
    c.measure(message(0.0, 0.0, origin=5.0))
    rates, wheels = robot.base.rates @ [1.0, 0.5], np.zeros(2)
    worst = []
    for k in range(1, 300):
        truth, wheels = lie.se2_step(truth, 0.01 * twist), wheels + 0.01 * rates
        was.append(truth)
        origin = 5.0 if k < 150 else 6.5
        if k % 10 == 0 and k > 20:
            fixes.append((5.0 + 0.01 * (k - 20) - origin, was[k - 21], 1e-6 * np.eye(3)))
        c.measure(BusMeasurement(5.0 + 0.01 * k - origin, wheels, np.zeros(2), origin=origin))
        worst.append(np.abs(c.pose - truth))
    assert np.max(worst[100:]) < 2e-3, np.max(worst[100:], axis=0)


@needs_dds
def test_a_goal_over_the_bus(simulated: Any) -> None:
    s = simulated
    s.ready()
    start = s.truth()
    s.end_effector(dx=0.05)
    s.run(0.8)
    assert s.control.running, s.control.state
    assert s.truth().tool[0] - start.tool[0] == pytest.approx(0.05, abs=0.01)
    np.testing.assert_allclose(s.control.adapter.estimate().position[:2], s.truth().pose[:2], atol=0.005)
    assert not s.messages(2)
