"""The base type ``differential``. Truth: MuJoCo's kinematics and rolling tires, and the textbook's v = r (ωr + ωl) / 2."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from effort import some
from planar_driving import HEIGHT, RADIUS, Constant, drive, follow_line, ideal_plant, kinematics_error, write_robot
from wbmpc import Observation, Reference, lie
from wbmpc.bases import base_type
from wbmpc.bases.planar_motion.controller import PlanarController
from wbmpc.bases.planar_motion.messages import PlanarMeasurement
from wbmpc.bases.planar_motion.odometry import GyroFilter, PlanarOdometry
from wbmpc.bases.planar_motion.wheel_errors import WheelErrors
from wbmpc.default_problem import default_mpc
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.simulation.any_perturbation import AnyPerturbation

ROBOT = load_robot("differential-ur10")
#: Of the built-in robot's file: half the distance of the wheels [m], how far they are behind the body's frame [m], radius [m].
HALF_TRACK, BEHIND, WHEEL = 0.29, 0.1, 0.1
LEFT, RIGHT = ((0.0, 0.2), (0.0, 1.0, 0.0)), ((0.0, -0.2), (0.0, 1.0, 0.0))
BASE: dict[str, Any] = {"type": "differential"}


def wheel_rates(v: float, w: float) -> np.ndarray:
    """Left and right [rad/s], as textbooks have them."""
    return np.array([v - HALF_TRACK * w, v + HALF_TRACK * w]) / WHEEL


def test_kinematics_are_those_of_the_file():
    assert kinematics_error(ROBOT) < 1e-9
    assert ROBOT.base.body_height == pytest.approx(0.15)


def test_the_wheel_matrix_is_the_textbooks():
    for v, w in ((0.3, 0.0), (0.0, 0.7), (-0.2, 0.4)):
        assert ROBOT.base.rates @ [v, w] == pytest.approx(wheel_rates(v, w))


def test_tires_drive_a_square_in_the_world():
    plant = ideal_plant(ROBOT)
    for _ in range(4):
        moved = drive(plant, wheel_rates(0.25, 0.0), 2.0)
        assert moved[0] == pytest.approx(0.5, rel=0.02) and np.abs(moved[1:]).max() < 0.02
        moved = drive(plant, wheel_rates(0.0, 0.25 * np.pi), 2.0)
        # the middle of the axle stays where it is, and the body's frame goes round it
        assert moved[2] == pytest.approx(0.5 * np.pi, rel=0.02)
        assert moved[1] == pytest.approx(BEHIND * moved[2], abs=0.015) and abs(moved[0]) < 0.015
    x, y, yaw = plant.truth().pose
    assert np.hypot(x, y) < 0.04 and yaw == pytest.approx(2.0 * np.pi, abs=0.06)
    assert plant.truth().tilt < 0.008


def test_wheels_carry_most_of_the_weight_on_every_seed():
    for seed in range(3):
        force = base_type("differential").plant(ROBOT, None, seed).truth().wheel_force
        assert force.min() > 100.0 and force.sum() > 0.5 * 968.0  # 98.7 kg in the file


def test_a_wheel_whose_axis_points_the_other_way_turns_the_other_way(tmp_path: Path):
    robot = load_robot(write_robot(tmp_path, [LEFT, ((0.0, -0.2), (0.0, -1.0, 0.0))], BASE))
    moved = drive(ideal_plant(robot), np.array([0.3, -0.3]) / RADIUS, 1.0)
    assert moved[0] == pytest.approx(0.3, rel=0.05) and np.abs(moved[1:]).max() < 0.02
    assert robot.base.rates @ [0.3, 0.0] == pytest.approx(np.array([0.3, -0.3]) / RADIUS)


@pytest.mark.parametrize("seed", some([0, 1], [0]))
def test_the_end_effector_follows_a_line_while_the_base_drives(seed: int):
    estimated, world, driven = follow_line("differential-ur10", seed)
    assert estimated < 5.0 and world < 20.0
    assert driven > 1.5


def test_limits_of_wheels_hold_over_the_whole_plan(tmp_path: Path):
    text = (Path(ROBOT.description.source).read_text()).replace("left_wheel: 10.0", "left_wheel: 3.0")
    (tmp_path / "slow.yaml").write_text(
        text.replace("model: differential-ur10.xml", f"model: {ROBOT.description.model}")
    )
    robot = load_robot(tmp_path / "slow.yaml")
    mpc = default_mpc(robot)
    position, orientation = robot.pose(robot.home)
    mpc.reference["end_effector"] = Reference.poses([0.0], [position + [4.0, 2.0, 0.0]], orientation)
    fastest = 0.0
    for k in range(10):
        policy = mpc.update(Observation(t=0.02 * k, x=robot.home))
        for t in 0.02 * k + np.arange(0.01, 3.9, 0.05):
            v, w = policy.feedforward(t)[:2]
            fastest = max(fastest, abs(v - HALF_TRACK * w) / WHEEL)
    # one real-time iteration meets the limit to a few tenths of a percent; base_linear alone would allow 8 rad/s
    assert 2.5 < fastest < 3.01


@pytest.mark.parametrize(
    ("wheels", "base", "options", "words"),
    [
        ([LEFT, RIGHT], {}, {"raised": 0.004}, ("base.wheels", "'w1' hangs 4 mm above")),
        ([LEFT, ((0.0, -0.2), (0.0, 1.0, 0.2))], {}, {}, ("base.wheels", "'w1' must be horizontal")),
        ([LEFT, ((0.1, -0.2), (0.0, 1.0, 0.0))], {}, {}, ("base.wheels", "share one axle")),
        ([LEFT, ((0.0, -0.2), (0.1, 1.0, 0.0))], {}, {}, ("base.wheels", "share one axle")),
        ([LEFT, LEFT], {}, {}, ("base.wheels", "rank 1, 2 is needed")),
        ([LEFT, RIGHT], {"wheel_radius": 0.1}, {}, ("base.wheel_radius", "0.08 m")),
        ([LEFT, RIGHT], {}, {"shape": "box"}, ("base.wheel_radius", "do not show one radius")),
        ([LEFT, RIGHT], {}, {"extra": ' range="-1 1"'}, ("base.wheels", "'w0' has a range")),
        ([LEFT, RIGHT], {"wheels": ["w0", "w0"]}, {}, ("wheels", "'w0' twice")),
        ([LEFT, RIGHT], {"wheels": ["w0", "w7"]}, {}, ("base.wheels", "w7")),
    ],
)  # fmt: skip
def test_what_is_no_differential_drive_is_named(tmp_path: Path, wheels: Any, base: Any, options: Any, words: Any):
    with pytest.raises(InputError) as error:
        load_robot(write_robot(tmp_path, wheels, {**BASE, **base}, **options))
    assert all(word in str(error.value) for word in ("robot.yaml", *words))


def test_the_radius_is_read_from_the_shapes(tmp_path: Path):
    robot = load_robot(write_robot(tmp_path, [LEFT, RIGHT], BASE))
    assert robot.base.geometry.radius == pytest.approx(RADIUS) and robot.base.body_height == pytest.approx(HEIGHT)


def test_a_perturbation_that_the_plant_does_not_read_is_an_error():
    with pytest.raises(InputError, match=r"plant\.steer_noise: .* does not read it; valid: "):
        base_type("differential").plant(ROBOT, AnyPerturbation(steer_noise=0.01), 0)


def test_what_the_plug_in_leaves_out_is_named_as_of_other_base_types():
    with pytest.raises(
        InputError, match=r"'differential-ur10' .* offers no calibration file of its wheels \('calibrator'\)"
    ):
        base_type("differential").calibrator(ROBOT)


# ---------------------------------------------------------------------- odometry and controller
def messages(
    v: float, w: float, seconds: float, slip: float, bias: float, rest: float
) -> list[tuple[float, np.ndarray, float]]:
    """(time, wheel angles, gyro) of a base that stands for ``rest`` [s] and then drives; wheels turn ``slip`` more than they roll."""
    h, wheel, found = 0.0025, np.zeros(2), []
    for k in range(round((rest + seconds) / h) + 1):
        moving = k * h > rest + 1e-9
        wheel = wheel + wheel_rates(v, w * (1.0 + slip)) * h * moving
        found.append((k * h, wheel, (w if moving else 0.0) + bias))
    return found


def test_the_gyro_gives_the_turn_once_its_bias_is_known():
    for rest, expected in ((1.0, 1.0), (0.0, 1.1)):  # without a rest the bias and the wheels' slip look alike
        odometry = PlanarOdometry(ROBOT.base.twist, ROBOT.base.rates, np.zeros(3))
        for time, wheel, gyro in messages(0.3, 0.5, 2.0, 0.1, 0.02, rest):
            odometry.update(time, wheel, gyro)
        assert odometry.pose[2] == pytest.approx(expected, abs=0.003)


def test_a_base_that_never_stands_still_learns_the_gyros_bias_from_its_speeds():
    """One wheel is 0.2 % larger than the model's, as nobody knows: a bias turns with the time, radii with the distance."""
    rng, h, wheel, odometry = (
        np.random.default_rng(0),
        0.0025,
        np.zeros(2),
        PlanarOdometry(ROBOT.base.twist, ROBOT.base.rates, np.zeros(3)),
    )
    true = 0.0
    for k in range(round(20.0 / h)):
        t = k * h
        v, w = 0.1 + 0.1 * np.sin(0.5 * t), 0.2 * np.sin(0.7 * t)
        true += w * h
        wheel = wheel + wheel_rates(v, w) * [1.0, 0.998] * h
        odometry.update(t, wheel, w + 0.01 + 3e-4 / np.sqrt(h) * rng.normal())
    assert odometry.gyro.bias == pytest.approx(0.01, abs=3e-4)
    assert odometry.pose[2] == pytest.approx(true, abs=0.006)


