"""Wheel odometry. Truth: rigid-body motion integrated by another integrator, with its own wheel kinematics."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, null_space
from wheels_on_paper import fit_twist

from wbmpc.bases.swerve.wheel_odometry import WheelOdometry, outlier_wheel
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.studies.pankert2022.release_odometry import ReleaseOdometry

ROBOT = load_robot("swerve-ur10")
GEOMETRY = ROBOT.base.geometry
FIXED = load_robot("swerve-fixed-ur10").base.geometry
TELESCOPE = load_robot("telescope-ur10").base.geometry
CLOSED = np.array([0.5, -0.4, -0.6, 0.7])


def twist(t: float) -> np.ndarray:
    """A smooth planar motion (vx, vy, ω) that never stops."""
    return np.array([0.30 + 0.05 * np.sin(1.1 * t), 0.08 * np.sin(0.7 * t), 0.15 * np.cos(0.9 * t)])


def swinging(t: float) -> np.ndarray:
    return CLOSED + 0.2 * np.sin(0.5 * t + np.arange(4.0))


def swing_rates(t: float) -> np.ndarray:
    return 0.1 * np.cos(0.5 * t + np.arange(4.0))


def axle_velocities(geometry, leg, rate, v) -> np.ndarray:
    """Velocities of the steer axes in the base, by complex numbers."""
    hinge = geometry.hinge[:, 0] + 1j * geometry.hinge[:, 1]
    slides, leg = geometry.slides, leg * geometry.legs_move
    along = np.exp(1j * (geometry.leg_heading + np.where(slides, 0.0, leg)))
    arm = (geometry.leg_length + np.where(slides, leg, 0.0)) * along
    return v[0] + 1j * v[1] + 1j * v[2] * (hinge + arm) + rate * np.where(slides, along, 1j * arm)


def roll_out(geometry, duration: float, period: float, leg, rate):
    """Poses and (leg, steer, wheel) samples of wheels that roll without slip; steering follows the velocity."""
    times = np.arange(round(duration / period) + 1) * period

    def speed(t, leg_angle):
        velocity = axle_velocities(geometry, leg_angle, rate(t), twist(t))
        heading = np.angle(velocity) - geometry.wheel_heading - leg_angle * geometry.legs_move * (1.0 - geometry.slides)
        return np.abs(velocity) / geometry.wheel_radius, heading

    def rates(t, z):
        v, c, s = twist(t), np.cos(z[2]), np.sin(z[2])
        return [c * v[0] - s * v[1], s * v[0] + c * v[1], v[2], *speed(t, leg(t))[0]]

    start = np.array([0.3, -0.2, 0.5, 1.0, 2.0, 3.0, 4.0])
    z = solve_ivp(rates, (0.0, times[-1]), start, t_eval=times, rtol=1e-11, atol=1e-12).y.T
    steer = np.unwrap([speed(t, leg(t))[1] for t in times], axis=0)
    return z[:, :3], [(leg(t), steer[k], z[k, 3:]) for k, t in enumerate(times)]


MOTIONS = {
    "legs swing": (GEOMETRY, swinging, swing_rates),
    "legs slide": (TELESCOPE, lambda t: 0.1 + 0.2 * swinging(t), lambda t: 0.2 * swing_rates(t)),
    "brakes closed": (GEOMETRY, lambda t: CLOSED, lambda t: np.zeros(4)),
    "fixed legs": (FIXED, lambda t: np.zeros(4), lambda t: np.zeros(4)),
}


@pytest.mark.parametrize("motion", MOTIONS)
def test_exact_data_give_the_pose(motion):
    geometry, leg, rate = MOTIONS[motion]
    poses, samples = roll_out(geometry, 5.0, 0.0025, leg, rate)
    odometry = WheelOdometry(geometry, poses[0])
    slip = []
    for sample in samples:
        odometry.update(*sample)
        slip.append(odometry.slip)
    assert np.abs(odometry.pose - poses[-1]).max() < 1e-6
    assert np.hypot(*(poses[-1] - poses[0])[:2]) > 1.0
    assert max(slip) < 1e-8


def test_error_is_of_second_command_in_the_sampling_period():
    errors = []
    for period in (0.05, 0.025):
        poses, samples = roll_out(GEOMETRY, 5.0, period, swinging, swing_rates)
        odometry = WheelOdometry(GEOMETRY, poses[0])
        for sample in samples:
            odometry.update(*sample)
        errors.append(np.hypot(*(odometry.pose - poses[-1])[:2]))
    assert 3.0 < errors[0] / errors[1] < 5.0


@pytest.mark.parametrize("v", [(0.4, 0.1, 0.0), (0.2, -0.3, 0.8), (0.0, 0.0, 1.0), (0.1, 0.0, 1e-9)])
def test_constant_twists_are_integrated_exactly_in_one_step(v):
    duration = 2.0
    velocity = axle_velocities(GEOMETRY, CLOSED, np.zeros(4), v)
    steer = np.angle(velocity) - GEOMETRY.wheel_heading - CLOSED
    odometry = WheelOdometry(GEOMETRY)
    odometry.update(CLOSED, steer, np.zeros(4))
    pose = odometry.update(CLOSED, steer, np.abs(velocity) * duration / GEOMETRY.wheel_radius)
    moved = expm(duration * np.array([[0.0, -v[2], v[0]], [v[2], 0.0, v[1]], [0.0, 0.0, 0.0]]))
    assert pose == pytest.approx([moved[0, 2], moved[1, 2], v[2] * duration], abs=1e-12)
    assert odometry.slip < 1e-12


def test_legs_that_swing_under_a_standing_base_do_not_move_it():
    rolled = lambda a, b: GEOMETRY.leg_length * (b - a) / GEOMETRY.wheel_radius
    odometry = WheelOdometry(GEOMETRY)
    leg, wheel = CLOSED, np.zeros(4)
    across = GEOMETRY.leg_heading + np.pi / 2 - GEOMETRY.wheel_heading
    odometry.update(leg, across, wheel)
    for _ in range(100):
        new = leg + 0.005
        wheel = wheel + rolled(leg, new)
        odometry.update(new, across, wheel)
        leg = new
    assert np.abs(odometry.pose).max() < 1e-9


def test_residual_shows_the_wheel_that_slips():
    odometry = WheelOdometry(GEOMETRY)
    steer = -CLOSED - GEOMETRY.wheel_heading
    odometry.update(CLOSED, steer, np.zeros(4))
    odometry.update(CLOSED, steer, np.array([0.1, 0.1, 0.2, 0.1]))
    assert np.argmax(np.linalg.norm(odometry.residual, axis=1)) == 2
    assert odometry.slip > 1e-3


def test_calibration_repairs_radii_and_zeros():
    poses, samples = roll_out(GEOMETRY, 3.0, 0.0025, swinging, swing_rates)
    factor, leg_offset, steer_offset = np.array([1.01, 0.99, 1.0, 1.02]), 0.01 * np.arange(4), 0.02 * np.ones(4)
    reported = [(leg + leg_offset, steer + steer_offset, wheel / factor) for leg, steer, wheel in samples]
    right = WheelOdometry(
        GEOMETRY,
        poses[0],
        wheel_radius=GEOMETRY.wheel_radius * factor,
        leg_offset=leg_offset,
        steer_offset=steer_offset,
    )
    wrong = WheelOdometry(GEOMETRY, poses[0])
    for sample in reported:
        right.update(*sample)
        wrong.update(*sample)
    assert np.abs(right.pose - poses[-1]).max() < 1e-6
    assert np.hypot(*(wrong.pose - poses[-1])[:2]) > 5e-3


def test_the_releases_odometry_drifts_where_steering_turns_and_not_on_straight_lines():
    poses, samples = roll_out(GEOMETRY, 5.0, 0.0025, lambda t: CLOSED, lambda t: np.zeros(4))
    release, straight = ReleaseOdometry(GEOMETRY, poses[0], 0.0025), ReleaseOdometry(GEOMETRY, [0, 0, 0], 0.0025)
    for sample in samples:
        release.update(*sample)
    assert np.hypot(*(release.pose - poses[-1])[:2]) > 1e-3
    heading = -CLOSED - GEOMETRY.wheel_heading
    for k in range(101):
        straight.update(CLOSED, heading, np.full(4, 0.1 * k))
    assert straight.pose == pytest.approx([10.0 * GEOMETRY.wheel_radius, 0.0, 0.0], abs=1e-12)


def test_the_releases_odometry_reads_the_steering_every_50_ms() -> None:
    """Truth: least squares and Euler's rule written out, with the steering of every twentieth sample."""
    poses, samples = roll_out(GEOMETRY, 1.0, 0.0025, lambda t: CLOSED, lambda t: np.zeros(4))
    release, pose = ReleaseOdometry(GEOMETRY, poses[0], 0.0025), np.array(poses[0], float)
    rows = np.vstack([[[1.0, 0.0, -y], [0.0, 1.0, x]] for x, y in GEOMETRY.steer_axes(CLOSED)])
    before, held = None, np.zeros(4)
    for k, (leg, steer, wheel) in enumerate(samples):
        release.update(leg, steer, wheel)
        held = steer if k % 20 == 0 else held
        if before is not None:
            heading = GEOMETRY.wheel_heading + GEOMETRY.leg_angles(leg) + held
            way = GEOMETRY.wheel_radius * (wheel - before)
            dx, dy, turn = np.linalg.lstsq(rows, np.stack([way * np.cos(heading), way * np.sin(heading)], 1).ravel())[0]
            c, s = np.cos(pose[2]), np.sin(pose[2])
            pose += [c * dx - s * dy, s * dx + c * dy, turn]
        before = wheel
    assert np.abs(pose - poses[0]).max() > 0.1 and release.pose == pytest.approx(pose, abs=1e-9)


