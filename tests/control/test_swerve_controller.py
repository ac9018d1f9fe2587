"""The swerve robot's controller between MPC and drives. Truth: matrix exponentials, drives integrated by themselves, sums by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from swerve_messages import HURRIED, NO_GYRO, PERIOD, SWERVE, constant_policy, message, swerve_input

from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.estimator import EstimatorSettings
from wbmpc.bases.swerve.messages import SwerveMeasurement
from wbmpc.bases.swerve.tracking import TrackingSettings
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.model.robot import RobotModel
from wbmpc.model.wheels import aligned_steering
from wbmpc.mpc.policy import Policy
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.studies.pankert2022.side_slip import FlipController
from wbmpc.studies.pankert2022.track_control import TrackController, TrackEstimation, TrackTracking
from wbmpc.types import GlobalPose


def moved(pose: np.ndarray, twist: np.ndarray, seconds: float) -> np.ndarray:
    """A pose after a constant body twist, by the matrix exponential."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    at = np.array([[c, -s, pose[0]], [s, c, pose[1]], [0, 0, 1]])
    vx, vy, w = twist * seconds
    end = at @ expm(np.array([[0, -w, vx], [w, 0, vy], [0, 0, 0]]))
    return np.array([end[0, 2], end[1, 2], pose[2] + w])


@pytest.mark.parametrize("open_brakes", [False, True])
def test_swerve_prediction_integrates_what_will_be_commanded(open_brakes: bool) -> None:
    """Over the delay the policy in force counts, and from its time on the queued one."""
    pose = np.array([1.0, -2.0, 0.7])
    controller = SwerveController(SWERVE, pose, PERIOD, brakes=lambda t: np.full(4, float(open_brakes)))
    first, second, plans = swerve_input(1), swerve_input(2), PolicyQueue()
    plans.add(0.0, constant_policy(first, steer=0.3))
    plans.add(0.0150, constant_policy(second))
    controller.measure(message())
    observation = controller.predict(0.010, 0.020, plans)
    assert observation.t == pytest.approx(0.020)
    given, got = SWERVE.input, SWERVE.state.split(observation.x)
    halfway = moved(pose, first[given["base"]], 0.005)
    np.testing.assert_allclose(got["base"], moved(halfway, second[given["base"]], 0.005), atol=1e-12)
    change = 0.005 * (first + second)
    np.testing.assert_allclose(got["wheel"], change[given["wheel"]], atol=1e-12)
    np.testing.assert_allclose(got["arm"], change[given["arm"]], atol=1e-12)
    np.testing.assert_allclose(got["leg"], change[given["leg"]] * open_brakes, atol=1e-12)
    # the steering is the plan's, not the measured one
    np.testing.assert_allclose(got["steer"], 0.3 + 0.010 + change[given["steer"]], atol=1e-12)


@pytest.mark.parametrize("allow_side_slip", [True, False])
def test_the_odometry_does_not_listen_to_a_wheel_that_a_plan_lets_slip(allow_side_slip: bool) -> None:
    """Three wheels roll 1 cm straight ahead, the fourth stands across. Truth: the base has come 1 cm."""
    trusting = EstimatorSettings(use_gyro=False, reject_slipping_wheels=False)
    kind = FlipController if allow_side_slip else SwerveController
    geometry, controller = SWERVE.base.geometry, kind(SWERVE, np.zeros(3), PERIOD, estimation=trusting)
    u, plans, across = np.zeros(SWERVE.input.size), PolicyQueue(), np.array([0.5 * np.pi, 0.0, 0.0, 0.0])
    u[SWERVE.input["base"]] = [0.4, 0.0, 0.0]
    steer = -geometry.wheel_heading + across
    plan = constant_policy(u)
    plan.x[:, SWERVE.state["steer"]] = steer
    plans.add(0.0, plan)
    controller.measure(message(0.0, steer=steer))
    controller.command(0.0, plans)
    controller.measure(message(0.025, steer=steer, wheel=0.01 / geometry.wheel_radius * (across == 0.0)))
    error = np.abs(controller.estimator.odometry.pose - [0.01, 0.0, 0.0]).max()
    assert error < 1e-4 if allow_side_slip else error > 1e-3