def test_a_bias_that_is_found_late_turns_the_way_back():
    """Wheels that are known: their turn is the truth, and what bias and noise of the gyro did to the pose before comes off again."""
    known = WheelErrors(np.zeros(2), np.zeros(2), 1e-10 * np.eye(4))
    rng, h, wheel, true = np.random.default_rng(3), 0.0025, np.zeros(2), np.zeros(3)
    odometry = PlanarOdometry(ROBOT.base.twist, ROBOT.base.rates, np.zeros(3), known)
    without = GyroFilter(known.of_turn(2))  # the same bias, whose errors stay in the yaw
    turned, late = 0.0, 0.0
    for k in range(round(30.0 / h)):
        v, w = (0.2, 0.25) if k * h > 0.3 else (0.0, 0.0)
        true, wheel = lie.se2_step(true, ROBOT.base.twist @ [v, w] * h), wheel + wheel_rates(v, w) * h
        gyro = w + 0.01 + 6e-4 / np.sqrt(h) * rng.normal()
        odometry.update(k * h, wheel, gyro)
        share = 0.5 * w * h * np.ones(2)
        without.update(h, gyro, share, np.ones(2), True, np.zeros(2))
        turned += (gyro - without.bias) * h if without.std < 1e-3 else w * h
        late = max(late, abs(turned - true[2]))
    assert late > 2e-3
    assert abs(odometry.pose[2] - true[2]) < 0.25 * late, (odometry.pose[2] - true[2], late)
    np.testing.assert_allclose(odometry.pose[:2], true[:2], atol=2e-3)