@pytest.mark.parametrize("bad", [np.zeros(3), np.array([0.0, 0.0, np.nan, 0.0])])
def test_wrong_samples_are_rejected(bad):
    odometry = WheelOdometry(replace(GEOMETRY))
    with pytest.raises(InputError, match="steer"):
        odometry.update(np.zeros(4), bad, np.zeros(4))


@pytest.mark.parametrize("closed", [(), (0,), (1, 2)])
def test_what_open_legs_show_is_no_slip(closed: tuple[int, ...]) -> None:
    """Truth: statics. Forces of the wheels that balance each other, along the legs at open hinges, move nothing that is looked
    at, nor does the base's own motion; all else is looked at: 8 components less 3 of the motion less those forces."""
    leg, is_open = CLOSED, np.isin(np.arange(4), closed, invert=True)
    odometry = WheelOdometry(GEOMETRY)
    previous = odometry.checked(leg, np.full(4, 0.3), np.zeros(4))
    moved = fit_twist(GEOMETRY, odometry.radius, previous, odometry.checked(leg, np.full(4, 0.3), np.full(4, 0.1)))
    axes = GEOMETRY.steer_axes(leg)
    arms = axes - GEOMETRY.hinge
    rows = moved.leg_residual_basis(GEOMETRY.leg_motions(leg, axes), is_open)
    motions = [[[1.0, 0.0] for _ in axes], [[0.0, 1.0] for _ in axes], [[-y, x] for x, y in axes]]
    motions = np.array(motions).reshape(3, 8)
    swings = np.array([np.eye(4)[i][:, None] * [-arms[i, 1], arms[i, 0]] for i in np.flatnonzero(is_open)]).reshape(
        -1, 8
    )
    forces = null_space(np.concatenate([motions, swings]))
    np.testing.assert_allclose(rows @ rows.T, np.eye(len(rows)), atol=1e-12)
    np.testing.assert_allclose(rows @ motions.T, 0.0, atol=1e-12)
    np.testing.assert_allclose(rows @ forces, 0.0, atol=1e-12)
    assert len(rows) == is_open.sum() == 8 - 3 - forces.shape[1]


