"""The filter over wheels, gyro and global poses. Truth: bases moved by formula (rigid-body motion, exact on SE(2)),
chi-square bounds for the error over the covariance, finite differences, batch least squares for the linear case."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2
from wheels_on_paper import Drawn, fit_twist, ring

from effort import draws, some
from wbmpc.bases.swerve.fused_odometry import FusedOdometry
from wbmpc.bases.swerve.late_poses import PATIENCE
from wbmpc.bases.swerve.odometry_filter import OdometryNoise
from wbmpc.bases.swerve.odometry_step import BIAS
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.errors import InputError
from wbmpc.model.wheels import ModuleGeometry

FOUR = ring(4)


def calm(**changes: float) -> OdometryNoise:
    """Of the bases on paper: their messages are of this moment."""
    return OdometryNoise(**{"along": 0.0, "across": 0.0, "mean_age": 0.0, **changes})


def filtered(
    base: Drawn, noise: OdometryNoise | None = None, known: WheelCalibration | None = None, lidar=None, **more
):  # type: ignore[no-untyped-def]
    """The filter after the whole way; ``lidar``: (period in messages, messages late, standard deviations (3))."""
    doubt = WheelCalibration.unknown(base.geometry, base.zero, base.radius, 0.0)
    noise = noise or calm(gyro=base.gyro, gyro_bias=base.bias)
    odometry = FusedOdometry(base.geometry, [0.4, -0.3, 0.2], calibration=known or doubt, noise=noise, **more)
    for k, (t, leg, steer, wheel, gyro) in enumerate(base):
        odometry.update(t, leg, steer, wheel, gyro if base.gyro else None)
        if lidar and k >= lidar[1] and (k - lidar[1]) % lidar[0] == 0:
            seen = base.poses[k - lidar[1]] + np.array(lidar[2]) * base.rng.normal(size=3)
            odometry.correct(t - lidar[1] * base.period, seen, np.diag(np.square(lidar[2])))
    return odometry


def squared(error: np.ndarray, covariance: np.ndarray) -> float:
    return float(error @ np.linalg.solve(covariance, error))


def consistent(values: list[float], degrees: int, level: float = 0.998) -> bool:
    """Whether the sum of normalized errors squared lies within its two-sided chi-square bounds; the lower one with the margin of
    1.25 in variance that is kept for slip that lasts."""
    low, high = chi2.ppf([(1 - level) / 2, (1 + level) / 2], degrees * len(values))
    return bool(low / 1.25 < sum(values) < high)


# ---------------------------------------------------------------------- derivatives
@pytest.mark.parametrize("geometry", [FOUR, ring(2), ring(3, hinged=False), ring(6)], ids=["4", "2", "3 fixed", "6"])
def test_derivatives_of_the_twist_are_finite_differences(geometry) -> None:  # type: ignore[no-untyped-def]
    rng, n = np.random.default_rng(1), geometry.modules
    previous = tuple(rng.normal(size=(3, n)))
    now = tuple(b + 0.05 * rng.normal(size=n) for b in previous)
    radius = geometry.wheel_radius * (1.0 + 0.01 * rng.normal(size=n))
    moved = fit_twist(geometry, radius, previous, now)
    factors = np.empty((3, n))
    for i, unit in enumerate(1e-6 * np.eye(n)):
        of = lambda s, u=unit: fit_twist(geometry, radius * (1 + s * u), previous, now).twist
        factors[:, i] = (of(1) - of(-1)) / 2e-6
    along = moved.fit[:, :, 0] * np.cos(moved.heading) + moved.fit[:, :, 1] * np.sin(moved.heading)
    np.testing.assert_allclose(along * moved.rolled, factors, atol=1e-10)
    assert np.abs(moved.twist).max() > 1e-3


# ---------------------------------------------------------------------- consistency
LEVELS = {
    "slip of 0.2 mm/√s": {"slip": 2e-4},
    "slip of 2 mm/√s": {"slip": 2e-3},
    "slip of 6 mm/√s": {"slip": 6e-3},
    "no gyro": {"slip": 2e-3, "gyro": 0.0},
    "zeros of 3 mrad": {"slip": 5e-4, "zero": 3e-3},
    "radii of 0.3 %": {"slip": 5e-4, "radius": 0.003},
    "a bad gyro": {"slip": 2e-3, "gyro": 5e-3, "bias": 0.1},
    "everything": {"slip": 3e-3, "zero": 3e-3, "radius": 0.003, "gyro": 5e-4},
}


@pytest.mark.parametrize("level", some(list(LEVELS), [-1, -5]))
def test_covariance_fits_the_errors(level: str) -> None:
    """Slip is found from the wheels' contradiction alone: the filter knows nothing of its size."""
    pose, bias = [], []
    for seed in range(draws(10, 40)):
        base = Drawn(FOUR, seed, length=8.0, **LEVELS[level])
        odometry = filtered(base)
        pose.append(squared(base.poses[-1] - odometry.pose, odometry.covariance))
        if base.gyro:
            bias.append((odometry.gyro_bias - base.drift) ** 2 / odometry._state.p[BIAS, BIAS])
    assert consistent(pose, 3), np.mean(pose)
    assert not bias or consistent(bias, 1), np.mean(bias)