def test_a_number_that_is_not_finite_is_not_taken_in():
    odometry = PlanarOdometry(ROBOT.base.twist, ROBOT.base.rates, np.zeros(3))
    odometry.update(0.0, [0.0, 0.0], 0.0)
    for wheel, gyro in (([np.nan, 0.0], 0.0), ([0.1, 0.1], np.inf)):
        with pytest.raises(InputError):
            odometry.update(0.1, wheel, gyro)
    assert odometry.update(0.1, [1.0, 1.0], None) == pytest.approx([WHEEL, 0.0, 0.0])


def driven(u: list[float], ticks: int, lag: float = 0.0, arm: float = 0.0) -> tuple[PlanarController, PolicyQueue, Any]:
    """A controller that has sent ``ticks`` commands of a plan that asks for (v, wz) = u from standstill, and for the rate ``arm`` of all
    joints."""
    controller, plans = PlanarController(ROBOT, np.zeros(3), 0.0025, lag), PolicyQueue()
    plans.add(0.0, Constant(np.array([*u, *[arm] * 6])))  # type: ignore[arg-type]
    controller.measure(PlanarMeasurement(0.0, np.zeros(2), ROBOT.home[3:]))
    command = None
    for k in range(ticks):
        command = controller.command(0.0025 * k, plans)
    return controller, plans, command