def test_a_wheel_that_is_known_to_slip_does_not_count() -> None:
    """Truth: the same samples before one wheel's angles were spoilt."""
    _, samples = roll_out(FIXED, 1.0, 0.1, *MOTIONS["fixed legs"][1:])
    radius, weights = np.full(4, FIXED.wheel_radius), np.array([1.0, 1e-9, 1.0, 1.0])
    for previous, now in pairwise(samples):
        spoilt = now[0], now[1] + [0.0, 0.5, 0.0, 0.0], now[2] + [0.0, 0.1, 0.0, 0.0]
        true = fit_twist(FIXED, radius, previous, now).twist
        np.testing.assert_allclose(fit_twist(FIXED, radius, previous, spoilt, weights).twist, true, atol=1e-5)
        assert np.abs(fit_twist(FIXED, radius, previous, spoilt).twist - true).max() > 1e-3
        same = fit_twist(FIXED, radius, previous, spoilt, np.ones(4)).twist
        np.testing.assert_allclose(same, fit_twist(FIXED, radius, previous, spoilt).twist, atol=1e-15)


@pytest.mark.parametrize("odd", range(4))
def test_the_odd_wheel_is_the_one_without_which_the_others_agree(odd: int) -> None:
    """Truth: linear least squares over three wheels at a time."""
    rng = np.random.default_rng(odd)
    axes = GEOMETRY.steer_axes(CLOSED)
    rows = np.concatenate([np.tile(np.eye(2), (4, 1)), (axes @ [[0.0, 1.0], [-1.0, 0.0]]).reshape(8, 1)], axis=1)
    moved = rows @ [0.3, -0.1, 0.2] + 0.002 * rng.normal(size=8)
    moved[2 * odd : 2 * odd + 2] += 0.05 * rng.normal(size=2)
    squares = lambda keep: float(np.linalg.lstsq(rows[keep], moved[keep], rcond=None)[1][0])
    wheels = np.repeat(np.arange(4), 2)
    without = [squares(wheels != i) for i in range(4)]
    residual = moved - rows @ np.linalg.lstsq(rows, moved, rcond=None)[0]
    i, share = outlier_wheel(residual.reshape(4, 2), axes)
    assert i == odd == int(np.argmin(without))
    assert share == pytest.approx(1.0 - without[i] / squares(wheels >= 0))
    assert outlier_wheel(np.stack([residual.reshape(4, 2)] * 3), axes) == (
        i,
        pytest.approx(share),
    )  # thrice the same interval