@pytest.mark.parametrize(
    "geometry", some([ring(2), ring(3, hinged=False), ring(6)], [1]), ids=some(["2", "3 fixed", "6"], [1])
)
def test_covariance_fits_with_any_number_of_modules(geometry) -> None:  # type: ignore[no-untyped-def]
    pose = []
    for seed in range(draws(8, 25)):
        base = Drawn(geometry, seed, slip=2e-3, zero=2e-3, length=8.0)
        odometry = filtered(base)
        pose.append(squared(base.poses[-1] - odometry.pose, odometry.covariance))
    assert consistent(pose, 3), np.mean(pose)


def test_covariance_fits_where_two_of_four_wheels_count() -> None:
    """As that of two wheels: their one contradiction says how much wheels slip, whatever the others do."""
    pose, weights = [], np.array([1.0, 1e-4, 1.0, 1e-4])
    for seed in range(draws(10, 40)):
        base = Drawn(FOUR, seed, slip=2e-3, length=8.0)
        known = WheelCalibration.unknown(FOUR, 0.0, 0.0, 0.0)
        odometry = FusedOdometry(FOUR, [0.4, -0.3, 0.2], calibration=known, noise=calm(gyro_bias=0.01))
        for t, leg, steer, wheel, gyro in base:
            odometry.update(t, leg, steer, wheel, gyro, weights=weights)
        pose.append(squared(base.poses[-1] - odometry.pose, odometry.covariance))
    assert consistent(pose, 3), np.mean(pose)


def lasting_slip(geometry: ModuleGeometry, seed: int, speed: float, lasts: float) -> float:
    """Normalized error squared after 5 s straight on with wheels that slip along their way by an Ornstein-Uhlenbeck process of this
    ``speed`` [m/s], which ``lasts`` [s], two parts in space: along by the wheel, across by its steering."""
    h, n, rng = 0.01, geometry.modules, np.random.default_rng(seed)
    keep, slip = np.exp(-h / lasts), speed * rng.normal(size=(n, 2))
    odometry = FusedOdometry(geometry, noise=calm(), calibration=WheelCalibration.unknown(geometry, 0.0, 0.0, 0.0))
    wheel, bias, previous = np.zeros(n), 0.01 * rng.normal(), None
    for k in range(501):
        ground = slip + [0.4, 0.0]
        angle = np.arctan2(ground[:, 1], ground[:, 0])
        if previous is not None:
            middle = 0.5 * (ground + previous[0])
            along = 0.5 * (angle + previous[1])
            wheel = wheel + h * (middle[:, 0] * np.cos(along) + middle[:, 1] * np.sin(along)) / geometry.wheel_radius
        gyro = bias + 2e-4 / np.sqrt(h) * rng.normal()
        odometry.update(k * h, np.zeros(n), angle - geometry.wheel_heading, wheel, gyro)
        previous = ground, angle
        slip = keep * slip + speed * np.sqrt(1.0 - keep**2) * rng.normal(size=(n, 2))
    return squared(odometry.pose - [2.0, 0.0, 0.0], odometry.covariance)