def test_wheels_too_fast_are_slowed_down_together():
    controller, _, command = driven([1.2, 0.5], 400)
    assert controller.clamped and np.abs(command.wheel).max() == pytest.approx(10.0)
    assert command.wheel / command.wheel[1] == pytest.approx(wheel_rates(1.2, 0.5) / wheel_rates(1.2, 0.5)[1])


def test_wheels_on_their_way_to_their_limits_are_not_counted_as_slowed_down() -> None:
    """Wheels are at their 10 rad/s after 200 ticks at 20 rad/s². Until then a plan beyond that has what it asks for as fast as it comes."""
    for ticks in (1, 100, 199, 202):
        controller, _, command = driven([1.2, 0.5], ticks)
        assert controller.clamped == (ticks > 200) == bool(np.abs(command.wheel).max() > 9.99), ticks


def test_a_base_that_is_asked_for_too_much_does_not_hold_the_arm_back():
    """Wheels are at their 10 rad/s after 0.5 s at 20 rad/s². What the plan asks for beyond that never comes; the arm has its rate."""
    _, _, command = driven([1.2, 0.5], 210, arm=0.5)
    assert np.abs(command.wheel).max() == pytest.approx(10.0)
    assert command.arm == pytest.approx(0.5)


def test_commands_start_as_fast_as_wheels_may_accelerate_and_prediction_knows_it():
    controller, plans, command = driven([0.5, 0.0], 10)
    assert command.wheel == pytest.approx([20.0 * 10 * 0.0025] * 2)  # 20 rad/s² in the file
    x = controller.predict(0.025, 0.035, plans).x
    v = 0.1 * 20.0 * 0.0025 * np.arange(11, 15)
    assert x[0] == pytest.approx(0.0025 * v.sum()) and x[1:3] == pytest.approx(0.0)


def test_prediction_adds_what_lagging_drives_owe():
    controller, plans, _ = driven([0.2, 0.0], 400, lag=0.02)  # long at 0.2 m/s
    assert controller.predict(1.0, 1.0, plans).x[0] == pytest.approx(0.2 * 0.02, rel=1e-3)


def test_the_robot_stops_when_the_plan_has_run_out():
    controller, plans, _ = driven([0.3, 0.0], 100)
    command = controller.command(1.01, plans)
    assert not command.wheel.any() and not command.arm.any() and not controller.sent.any()


@pytest.mark.parametrize("rest", [5.0, 0.0])
def test_wheels_that_turn_a_base_which_is_held_do_not_turn_its_odometry(rest: float) -> None:
    """On blocks, wheels of a turn at 0.5 rad/s. Truth: it stands. A bias that is not known yet, 10 mrad/s, turns it for as long."""
    odometry = PlanarOdometry(ROBOT.base.twist, ROBOT.base.rates, np.zeros(3))
    for k in range(round((rest + 5.0) / 0.0025)):
        t = 0.0025 * k
        odometry.update(t, wheel_rates(0.0, 0.5) * max(t - rest, 0.0), 0.01)
    assert abs(odometry.pose[2]) < (5e-3 if rest else 0.2)
    assert not rest or abs(odometry.gyro.bias - 0.01) < 1e-3