@pytest.mark.parametrize("reject_slipping_wheels", [True, False])
def test_the_odometry_does_not_listen_to_a_wheel_that_hangs_in_the_air(reject_slipping_wheels: bool) -> None:
    """Three wheels roll straight ahead at 0.3 m/s, the fourth turns 0.1 m/s faster. Truth: the base goes as the three do."""
    geometry = SWERVE.base.geometry
    controller = SwerveController(
        SWERVE,
        np.zeros(3),
        PERIOD,
        estimation=EstimatorSettings(use_gyro=False, reject_slipping_wheels=reject_slipping_wheels),
    )
    speed = np.array([0.3, 0.3, 0.4, 0.3]) / geometry.wheel_radius
    for k in range(150):
        controller.measure(message(k * PERIOD, steer=-geometry.wheel_heading, wheel=k * PERIOD * speed))
    error = np.abs(controller.estimator.odometry.pose - [149 * PERIOD * 0.3, 0.0, 0.0]).max()
    assert error < 1e-3 if reject_slipping_wheels else error > 5e-3


@pytest.mark.parametrize("use_gyro", [True, False])
def test_two_wheels_of_four_may_slip_where_there_is_a_gyro(use_gyro: bool) -> None:
    """Wheels across in the air turn 0.1 m/s faster and 0.06 m/s slower. Truth: the base goes as the other two do, 0.3 m/s ahead."""
    geometry = SWERVE.base.geometry
    settings = EstimatorSettings(use_gyro=use_gyro)
    controller = SwerveController(SWERVE, np.zeros(3), PERIOD, estimation=settings)
    speed = np.array([0.3, 0.4, 0.24, 0.3]) / geometry.wheel_radius
    for k in range(150):
        controller.measure(message(k * PERIOD, steer=-geometry.wheel_heading, wheel=k * PERIOD * speed))
    error = np.abs(controller.estimator.odometry.pose - [149 * PERIOD * 0.3, 0.0, 0.0]).max()
    assert error < 2e-3 if use_gyro else error > 5e-3


def test_the_arms_zeros_are_taken_from_what_its_encoders_say() -> None:
    """Truth: true angle = measured - zero."""
    zeros, arm = 1e-3 * np.arange(6), np.linspace(-1.0, 1.0, 6)
    for smoothing in (0.0, 0.025):
        settings = TrackEstimation(use_gyro=False, arm_offset=zeros, smoothing=smoothing)
        controller = TrackController(SWERVE, np.zeros(3), PERIOD, estimation=settings)
        controller.measure(replace(message(0.0), arm=arm))
        assert controller.state()[SWERVE.state["arm"]] == pytest.approx(arm - zeros)


def test_swerve_prediction_holds_what_lagging_drives_still_owe() -> None:
    """A drive with a lag of T stops T · speed after its last command: the observation is where that is.

    Truth: arm joints behind first-order drives, integrated by themselves until they stand.
    """
    lag, u, plans = 0.030, swerve_input(3), PolicyQueue()
    controller = SwerveController(SWERVE, np.zeros(3), PERIOD, tracking=TrackingSettings(lag=lag))
    plans.add(0.0, constant_policy(u))
    arm, position, speed = SWERVE.input["arm"], np.zeros(6), np.zeros(6)

    def drive(command: np.ndarray, seconds: float) -> None:
        nonlocal position, speed
        decay = np.exp(-seconds / lag)
        position = position + command * seconds + (speed - command) * lag * (1.0 - decay)
        speed = command + (speed - command) * decay

    for k in range(8):  # still far from steady
        controller.measure(message(k * PERIOD, arm=position.copy()))
        drive(controller.command(k * PERIOD, plans).arm, PERIOD)
    t = 8 * PERIOD
    controller.measure(message(t, arm=position.copy()))
    observation = controller.predict(t, t + 0.010, plans)
    assert observation.t == pytest.approx(t + 0.010 + lag)
    drive(u[arm], 0.010)
    drive(np.zeros(6), 50 * lag)
    np.testing.assert_allclose(observation.x[SWERVE.state["arm"]], position, atol=1e-12)