@pytest.mark.parametrize("modules", [2, 3])
def test_covariance_fits_slip_that_lasts_where_wheels_are_few(modules: int) -> None:
    """30 mm/s for 50 ms at a time: two wheels contradict each other in one direction only, which at the start may say little."""
    values = [lasting_slip(ring(modules, hinged=False), seed, 0.03, 0.05) for seed in range(8)]
    assert sum(values) < chi2.ppf(0.999, 3 * len(values)), np.mean(values)


def test_covariance_grows_with_what_the_wheels_contradict() -> None:
    """A wheel that spins for a moment: the standard deviation jumps by about its way over the wheels' number."""
    growth = []
    for spin in (0.0, 0.05):
        base = Drawn(FOUR, 3, motion=lambda t: np.array([0.3, 0.0, 0.0]), length=4.0)
        odometry = FusedOdometry(FOUR, noise=calm(), calibration=WheelCalibration.unknown(FOUR, 0.0, 0.0, 0.0))
        extra = np.zeros(4)
        for t, leg, steer, wheel, gyro in base:
            extra[1] = spin / FOUR.wheel_radius * np.clip((t - 2.0) / 0.1, 0.0, 1.0)
            odometry.update(t, leg, steer, wheel + extra, gyro)
        growth.append(np.sqrt(odometry.covariance[0, 0]))
    assert growth[0] < 1e-4
    # 50 mm in one of eight components with five degrees of freedom: 50 / √5 each, over √4 wheels, at least once
    assert 0.5 * 0.05 / np.sqrt(20.0) < growth[1] < 2.0 * 0.05 / np.sqrt(20.0)


# ---------------------------------------------------------------------- exact motion, gyro
def test_exact_data_give_the_pose() -> None:
    base = Drawn(FOUR, 0, gyro=0.0, bias=0.0, period=0.0025, length=5.0)
    odometry = filtered(base, calm())
    np.testing.assert_allclose(odometry.pose, base.poses[-1], atol=1e-5)
    assert odometry.slip < 1e-4


def test_gyro_takes_over_where_the_wheels_are_bad() -> None:
    """Zeros of 10 mrad that nobody reported: with the gyro, whose bias was known, the pose is far better than without."""
    lost = {}
    for gyro in (2e-4, 0.0):
        errors = []
        for seed in range(5):
            base = Drawn(FOUR, seed, zero=0.01, gyro=gyro, bias=1e-5)
            odometry = filtered(base)
            errors.append(abs(base.poses[-1][2] - odometry.pose[2]))
        lost[gyro] = np.mean(errors)
    assert lost[2e-4] < 0.3 * lost[0.0]


def test_age_of_the_encoders_does_not_bias_radii() -> None:
    """Messages whose encoders are up to 2 ms old, gyro on time, fast turns: what is learned of the wheels stays small.

    A filter that took the age for noise of each interval made 1 % of it.
    """
    rng, period, rate = np.random.default_rng(0), 0.0025, 0.5
    leg, wheel0 = np.zeros(4), np.zeros(4)
    odometry = FusedOdometry(FOUR)
    speed = np.array([0.0, 0.0, rate])
    base = Drawn(FOUR, 0)
    velocity = base.velocities(leg, leg, speed)
    steer = np.angle(velocity) - FOUR.wheel_heading
    for k in range(4000):
        at = k * period - rng.uniform(0.0, 0.002)
        gyro = rate + 2e-4 / np.sqrt(period) * rng.normal()
        odometry.update(k * period, leg, steer, wheel0 + np.abs(velocity) * at / FOUR.wheel_radius, gyro)
    radius = odometry.calibration.wheel_radius / FOUR.wheel_radius - 1.0
    assert np.abs(radius).max() < 3.0 * odometry.calibration.std[1].max()
    assert odometry.pose[2] == pytest.approx(4000 * period * rate, abs=5e-3)


