"""Feed-forward and PD in actuator coordinates. Truth: the differential equation of the wheels' error solved by hand, MuJoCo's
joints."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from toys import robot
from wbmpc.bases.ball.messages import BallCommand, BallMeasurement
from wbmpc.bases.ball.perturbation import BallPerturbation
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.errors import InputError
from wbmpc.mpc.policy import Policy
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.registry import REGISTRY
from wbmpc.studies.minniti2019.controller_settings import WholeBodyMpc
from wbmpc.studies.minniti2019.push_settings import RezeroPushHandSettings
from wbmpc.studies.minniti2019.servo_plant import ServoPlant
from wbmpc.studies.minniti2019.tracking_control import ActuatorGains, ServoCommand, TrackingController

BALL = robot("rezero")
N, PERIOD = BALL.base.nq, 0.0025
ROLLING = np.zeros(2 * N)
ROLLING[N] = 0.5  # along x at 0.5 m/s: the wheels' speeds are constant


def followed(bleed: float, factor: float, seconds: float) -> tuple[TrackingController, np.ndarray]:
    """Wheel errors (n, 3) [rad] while a plan rolls along x and the true wheels turn ``factor`` times as fast."""
    still = SimpleNamespace(solver=SimpleNamespace(simulate=lambda x, u, h: x, set_parameters=lambda w: None))
    gains = ActuatorGains(leak_time_constant=bleed)
    controller = TrackingController(BALL, still, np.zeros(6), PERIOD, DriveSettings(), False, gains=gains)  # type: ignore[arg-type]
    times, plans = np.array([0.0, 100.0]), PolicyQueue()
    plans.add(0.0, Policy(times, np.stack([ROLLING, ROLLING]), np.zeros((1, 6)), np.zeros((1, 6, 2 * N))))
    speed, errors = controller.speeds(ROLLING)[:3], []
    for k in range(round(seconds / PERIOD)):
        wheel = factor * speed * k * PERIOD
        controller.measure(BallMeasurement(k * PERIOD, ROLLING, 0.0, wheel, np.zeros(3)))
        controller.command(k * PERIOD, plans)
        errors.append(controller.wheel_error)
    return controller, np.array(errors)


@pytest.mark.parametrize("bleed", [0.25, 1.0])
def test_bleeding_bounds_the_drift_of_the_wheels(bleed: float) -> None:
    """Radii that are 2 % wrong: ė = Δ − e / bleed, e = bleed Δ (1 − exp(−t / bleed)), below bleed times the speed's error."""
    controller, errors = followed(bleed, 0.98, 6.0)
    wrong = 0.02 * controller.speeds(ROLLING)[:3]
    assert np.abs(wrong).max() > 0.05
    t = PERIOD * np.arange(len(errors))[:, None]
    np.testing.assert_allclose(
        errors, bleed * wrong * (1.0 - np.exp(-t / bleed)), atol=0.01 * bleed * np.abs(wrong).max()
    )
    assert np.all(np.abs(errors) <= bleed * np.abs(wrong) * (1.0 + 1e-9))


def test_plain_integration_drifts_without_bound() -> None:
    controller, errors = followed(np.inf, 0.98, 6.0)
    wrong = 0.02 * controller.speeds(ROLLING)[:3]
    np.testing.assert_allclose(errors[-1], wrong * (6.0 - PERIOD), rtol=1e-6, atol=1e-9)


def test_speeds_are_those_of_the_wheels_on_a_rolling_ball() -> None:
    """By hand: ψ̇ = −(r / r_w) aᵀ Ω with Ω = (0, ẋ / r, 0) for an upright base."""
    azimuth, zenith = np.array([0.0, 2.0, 4.0]) * np.pi / 3.0, np.pi / 4.0
    along_y = np.cos(zenith) * np.sin(azimuth)
    controller, _ = followed(1.0, 1.0, PERIOD)
    np.testing.assert_allclose(controller.speeds(ROLLING)[:3], -0.5 / 0.064 * along_y, atol=1e-12)


def test_bad_gains_are_named() -> None:
    with pytest.raises(InputError, match="leak_time_constant must be positive"):
        ActuatorGains(leak_time_constant=0.0)
    with pytest.raises(InputError, match="arm_damping must be at least 0"):
        ActuatorGains(arm_damping=-1.0)


def test_drives_close_the_loop_between_commands() -> None:
    """One command, held: the drives pull the elbow to where it says, against MuJoCo's gravity fed forward."""
    home, torque = BALL.base.numeric.equilibrium(BALL.home[5:N])
    still = BallPerturbation(
        mass=0.0, inertia=0.0, com_offset=0.0, joint_offset=0.0, actuator_time_constant=0.002, actuator_time_constant_spread=0.0
    )  # fmt: skip
    plant = ServoPlant(BALL.description, home, torque, still, 0)
    now = np.concatenate([np.zeros(3), home[5:N]])
    target = now + [0.0, 0.0, 0.0, 0.0, 0.0, 0.05]
    stiffness, damping = np.array([0.0] * 3 + [40.0] * 3), np.array([0.0] * 3 + [2.0] * 3)
    plant.step(ServoCommand(torque, target, np.zeros(6), stiffness, damping), 300)
    moved = plant.state()[5:N] - home[5:N]
    assert moved[2] == pytest.approx(0.05, abs=0.01)  # gravity's torque changes a little on the way
    assert np.abs(moved[:2]).max() < 0.01
    plant = ServoPlant(BALL.description, home, torque, still, 0)
    plant.step(BallCommand(torque), 300)
    assert np.abs(plant.state()[5:N] - home[5:N]).max() < 0.01


def test_a_push_with_the_papers_tracking() -> None:
    tracking = {"kind": "actuators"}
    settings = RezeroPushHandSettings(
        forces=(30.0,), settle_time=0.5, pause=2.0, controller=WholeBodyMpc(tracking=tracking)
    )
    result = REGISTRY["rezero-push-hand"].run(settings, 0, None)
    assert result.completed, result.reason
    assert 0.01 < result.metrics["hand_error_max"].value < 0.3
    feedback = result.log.array("feedback")
    assert np.abs(feedback[:, 4]).max() > 0.01