def test_swerve_commands_lead_by_the_lag_and_steer_to_the_plan() -> None:
    lag, times = 0.5, np.linspace(0.0, 10.0, 11)
    inputs = np.arange(10.0)[:, None] * np.full(SWERVE.input.size, 0.1)
    x = np.zeros((11, SWERVE.state.size))
    x[:, SWERVE.state["steer"]] = 0.2 * times[:, None]
    plans = PolicyQueue()
    plans.add(0.0, Policy(times, x, inputs, np.zeros((10, SWERVE.input.size, SWERVE.state.size))))
    controller = SwerveController(SWERVE, np.zeros(3), PERIOD, tracking=TrackingSettings(lag=lag, steer_gain=4.0))
    controller.measure(message(steer=np.full(4, 0.6)))
    command = controller.command(2.7, plans)  # 3.2 s on the plan's clock: the fourth interval
    np.testing.assert_allclose(command.wheel, 0.3)
    np.testing.assert_allclose(command.arm, 0.3)
    np.testing.assert_allclose(command.steer, 0.3 + 4.0 * (0.2 * 3.2 - 0.6))


def test_swerve_base_stands_while_its_wheels_are_aligned() -> None:
    """A wheel that points 0.5 rad beside the plan: the base stands, the wheel turns, and then everything goes on."""
    u, plans = np.full(SWERVE.input.size, 0.2), PolicyQueue()
    u[SWERVE.input["steer"]] = 0.0
    times = np.linspace(0.0, 10.0, 11)
    x = np.zeros((11, SWERVE.state.size))
    plans.add(0.0, Policy(times, x, np.tile(u, (10, 1)), np.zeros((10, u.size, SWERVE.state.size))))
    controller, steer, stood = SwerveController(SWERVE, np.zeros(3), PERIOD), np.array([0.5, 0.0, 0.0, 0.0]), 0
    for k in range(800):
        controller.measure(message(k * PERIOD, steer=steer.copy(), arm=np.full(6, 0.2 * k * PERIOD)))
        command = controller.command(k * PERIOD, plans)
        if controller.tracking.aligning:
            stood += 1
            np.testing.assert_array_equal(command.wheel, 0.0)
            now = controller.predict(k * PERIOD, k * PERIOD + 0.01, plans)
            np.testing.assert_array_equal(now.x[SWERVE.state["base"]], 0.0)
        np.testing.assert_allclose(command.arm, 0.2, rtol=1e-12)
        steer = steer + PERIOD * command.steer
    # as fast as the servo may until 15 / s asks for less, then an exponential of 15 / s to 0.1 rad
    maximum = 5.75
    slow = maximum / 15.0
    assert stood == pytest.approx(((0.5 - slow) / maximum + np.log(slow / 0.1) / 15.0) / PERIOD, abs=3)
    np.testing.assert_allclose(command.wheel, 0.2)


def test_no_steering_command_is_beyond_what_the_description_allows() -> None:
    """Planner's limit 2.0 rad/s, wheels 1.5 rad off: the largest command is the drive's own limit, or the planner's without one."""
    for own, maximum in (({}, 2.0), ({"steer_LF": 2.2}, 2.2)):
        d = SWERVE.description
        slow = {**d.limits.velocity, **{name: 2.0 for name in SWERVE.input.groups["steer"]}}
        limits = d.limits.model_copy(update={"velocity": slow, "actuator_velocity": own})
        controller = SwerveController(RobotModel(d.model_copy(update={"limits": limits})), np.zeros(3), PERIOD)
        plans, largest = PolicyQueue(), 0.0
        plans.add(0.0, constant_policy(np.zeros(SWERVE.input.size), steer=1.5))
        for k in range(100):
            controller.measure(message(k * PERIOD))
            largest = max(largest, float(np.abs(controller.command(k * PERIOD, plans).steer).max()))
        assert largest == maximum