@pytest.mark.parametrize(("mean_age", "right"), [(1e-3, True), (0.0, False)])
def test_a_turn_that_begins_does_not_look_like_wrong_radii(mean_age: float, right: bool) -> None:
    """Encoders 0 to 2 ms old while the base takes a turn of 0.5 rad/s within a second, after a rest: the wheels' turn lags
    behind the gyro's by half a milliradian, which is the mean age of the messages and not their radii."""
    period, steer, middle = 0.0025, np.full(4, 0.5 * np.pi), []
    turn = lambda t: 0.25 * np.clip(t - 2.0, 0.0, 1.0) ** 2 + 0.5 * max(t - 3.0, 0.0)
    reach = np.abs(Drawn(FOUR, 0).velocities(np.zeros(4), np.zeros(4), np.array([0.0, 0.0, 1.0])))
    for seed in range(4):
        rng, learned = np.random.default_rng(seed), [0.0]
        odometry = FusedOdometry(FOUR, noise=OdometryNoise(mean_age=mean_age))
        for t in period * np.arange(1200):
            wheel = reach * turn(t - rng.uniform(0.0, 0.002)) / FOUR.wheel_radius
            gyro = (turn(t) - turn(t - period)) / period + 2e-4 / np.sqrt(period) * rng.normal()
            odometry.update(t, np.zeros(4), steer, wheel, gyro)
            learned.append(float(odometry.calibration.wheel_radius.mean()) / FOUR.wheel_radius - 1.0)
        middle.append(0.5 * (min(learned) + max(learned)))
    assert (abs(np.mean(middle)) < 5e-4) == right, middle


# ---------------------------------------------------------------------- global poses
LIDAR = (5, 3, (0.005, 0.005, 0.002))


def test_late_global_poses_bound_the_error() -> None:
    """10 Hz, 60 ms late, 5 mm and 2 mrad on a base that slips and is not calibrated: 10 mm rms; covariance consistent."""
    errors, pose = [], []
    for seed in range(draws(5, 15)):
        base = Drawn(FOUR, seed, slip=1e-3, zero=2e-3, radius=2e-3, length=20.0)
        odometry = filtered(base, lidar=LIDAR)
        errors.append(base.poses[-1] - odometry.pose)
        pose.append(squared(errors[-1], odometry.covariance))
        assert odometry.global_poses.rejected == 0
    assert np.sqrt(np.mean(np.sum(np.square(errors)[:, :2], axis=1))) < 0.010
    assert consistent(pose, 3), np.mean(pose)


def test_a_late_pose_counts_as_if_it_had_come_in_time() -> None:
    """Going back in time is exact: the same messages in the order of truth give the same estimate."""
    results = []
    for late in (0, 6):
        base = Drawn(FOUR, 2, slip=1e-3, zero=2e-3, length=3.0)
        messages = list(base)
        odometry = FusedOdometry(FOUR, [0.4, -0.3, 0.2])
        for k, (t, *encoders) in enumerate(messages):
            odometry.update(t, *encoders)
            if k - late == 100:
                odometry.correct(messages[100][0], base.poses[100] + [0.01, -0.02, 0.005], np.diag([1e-6, 1e-6, 1e-6]))
        results.append(odometry)
    # the slip is judged by the residual at the wheels' calibration of that moment, which the pose has changed a little
    np.testing.assert_allclose(results[0].pose, results[1].pose, atol=1e-7)
    np.testing.assert_allclose(results[0].covariance, results[1].covariance, rtol=1e-3, atol=1e-10)


def test_a_pose_that_cannot_be_is_rejected_and_a_lost_filter_finds_back() -> None:
    base = Drawn(FOUR, 4, length=4.0)
    odometry = FusedOdometry(FOUR, [0.4, -0.3, 0.2])
    small = np.diag([25e-6, 25e-6, 4e-6])
    for k, (t, *encoders) in enumerate(base):
        odometry.update(t, *encoders)
        if k == 50:
            previous = odometry.pose.copy()
            assert not odometry.correct(t, base.poses[-1] + [1.0, 0.0, 0.0], small)
            np.testing.assert_array_equal(odometry.pose, previous)
        if k >= 100 and k % 5 == 0:  # the world says again and again that the base was carried away
            odometry.correct(t, base.poses[-1] + [1.0, 0.0, 0.0], small)
    assert odometry.global_poses.rejected == PATIENCE  # in a row: nothing was taken in between
    np.testing.assert_allclose(odometry.pose, base.poses[-1] + [1.0, 0.0, 0.0], atol=0.01)


