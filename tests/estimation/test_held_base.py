"""A base whose wheels turn and which does not: on blocks, or held. Truth: it stands, in MuJoCo or because the gyro is one that does not turn."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from wheels_on_paper import ring

from toys import made
from wbmpc import lie
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.fused_odometry import FusedOdometry
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.model.robot import load_robot
from wbmpc.model.wheels import rolling_inverse_kinematics

PERIOD, RATE = 0.0025, 0.5
#: Speed [m/s] of a base on a tour; yaw rates [rad/s] of one that goes straight ahead, and of its wheels while they slip on bumps.
TOUR, STRAIGHT, BUMP = 0.36, 1e-6, 0.03
#: A rate [rad/s] that the gyro's noise makes a contradiction, and hides again.
FAINT = 6.8e-3
#: Standard deviation [rad, and relative] of zeros and radii after a calibration.
KNOWN = 3e-4
FOUR = ring(4)
#: Of wheels that are not around the base's origin: a turn of theirs moves it.
BESIDE = ring(4)
BESIDE.hinge[:] += [0.4, -0.3]


class Turning:
    """Wheels that roll as those of a base that turns, and goes ahead at a ``speed`` [m/s]; the gyro says what it likes. ``true`` (3): where
    such a base is."""

    def __init__(self, odometry: FusedOdometry, speed: float = 0.0) -> None:
        self.odometry, self.speed, self.t, self.wheel, self.true = odometry, speed, 0.0, np.zeros(4), np.zeros(3)
        self.rng = np.random.default_rng(0)

    def go(self, seconds: float, wheels: float, gyro: float | None, noise: float = 2e-4) -> None:
        zero, speed = np.zeros(4), self.speed * (wheels != 0.0)
        twist = np.array([speed, 0.0, wheels or RATE])
        steer, rates = rolling_inverse_kinematics(self.odometry.geometry, zero, zero, twist, zero)
        for _ in range(round(seconds / PERIOD)):
            self.t, self.wheel = self.t + PERIOD, self.wheel + rates * PERIOD * (wheels != 0.0)
            self.true = lie.se2_step(self.true, twist * PERIOD * (wheels != 0.0))
            noisy = noise / np.sqrt(PERIOD) * self.rng.normal()
            self.odometry.update(self.t, zero, steer, self.wheel, None if gyro is None else gyro + noisy)

    def wrong_radii(self) -> float:
        """The largest relative error, of wheels that are as described."""
        return float(np.abs(self.odometry.calibration.wheel_radius / self.odometry.geometry.wheel_radius - 1.0).max())


@pytest.mark.parametrize("geometry", [FOUR, BESIDE])
@pytest.mark.parametrize("rate", [RATE, -0.05])
def test_wheels_that_turn_a_base_which_does_not_teach_nothing(geometry: object, rate: float) -> None:
    base = Turning(FusedOdometry(geometry))  # type: ignore[arg-type]
    base.go(5.0, 0.0, 0.0)
    base.go(10.0, rate, 0.0)
    assert base.wrong_radii() < 1e-3 and abs(base.odometry.gyro_bias) < 1e-3
    assert abs(base.odometry.pose[2]) < 5e-3
    assert np.all(np.abs(base.odometry.pose) < 3.0 * np.sqrt(np.diag(base.odometry.covariance)))
    assert abs(base.odometry.twist[2]) < 0.05
    # it comes down from the blocks, and odometry is as before
    base.go(1.0, 0.0, 0.0)
    before, start = base.odometry.covariance[2, 2], base.odometry.pose
    base.go(4.0, rate, rate)
    turned = lie.se2_log(start, base.odometry.pose)
    np.testing.assert_allclose(turned, [0.0, 0.0, 4.0 * rate], atol=0.02)
    assert base.odometry.covariance[2, 2] - before < 0.02**2


def test_the_deviation_grows_while_wheels_and_gyro_contradict_each_other() -> None:
    """One of the two is wrong, and nothing says which: by hand, the yaw by all of the contradiction, from the beginning on."""
    base, spreads = Turning(FusedOdometry(FOUR)), []
    base.go(5.0, 0.0, 0.0)
    for _ in range(3):
        base.go(2.0, RATE, 0.0)
        spreads.append(np.sqrt(base.odometry.covariance[2, 2]))
    np.testing.assert_allclose(spreads, RATE * np.array([2.0, 4.0, 6.0]), rtol=0.05)
    base.go(2.0, RATE, RATE)
    stays = np.sqrt(base.odometry.covariance[2, 2])
    base.go(5.0, RATE, RATE)
    np.testing.assert_allclose(np.sqrt(base.odometry.covariance[2, 2]), stays, rtol=0.02)


@pytest.mark.parametrize("geometry", [FOUR, BESIDE])
@pytest.mark.parametrize("stuck", [0.0, 0.3])
@pytest.mark.parametrize("speed", [0.0, 1.0])
@pytest.mark.parametrize("lidar", [False, True])
def test_a_gyro_that_is_stuck_is_found_by_global_poses(
    geometry: object, stuck: float, speed: float, lidar: bool
) -> None:
    """It goes on with what it said last, 0 too, while the base turns otherwise. Truth: where its wheels rolled. It is within three
    stated deviations (and 2 mrad, for a single message finds nothing), and right global poses are taken in, at once or after it all."""
    base = Turning(FusedOdometry(geometry), speed)  # type: ignore[arg-type]
    base.go(2.0, 0.0, 0.0)
    base.go(2.0, stuck, stuck)
    odometry, covariance = base.odometry, np.diag([0.02, 0.02, 0.01]) ** 2
    for k in range(120):
        base.go(0.05, RATE, stuck, noise=0.0)
        off = odometry.pose - base.true
        off[2] = lie.wrapped(off[2]) if lidar else off[2]
        assert abs(off[2]) < 3.0 * np.sqrt(odometry.covariance[2, 2]) + 2e-3, k
        assert off @ np.linalg.solve(odometry.covariance + np.diag([1e-3, 1e-3, 2e-3]) ** 2, off) < 21.1, k
        if lidar and k % 2:
            seen = base.true + np.sqrt(np.diag(covariance)) * base.rng.normal(size=3)
            assert odometry.correct(base.t, seen, covariance), k
    assert odometry.correct(base.t, base.true, covariance)
    assert base.wrong_radii() < 3e-3


def on_bumps(seconds: float, times: int, pause: float = 0.7) -> Turning:
    """A base that goes straight ahead, in which its gyro is right, and whose wheels, which are known, slip on bumps, to either side in
    turn: each time for so long [s], with a ``pause`` [s] after it."""
    known = WheelCalibration(np.zeros(4), np.zeros(4), np.full(4, FOUR.wheel_radius), KNOWN**2 * np.eye(8))
    base = Turning(FusedOdometry(FOUR, calibration=known), TOUR)
    base.go(5.0, 0.0, 0.0)
    base.go(3.0, STRAIGHT, 0.0)
    for k in range(times):
        base.go(seconds, BUMP * (-1.0) ** k, 0.0)
        base.go(pause, STRAIGHT, 0.0)
    return base


@pytest.mark.parametrize("pause", [0.3, 0.7])
def test_brief_slip_on_bumps_teaches_nothing_and_holds_no_base(pause: float) -> None:
    """Truth: it goes straight, and the gyro has no bias. Nothing is learned of bumps, and the stated deviation does not grow by them."""
    smooth, bumps = on_bumps(0.0, 8, pause), on_bumps(0.3, 8, pause)
    assert bumps.wrong_radii() < smooth.wrong_radii() + 1e-4
    assert abs(bumps.odometry.gyro_bias) < 3e-4
    aside, std = bumps.odometry.pose[1:], np.sqrt(np.diag(bumps.odometry.covariance))[1:]
    assert np.all(np.abs(aside) < 3.0 * std) and np.all(std < [4e-3, 2e-3])


@pytest.mark.parametrize("more", [0.5, 1.0, 2.0, 5.5])
def test_what_lasts_longer_than_a_bump_may_be_a_base_that_is_held(more: float) -> None:
    """By hand, the deviation, so much [s] after it is found: all of the contradiction, from its beginning on. Along x 0.7 of what the wheels
    contradict it by, of whose 8 components 6 are free."""
    base, seconds = on_bumps(0.0, 0), 0.5 + more
    base.go(seconds, BUMP, 0.0)
    arm = np.hypot(*FOUR.steer_axes(np.zeros(4)).T)
    std = np.sqrt(np.diag(base.odometry.covariance))
    np.testing.assert_allclose(std[2], seconds * BUMP, rtol=0.04)
    np.testing.assert_allclose(std[0], seconds * BUMP * 0.7 * np.sqrt(np.sum(arm**2) / 6), rtol=0.1)
    assert abs(base.odometry.pose[2]) < 5e-3 and base.wrong_radii() < 1e-3


@pytest.mark.parametrize(("rate", "on", "off"), [(FAINT, 8.0, 0.0), (BUMP, 0.3, 0.2)])
def test_a_contradiction_that_comes_and_goes_lasts(rate: float, on: float, off: float) -> None:
    """By hand: the gyro may be stuck, and the base have turned as its wheels did. What comes and goes is above its mean while it is there."""
    base, turned = on_bumps(0.0, 0), 0.0
    for _ in range(round(8.0 / (on + off))):
        base.go(on, rate, 0.0)
        base.go(off, STRAIGHT, 0.0)
        turned += rate * on
    std = np.sqrt(base.odometry.covariance[2, 2])
    assert 0.85 * turned < std < 1.5 * turned
    assert abs(base.odometry.gyro_bias) < 1e-3


@pytest.mark.parametrize(("before", "after"), [(BUMP, BUMP), (RATE, STRAIGHT)])
def test_a_contradiction_ends_while_there_is_no_gyro(before: float, after: float) -> None:
    """What is found afterwards begins anew: a brief one is a bump, none is none. By hand: the deviation stays."""
    base = on_bumps(0.0, 0)
    base.go(0.4, before, 0.0)
    base.go(10.0, STRAIGHT, None)
    variance = base.odometry.covariance[2, 2]
    base.go(0.3, after, 0.0)
    assert base.odometry.covariance[2, 2] < variance + 2e-3**2


@pytest.mark.parametrize(
    ("speed", "seconds", "before", "after"),
    [(0.0, 1.0, RATE, RATE), (TOUR, 1.0, STRAIGHT, BUMP), (TOUR, 0.3, BUMP, BUMP)],
)
def test_a_late_global_pose_decides_as_it_was_decided_in_time(
    speed: float, seconds: float, before: float, after: float
) -> None:
    """Truth: the same pose taken at once. Replayed intervals are of both kinds."""
    late, at_once = Turning(FusedOdometry(FOUR), speed), Turning(FusedOdometry(FOUR), speed)
    for base in (late, at_once):
        base.go(2.0, 0.0, 0.0)
        base.go(seconds, before, 0.0)
    then, pose, covariance = at_once.t, at_once.odometry.pose, 1e-4 * np.eye(3)
    assert at_once.odometry.correct(then, pose, covariance)
    for base in (late, at_once):
        base.go(0.4, after, 0.0)
    assert late.odometry.correct(then, pose, covariance)
    np.testing.assert_allclose(late.odometry.pose, at_once.odometry.pose, atol=1e-6)
    np.testing.assert_allclose(late.odometry.covariance, at_once.odometry.covariance, rtol=1e-3, atol=1e-9)
    assert late.wrong_radii() < 1e-3


@pytest.mark.parametrize(("speed", "rate"), [(0.0, RATE), (TOUR, BUMP)])
def test_both_back_ends_say_the_same_of_it(speed: float, rate: float) -> None:
    both = [Turning(made(back_end, FusedOdometry, FOUR), speed) for back_end in ("compiled", "interpreted")]
    for base in both:
        base.go(0.1, 0.0, 0.0)
        base.go(0.7, rate, 0.0)
        base.go(0.1, rate, rate)
    a, b = (base.odometry._state for base in both)
    np.testing.assert_allclose(a.mean, b.mean, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(a.p, b.p, rtol=1e-11, atol=1e-14)


def lifted(robot_height: float, gap: float):  # type: ignore[no-untyped-def]
    """An edit that puts jacks under a base, which lift its wheels off the floor by ``gap`` [m]."""

    def edit(spec: mujoco.MjSpec) -> None:
        body = next(b for b in spec.bodies if b.name not in ("", "world"))
        for x in (-0.25, 0.25):
            for y in (-0.25, 0.25):
                place = [x, y, 0.05 - robot_height - gap]
                body.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.05, 0, 0], pos=place, mass=0, friction=[1, 0.005, 1e-4]
                )

    return edit


@pytest.mark.parametrize("blocks", [True, False])
def test_a_robot_on_blocks_stands_for_its_estimator(blocks: bool) -> None:
    """Truth: MuJoCo's pose, on jacks and on the floor, with the same commands."""
    robot = load_robot("swerve-ur10")
    geometry, home = robot.base.geometry, robot.home.copy()
    leg = home[robot.state["leg"]]
    axes = geometry.steer_axes(leg)
    home[robot.state["steer"]] = np.arctan2(axes[:, 0], -axes[:, 1]) - geometry.wheel_heading - geometry.leg_angles(leg)
    height = SwervePlant(robot.description, home).world.base_pose()[2]
    edit = lifted(height, 0.03) if blocks else None
    plant = SwervePlant(robot.description, home, seed=3, edit=edit, lift=0.03 if blocks else 0.0)
    estimator = SwerveController(robot, plant.truth().pose, PERIOD).estimator
    start = plant.truth().pose[2]
    for k in range(round(5.0 / PERIOD)):
        estimator.process(plant.measure())
        truth = plant.truth().pose
        wheel = np.full(4, 5.0 * (k * PERIOD > 2.0))
        plant.step(SwerveCommand(wheel, np.zeros(4), np.zeros(6), np.zeros(4)), round(PERIOD / plant.timestep))
    odometry, error = estimator.odometry, estimator.odometry.pose - truth
    assert (abs(truth[2] - start) < 1e-3) if blocks else (truth[2] - start > 1.0)
    assert np.abs(odometry.calibration.wheel_radius / 0.1 - 1.0).max() < 3e-3
    assert error @ np.linalg.solve(odometry.covariance, error) / 3.0 < 3.0
    assert (np.sqrt(odometry.covariance[2, 2]) > 0.1) == blocks