def test_first_plan_starts_from_wheels_that_agree() -> None:
    """Wheels turned by hand: the state for the first plan has the nearest angles with a common center, not the measured."""
    crooked = np.array([0.6, -0.3, 0.2, 0.9])
    controller = SwerveController(SWERVE, np.zeros(3), PERIOD)
    controller.measure(message(steer=crooked))
    steer = controller.predict(0.0, 0.0, PolicyQueue()).x[SWERVE.state["steer"]]
    np.testing.assert_allclose(steer, aligned_steering(SWERVE.base.geometry, np.zeros(4), crooked))
    nearly = 0.01 * crooked
    controller.measure(message(steer=nearly))
    np.testing.assert_array_equal(controller.predict(0.0, 0.0, PolicyQueue()).x[SWERVE.state["steer"]], nearly)


def test_swerve_wheels_are_slowed_together() -> None:
    u, plans = np.zeros(SWERVE.input.size), PolicyQueue()
    limit = SWERVE.limits.input_upper[SWERVE.input["wheel"]]
    u[SWERVE.input["wheel"]] = limit * [0.5, 2.0, -1.0, 0.1]
    plans.add(0.0, constant_policy(u))
    controller = SwerveController(SWERVE, np.zeros(3), PERIOD)
    controller.measure(message())
    np.testing.assert_allclose(controller.command(0.0, plans).wheel, limit * [0.25, 1.0, -0.5, 0.05])


def test_commands_change_by_what_accelerations_allow() -> None:
    """From rest to a plan: no drive changes faster than its limit, wheels and arm keep to the straight way between two motions,
    and the slowest of them decides when it is there (truth: speed over acceleration)."""
    u, plans, maximum = np.zeros(HURRIED.input.size), PolicyQueue(), HURRIED.limits.input_rate
    given = HURRIED.input
    u[given["wheel"]], u[given["steer"]], u[given["arm"]] = [1.0, -2.0, 3.0, 4.0], [0.3, 0.0, -0.3, 0.1], 0.2
    plans.add(0.0, constant_policy(u))
    controller = SwerveController(
        HURRIED, np.zeros(3), PERIOD, tracking=TrackingSettings(planned_steering=False, steer_gain=0.0)
    )
    previous, ticks, arm = np.zeros(u.size), 0, np.zeros(6)
    controller.measure(message())
    ahead = controller.predict(0.0, 8 * PERIOD, plans).x
    for k in range(60):
        controller.measure(message(k * PERIOD, arm=arm.copy()))
        command = controller.command(k * PERIOD, plans)
        arm += command.arm * PERIOD
        now = previous.copy()
        now[given["wheel"]], now[given["steer"]], now[given["arm"]] = command.wheel, command.steer, command.arm
        assert np.all(np.abs(now - previous) <= maximum * PERIOD * (1.0 + 1e-12))
        share = now[given["wheel"]] / u[given["wheel"]]
        np.testing.assert_allclose(share, share[0])
        alone = np.minimum(np.abs(u), (k + 1) * maximum * PERIOD) * np.sign(u)  # each steering axis by itself
        np.testing.assert_allclose(now[given["steer"]], alone[given["steer"]], atol=1e-12)
        ticks += int(share[0] < 1.0 - 1e-9)
        previous = now
        if k == 7:  # the prediction knew: eight ticks of ramp
            ramp = PERIOD * np.sum(np.arange(1, 9) * maximum[given["wheel"]][0] * PERIOD) * u[given["wheel"]] / 4.0
            np.testing.assert_allclose(ahead[HURRIED.state["wheel"]], ramp)
    assert ticks == round(4.0 / maximum[given["wheel"]][0] / PERIOD) - 1
    np.testing.assert_allclose(previous, u, atol=1e-12)


def test_swerve_stops_when_its_plan_has_run_out() -> None:
    plans, controller = PolicyQueue(), SwerveController(SWERVE, np.zeros(3), PERIOD, brakes=lambda t: np.ones(4))
    plans.add(0.0, constant_policy(swerve_input(4)))
    controller.measure(message())
    for command in (controller.command(10.1, plans), controller.stop()):
        for part in (command.wheel, command.steer, command.arm, command.brake):
            np.testing.assert_array_equal(part, 0.0)
    assert np.abs(controller.command(9.9, plans).arm).max() > 0.0