def test_a_pose_older_than_the_history_is_not_used() -> None:
    odometry = FusedOdometry(FOUR, history=0.1)
    for t, *encoders in Drawn(FOUR, 0, length=1.0):
        odometry.update(t, *encoders)
    previous = odometry.pose.copy()
    assert not odometry.correct(0.5, previous + 0.001, np.eye(3))
    np.testing.assert_array_equal(odometry.pose, previous)


def test_bad_input_is_rejected() -> None:
    odometry = FusedOdometry(FOUR)
    odometry.update(1.0, *np.zeros((3, 4)), 0.0)
    with pytest.raises(InputError, match="time must not go back"):
        odometry.update(0.5, *np.zeros((3, 4)), 0.0)
    with pytest.raises(InputError, match="gyro must be finite"):
        odometry.update(1.5, *np.zeros((3, 4)), np.nan)
    with pytest.raises(InputError, match="wheel"):
        odometry.update(1.5, np.zeros(4), np.zeros(4), np.full(4, np.inf), 0.0)
    with pytest.raises(InputError, match="global pose"):
        odometry.correct(1.0, [0.0, np.nan, 0.0], np.eye(3))
    with pytest.raises(InputError, match="3 by 3"):
        odometry.correct(1.0, np.zeros(3), np.ones(3))


@pytest.mark.parametrize(
    "covariance",
    [-np.eye(3), np.diag([1.0, -1e-3, 1.0]), [[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]], np.eye(2)],
)
def test_what_is_no_covariance_is_rejected(covariance: np.ndarray) -> None:
    """Eigenvalues by hand: -1, -0.001, and 1 - 2."""
    odometry = FusedOdometry(FOUR)
    odometry.update(1.0, *np.zeros((3, 4)), 0.0)
    for take in (
        lambda: odometry.correct(1.0, np.zeros(3), covariance),
        lambda: odometry.place(np.zeros(3), covariance),
    ):
        with pytest.raises(InputError, match="covariance"):
            take()
    assert odometry.global_poses.taken == 0 and not odometry.covariance.any()


def test_poses_of_no_time_and_of_the_future_do_not_count() -> None:
    odometry = FusedOdometry(FOUR, pose_std=(0.1, 0.1, 0.1))
    odometry.update(1.0, *np.zeros((3, 4)), 0.0)
    for t in (np.nan, np.inf):
        with pytest.raises(InputError, match="time must be finite"):
            odometry.correct(t, [0.01, 0.0, 0.0], 1e-4 * np.eye(3))
    assert not odometry.correct(100.0, [0.01, 0.0, 0.0], 1e-4 * np.eye(3))
    assert odometry.global_poses.taken == 0 and not odometry.pose.any()
    assert odometry.correct(1.005, [0.01, 0.0, 0.0], 1e-4 * np.eye(3))  # on its way: as of the last message


@pytest.mark.parametrize(
    "weights", [np.zeros(4), [1.0, 0.0, 0.0, 0.0], [1.0, 1.0, -1.0, 1.0], np.full(4, np.nan), np.ones(3)]
)
def test_weights_that_show_no_motion_are_rejected(weights: np.ndarray) -> None:
    odometry = FusedOdometry(FOUR)
    odometry.update(1.0, *np.zeros((3, 4)))
    with pytest.raises(InputError, match="weights"):
        odometry.update(1.01, np.zeros(4), np.zeros(4), np.ones(4), weights=np.array(weights))
    assert np.isfinite(odometry.pose).all()


