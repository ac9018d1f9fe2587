"""Reference paths. Truth: quadrature of the arc length, finite differences, distances to densely sampled curves, inverse
kinematics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from wbmpc import lie
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.studies.pankert2022 import track_references as track
from wbmpc.studies.paths import APPROACH_RATE, APPROACH_SPEED, Approach, SinePath
from wbmpc.tasks.paths import nearest_distance

PATH = SinePath(amplitude=0.498, length=15.96, periods=6, speed=0.255, start=0.5, ramp=2.0)


def test_arc_length_is_the_papers() -> None:
    k = 2.0 * np.pi * PATH.periods / PATH.length
    length = quad(lambda x: np.hypot(1.0, PATH.amplitude * k * np.cos(k * x)), 0.0, PATH.length, limit=500)[0]
    assert PATH.arc_length == pytest.approx(length, rel=1e-6)
    assert PATH.arc_length == pytest.approx(20.53, abs=0.01)


def test_points_lie_on_the_sine_and_move_with_the_speed() -> None:
    t = np.arange(0.0, PATH.end + 1.0, 0.005)
    along, across = PATH.point(t)
    np.testing.assert_allclose(across, 0.498 * np.sin(2.0 * np.pi * 6 * along / 15.96), atol=1e-5)
    speed = np.hypot(np.gradient(along, t), np.gradient(across, t))
    steady = (t > 2.6) & (t < PATH.end - 2.1)
    np.testing.assert_allclose(speed[steady], 0.255, rtol=1e-3)
    s, rate = PATH.arc(t)
    np.testing.assert_allclose(np.gradient(s, t), rate, atol=1e-3)
    assert speed[(t < 0.49) | (t > PATH.end + 0.01)].max() < 1e-12
    assert np.abs(np.diff(rate)).max() < 0.005 * 0.255  # smooth, no jump of the speed
    assert (along[0], across[0]) == (0.0, 0.0)
    assert s[-1] == pytest.approx(PATH.arc_length, rel=1e-9)
    assert along[-1] == pytest.approx(15.96, rel=1e-9)


def test_nearest_distance_is_that_to_the_curve_between_its_points() -> None:
    """Truth: a curve 1000 times finer, all of its points; a circle's radius."""
    rng = np.random.default_rng(0)
    t, fine = np.linspace(0.0, 6.0, 601), np.linspace(0.0, 6.0, 600_001)
    helix = lambda t: np.stack([np.cos(t), np.sin(t), 0.3 * t], axis=1)
    points = helix(rng.uniform(0.0, 6.0, 40)) + 1e-3 * rng.normal(size=(40, 3))
    truth = [np.sqrt(np.min(np.sum((helix(fine) - p) ** 2, axis=1))) for p in points]
    np.testing.assert_allclose(nearest_distance(points, helix(t)), truth, atol=2e-5)  # chords of 10 mm: 13 µm inside
    angles = np.linspace(0.0, 2.0 * np.pi, 100_001)
    circle = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    exact = np.hypot(np.hypot(points[:, 0], points[:, 1]) - 1.0, points[:, 2])
    np.testing.assert_allclose(nearest_distance(points, circle), exact, atol=1e-9)


def test_approach_comes_from_home_to_the_path_within_its_speeds() -> None:
    turn = lie.quaternion_about([0.0, 0.6, 0.8], 2.0)
    start, goal = (np.array([0.5, -0.2, 1.0]), turn), (np.array([0.3, 0.65, 0.8]), np.array([1.0, 0, 0, 0]))
    approach = Approach(start, goal)
    t = np.linspace(0.0, approach.duration + 1.0, 4001)
    offset, quaternions = approach.offset(t)
    np.testing.assert_allclose(offset[0], start[0] - goal[0], atol=1e-12)
    np.testing.assert_allclose(np.abs(quaternions[0] @ turn), 1.0, atol=1e-12)
    np.testing.assert_allclose(offset[-1], 0.0, atol=1e-12)
    np.testing.assert_allclose(quaternions[-1], goal[1], atol=1e-12)
    h = t[1] - t[0]
    speed = np.linalg.norm(np.diff(offset, axis=0), axis=1) / h
    rate = 2.0 * np.arccos(np.clip(np.abs(np.sum(quaternions[1:] * quaternions[:-1], axis=1)), 0.0, 1.0)) / h
    assert speed.max() <= APPROACH_SPEED * 1.001 and rate.max() == pytest.approx(APPROACH_RATE, rel=1e-2)
    assert Approach(start, start).duration == 0.0
    np.testing.assert_allclose(Approach(start, start).offset(t)[0], 0.0)


def led(robot: RobotModel, goals: np.ndarray) -> int:
    """How many of the goals (k, 3) [m] the end effector reaches one after the other, its axis to the left, the base at the origin: by
    inverse kinematics (damped least squares, derivatives by differences)."""
    arm, x = robot.state["arm"], robot.home.copy()

    def error(goal: np.ndarray) -> np.ndarray:
        position, orientation = robot.pose(x)
        turn = track.END_EFFECTOR_ROTATION @ lie.quaternion_to_rotation(orientation).T
        spin = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        return np.concatenate([goal - position, spin])

    for reached, goal in enumerate(goals):
        for _ in range(12):
            e, jacobian = error(goal), np.empty((6, 6))
            for k in range(6):
                x[arm.start + k] += 1e-6
                jacobian[:, k] = (e - error(goal)) / 1e-6
                x[arm.start + k] -= 1e-6
            x[arm] += np.linalg.solve(jacobian.T @ jacobian + 1e-6 * np.eye(6), jacobian.T @ e)
        if np.linalg.norm(error(goal)) > 1e-3:
            return reached
    return len(goals)


def test_peaks_are_out_of_reach_of_a_base_on_its_line() -> None:
    """Led outwards: the peaks are 20 to 40 mm beyond where it ends."""
    robot = load_robot("swerve-ur10")
    path = track.TrackReferences(track.SwerveTrackSettings(variant="peaks", periods=1), robot).curve()
    y = np.concatenate([np.arange(0.65, 1.22, 0.02), np.arange(1.22, 1.30, 0.002)])
    reached = led(robot, np.stack([np.full(y.size, track.AHEAD), y, np.full(y.size, track.HEIGHT)], axis=1))
    assert 0.020 < path[:, 1].max() - y[reached - 1] < 0.040


def test_the_upright_sine_is_as_long_as_the_other_and_within_reach() -> None:
    """The paper's 20.53 m and 0.498 m up and down, and no other amplitude than the one that was asked for; led down, then up."""
    robot = load_robot("swerve-ur10")
    references = track.TrackReferences(track.SwerveTrackSettings(variant="vertical"), robot)
    path = references.curve()
    assert references.path.arc_length == pytest.approx(20.53, abs=0.01)
    assert np.ptp(path, axis=0) == pytest.approx([15.96, 0.0, 2 * 0.498], abs=1e-4)
    small = track.TrackReferences(track.SwerveTrackSettings(variant={"kind": "vertical", "amplitude": 0.1}), robot)
    assert np.ptp(small.curve()[:, 2]) == pytest.approx(0.2, abs=1e-4)
    way = [np.linspace(track.HEIGHT, end, 12) for end in (path[:, 2].min(), path[:, 2].max())]
    for z in way:
        assert led(robot, np.stack([np.full(12, track.AHEAD), np.full(12, track.SIDE), z], axis=1)) == 12