def test_gyro_bias_is_found_at_rest() -> None:
    """Wheels at rest show that the base does not turn: the yaw stays, and the bias is the mean of the readings."""
    controller, deaf = (
        SwerveController(SWERVE, np.zeros(3), PERIOD),
        SwerveController(SWERVE, np.zeros(3), PERIOD, estimation=NO_GYRO),
    )
    rng = np.random.default_rng(0)
    readings = 0.008 + 2e-4 / np.sqrt(PERIOD) * rng.normal(size=2000)
    for k, reading in enumerate(readings):
        for a in (controller, deaf):
            a.measure(SwerveMeasurement(k * PERIOD, *np.zeros((3, 4)), np.zeros(6), np.array([9.0, 9.0, reading])))
    assert controller.estimator.odometry.gyro_bias == pytest.approx(readings[1:].mean(), abs=2e-5)
    assert abs(controller.estimator.odometry.pose[2]) < 1e-6
    assert deaf.estimator.odometry.gyro_bias == 0.0 and deaf.estimator.odometry.pose[2] == 0.0


def test_a_sagging_arm_is_learned_and_taken_off() -> None:
    """Drives of first order, integrated here, and a load that turns the joints besides: they turn as planned after a while,
    though the encoders' messages are up to 2 ms old."""
    rng, sag = np.random.default_rng(0), np.array([0.0, 0.03, -0.02, 0.0, 0.01, 0.0])
    u, given = 0.2 * swerve_input(1), SWERVE.input
    u[[i for i in range(u.size) if i not in range(u.size)[given["arm"]]]] = 0.0
    controller = SwerveController(SWERVE, np.zeros(3), PERIOD, tracking=TrackingSettings(lag=0.02))
    arm, rate, plans = np.zeros((2000, 6)), np.zeros(6), PolicyQueue()
    plans.add(0.0, constant_policy(u))
    for k in range(1, 2000):
        t = k * PERIOD
        old = rng.uniform(0.0, 0.8)
        controller.measure(message(t, arm=old * arm[k - 2] + (1.0 - old) * arm[k - 1], steer=np.full(4, t)))
        rate += (1.0 - np.exp(-PERIOD / 0.02)) * (controller.command(t, plans).arm - rate)
        arm[k] = arm[k - 1] + PERIOD * (rate + sag)
    np.testing.assert_allclose(controller.tracking.arm.sag, sag, atol=2e-3)
    np.testing.assert_allclose((arm[-1] - arm[-401]) / (400 * PERIOD), u[given["arm"]], atol=2e-3)


def test_wheels_and_steering_are_reported_what_friction_takes() -> None:
    """Drives that lose 0.03 rad/s, as dry friction makes them. Truth: after a while they turn as planned."""
    u, given, lost, period = 0.2 * swerve_input(1), SWERVE.input, 0.03, 0.01
    u[given["wheel"]], u[given["steer"]] = 2.0, 1.0  # the plan's steering angles rise by 1 rad/s
    controller, plans = (
        TrackController(SWERVE, np.zeros(3), period, tracking=TrackTracking()),
        PolicyQueue(),
    )
    plans.add(0.0, constant_policy(u))
    wheel, steer, behind = np.zeros(4), np.zeros(4), []
    for k in range(300):
        t = k * period
        controller.measure(message(t, wheel=wheel, steer=steer))
        command = controller.command(t, plans)
        wheel, steer = wheel + period * (command.wheel - lost), steer + period * (command.steer - lost)
        behind.append(t + period - steer)
    np.testing.assert_allclose(command.wheel - lost, 2.0, atol=3e-3)
    # a servo of 5 /s alone would stay 6 mrad behind
    assert np.abs(behind[50]).max() > 3e-3 and np.abs(behind[-1]).max() < 1e-3