def test_wheels_of_little_weight_are_as_uncertain() -> None:
    """Truth: the covariance of weighted least squares, the inverse of the information. One sound wheel says nothing of the turn."""
    weights = np.array([1.0, 0.01, 0.02, 0.001])
    odometry, still = FusedOdometry(FOUR, noise=calm(along=1e-3, across=1e-3)), np.zeros(4)
    ahead = -FOUR.wheel_heading - FOUR.leg_angles(still)
    odometry.update(1.0, still, ahead, still)
    odometry.update(1.01, still, ahead, np.full(4, 0.02), weights=weights)
    x, y = FOUR.steer_axes(np.zeros(4)).T
    one, zero = np.ones(4), np.zeros(4)
    rows = np.stack([np.stack([one, zero, -y], axis=1), np.stack([zero, one, x], axis=1)], axis=1)
    expected = np.linalg.inv(np.einsum("n,nki,nkj->ij", weights, rows, rows))
    found = odometry.twist_covariance
    np.testing.assert_allclose(found / np.trace(found), expected / np.trace(expected), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("covariance", [np.zeros((3, 3)), np.diag([1e-4, 0.0, 1e-4]), np.diag([1e-4, 1e-4, 0.0])])
def test_a_certain_pose_against_a_certain_filter_loses_nothing(covariance: np.ndarray) -> None:
    """Truth: a second filter that was never asked, exact, too, so long as the base stands (no noise without way)."""
    odometry, other = FusedOdometry(FOUR), FusedOdometry(FOUR)
    for filter in (odometry, other):
        for k in range(5):
            filter.update(0.01 * k, *np.zeros((3, 4)))
    with pytest.raises(InputError, match=r"both 0 in a direction.*place\(\)"):
        odometry.correct(0.005, [0.01, 0.01, 0.01], covariance)
    assert len(odometry.global_poses.past) == len(other.global_poses.past) == 4
    for filter in (odometry, other):
        assert filter.correct(0.005, [0.0, 0.0, 0.0], 1e-4 * np.eye(3)) and len(filter.global_poses.past) == 4
        filter.update(0.05, *np.full((3, 4), 0.1))
    np.testing.assert_array_equal(odometry.pose, other.pose)
    np.testing.assert_array_equal(odometry.covariance, other.covariance)
    assert (odometry.global_poses.taken, odometry.global_poses.rejected) == (1, 0)


def test_a_place_that_is_well_known_and_a_yaw_that_is_not_are_no_certain_pose() -> None:
    """Variances of 1e-14 m² and 1e9 rad²: numbers of different units."""
    odometry = FusedOdometry(FOUR, pose_std=(1e-7, 1e-7, 0.1))
    odometry.update(0.0, *np.zeros((3, 4)))
    assert odometry.correct(0.0, [5e-8, 0.0, 1.0], np.diag([1e-20, 1e-20, 1e9]))
    np.testing.assert_allclose(odometry.pose, [5e-8, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"history": np.nan}, "'history' must be finite"),
        ({"history": -1.0}, "'history' must not be negative"),
        ({"pose_std": [-1.0, 0.0, 0.0]}, "'pose_std' must not be negative"),
        ({"pose_std": [np.nan, 0.0, 0.0]}, "'pose_std' needs 3 finite"),
    ],
)
def test_settings_that_cannot_be(given: dict, words: str) -> None:
    with pytest.raises(InputError, match=words):
        FusedOdometry(FOUR, **given)


@pytest.mark.parametrize("given", [{"along": np.nan}, {"gyro": -1.0}, {"slip_window": 0.0}, {"age": np.inf}])
def test_noise_that_cannot_be(given: dict) -> None:
    with pytest.raises(InputError, match="odometry noise: "):
        OdometryNoise(**given)


def test_brakes_that_are_not_numbers() -> None:
    """They are rejected before anything is taken in: the next message counts from the last good one."""
    odometry, zero = FusedOdometry(FOUR), np.zeros(4)
    odometry.update(0.0, zero, zero, zero)
    with pytest.raises(InputError, match="'brake' needs 4 finite numbers"):
        odometry.update(0.1, zero, zero, np.ones(4), brake=[0.0, np.nan, 0.0, 0.0])
    assert not odometry.update(0.1, zero, zero, zero, brake=zero).any()