def test_smoothed_positions_are_those_of_the_moment() -> None:
    """A base and an arm at constant speeds whose messages are up to 2 ms old. Truth: speed times time."""
    rng, u = np.random.default_rng(0), np.zeros(SWERVE.input.size)
    geometry, given = SWERVE.base.geometry, SWERVE.input
    u[given["base"]], u[given["arm"]] = [0.3, 0.0, 0.0], 0.5
    plan, steer = constant_policy(u), -geometry.wheel_heading
    plan.x[:, SWERVE.state["steer"]] = steer
    controller, plans = (
        TrackController(SWERVE, np.zeros(3), PERIOD, estimation=TrackEstimation(use_gyro=False, smoothing=0.025)),
        PolicyQueue(),
    )
    plans.add(0.0, plan)
    base, arm = [], []
    for k in range(400):
        t = k * PERIOD
        read = max(t - rng.uniform(0.0, 0.002), 0.0)
        controller.measure(
            message(t, steer=steer, wheel=np.full(4, 0.3 * read / geometry.wheel_radius), arm=np.full(6, 0.5 * read))
        )
        controller.command(t, plans)
        base.append(controller.pose[0] - 0.3 * t)
        arm.append(controller.estimator.arm[0] - 0.5 * t)
    for off, speed in ((base, 0.3), (arm, 0.5)):
        assert np.std(off[100:]) < 0.3 * speed * 0.002 / np.sqrt(12.0)
        assert abs(np.mean(off[100:])) < 0.1 * speed * 0.001


def test_calibration_corrects_angles_and_wheel_speeds() -> None:
    """Zeros are taken off what the encoders say; a wheel of twice the radius turns half as fast for the same way."""
    geometry, rng = SWERVE.base.geometry, np.random.default_rng(5)
    leg_offset, steer_offset = rng.normal(size=(2, 4))
    known = WheelCalibration(
        steer_offset, leg_offset, geometry.wheel_radius * np.array([1.0, 2.0, 1.0, 0.5]), np.zeros((8, 8))
    )
    controller, plans = (
        SwerveController(SWERVE, np.zeros(3), PERIOD, estimation=EstimatorSettings(calibration=known)),
        PolicyQueue(),
    )
    controller.measure(message(leg=leg_offset + 0.1, steer=steer_offset + 0.2))
    state = SWERVE.state.split(controller.state())
    np.testing.assert_allclose(state["leg"], 0.1)
    np.testing.assert_allclose(state["steer"], 0.2)
    u = swerve_input(6)
    plans.add(0.0, constant_policy(u, steer=0.2))
    command = controller.command(0.0, plans)
    np.testing.assert_allclose(command.wheel, u[SWERVE.input["wheel"]] / [1.0, 2.0, 1.0, 0.5])
    np.testing.assert_allclose(command.steer, u[SWERVE.input["steer"]], atol=1e-12)


def test_global_poses_reach_the_odometry() -> None:
    controller, seen = SwerveController(SWERVE, np.zeros(3), PERIOD), np.array([0.002, -0.001, 0.003])
    controller.estimator.odometry._state.p[:3, :3] = np.eye(3)
    for k in range(5):
        place = GlobalPose(PERIOD, seen, 1e-8 * np.eye(3)) if k == 3 else None
        controller.measure(SwerveMeasurement(k * PERIOD, *np.zeros((3, 4)), np.zeros(6), place=place))
    np.testing.assert_allclose(controller.estimator.odometry.pose, seen, atol=1e-6)


def test_after_a_stop_commands_rise_as_accelerations_allow() -> None:
    """A plan runs out at speed, and another comes. Truth: from rest, by the limit times the period."""
    controller, plans = (
        SwerveController(HURRIED, np.zeros(3), PERIOD, tracking=TrackingSettings(lag=0.02)),
        PolicyQueue(),
    )
    u = np.zeros(HURRIED.input.size)
    u[HURRIED.input["wheel"]] = 4.0
    plans.add(0.0, constant_policy(u))
    controller.measure(message())
    for k in range(100):
        last = controller.command(k * PERIOD, plans).wheel
    assert last == pytest.approx(4.0)
    for _ in range(100):
        controller.stop()
    rise = HURRIED.limits.input_rate[HURRIED.input["wheel"]].min() * PERIOD
    assert controller.command(0.3, plans).wheel == pytest.approx(rise)
    assert controller.predict(0.3, 0.3, plans).x[HURRIED.state["wheel"]] == pytest.approx(0.02 * rise, abs=0.02 * rise)
