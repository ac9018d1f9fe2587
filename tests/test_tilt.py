"""Bases that lean on soft casters. Truth: kinematics of a rotation, gravity and rates of a body that turns, MuJoCo's
simulated robot."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from wbmpc import lie
from wbmpc.bases.planar_motion.controller import PlanarController
from wbmpc.bases.planar_motion.messages import PlanarMeasurement
from wbmpc.bases.planar_motion.model import planar_base
from wbmpc.bases.planar_motion.tilt import LevelArm, TiltFilter
from wbmpc.model.robot import RobotModel, load_robot

GRAVITY = 9.81


def rotation(lean: np.ndarray) -> np.ndarray:
    size = float(np.linalg.norm(lean))
    return np.asarray(lie.quaternion_to_rotation(lie.quaternion_about(lean / size, size)))


@pytest.mark.parametrize("mount", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.1)])
def test_the_lean_and_the_gyros_biases_are_found_while_the_base_drives(mount: tuple[float, float, float]) -> None:
    """A base that leans by 8 and -5 mrad turns about the vertical and goes faster and slower, with the inertial unit beside its middle."""
    rng, h, tilt, lean = np.random.default_rng(0), 0.0025, TiltFilter(mount), np.array([0.008, -0.005, 0.0])
    up = rotation(lean).T @ [0.0, 0.0, 1.0]
    bias = np.array([0.008, -0.006, 0.0])
    for k in range(round(30.0 / h)):
        v = 0.2 * np.sin(0.5 * k * h)
        turning, change = 0.5 + 0.5 * np.cos(k * h), -0.5 * np.sin(k * h)
        about, place = turning * np.array([0.0, 0.0, 1.0]), np.array(mount)
        own = np.array([0.1 * np.cos(0.5 * k * h), turning * v, 0.0])
        own += np.cross([0.0, 0.0, change], place) + np.cross(about, np.cross(about, place))
        gyro = turning * up + bias + 2e-4 / np.sqrt(h) * rng.normal(size=3)
        accel = GRAVITY * up + own + 1e-3 / np.sqrt(h) * rng.normal(size=3)
        tilt.update(h, gyro, accel, [v, 0.0, turning])
    np.testing.assert_allclose(tilt.turned, lean, atol=5e-4)


def test_what_drives_make_of_the_commands_beside_them_is_no_lean() -> None:
    """A level base that begins to turn at once reaches only nine tenths of its centripetal acceleration, 0.3 m/s² by the commands, for
    a second: 3 mrad. Truth: the accelerometer of a level base, and a gyro's bias, which is found while it drives on and stands."""
    tilt, h, off = TiltFilter(), 0.0025, []
    for k in range(round(10.0 / h)):
        v, turning = (0.3, 1.0) if k * h < 1.0 else (0.0, 0.0)
        tilt.update(h, [0.01, 0.0, turning], [0.0, 0.9 * v * turning, GRAVITY], [v, 0.0, turning])
        off.append(np.abs(tilt.up).max())
    assert max(off[round(3.0 / h) :]) < 1e-3


def test_a_lean_that_goes_on_turning_is_followed_by_the_gyro() -> None:
    """10 mrad within 0.2 s, while the base is pushed at 0.1 m/s² that no wheel shows."""
    tilt, h = TiltFilter(), 0.0025
    for _ in range(round(40.0 / h)):
        tilt.update(h, np.zeros(3), [0.0, 0.0, GRAVITY], np.zeros(3))
    for _ in range(round(0.2 / h)):
        tilt.update(h, [0.0, 0.05, 0.0], [0.1, 0.0, GRAVITY], np.zeros(3))
    assert tilt.up[0] == pytest.approx(-0.010, abs=2e-3)


@pytest.mark.parametrize("name", ["fetch", "differential-ur10"])
def test_a_level_base_with_that_arm_has_its_end_effector_where_a_tilted_one_has_it(name: str) -> None:
    robot, lean = load_robot(name), np.array([0.004, -0.006, 0.0])
    x = robot.home.copy()
    x[:3] = [1.0, -0.5, 0.8]
    about_z = rotation(np.array([0.0, 0.0, 0.8]))
    position = robot.pose(x)[0]
    floor = np.array([1.0, -0.5, 0.0])
    tilted = floor + about_z @ rotation(lean) @ about_z.T @ (position - floor)
    np.testing.assert_allclose(robot.pose(LevelArm(robot)(x, lean))[0], tilted, atol=2.5e-4)
    assert np.linalg.norm(tilted - position) > 3e-3


def test_the_frame_of_a_tilted_base_turns_about_its_axle() -> None:
    """Hubs stay a radius above the floor, so the frame under them swings ahead or back by its sine; half a turn doubles that."""
    robot, h = load_robot("differential-ur10"), 0.01
    base, poses = planar_base(robot), []
    for lean in (np.array([0.0, 1e-9, 0.0]), np.array([0.0, 0.03, 0.0])):
        up = rotation(lean).T @ [0.0, 0.0, 1.0]
        controller, wheel = PlanarController(robot, np.zeros(3), h), np.zeros(2)
        for k in range(2000):
            turn = np.pi / 10.0 if k >= 1000 else 0.0
            wheel = wheel + base.rates @ [0.0, turn] * h
            accel, gyro = GRAVITY * up, turn * up
            controller.measure(PlanarMeasurement(k * h, wheel, robot.home[3:], gyro=gyro, accel=accel))
        poses.append(controller.pose)
    swung = (rotation(lean) @ [0.0, 0.0, -base.geometry.radius])[0]
    assert abs(swung) > 2e-3
    np.testing.assert_allclose((poses[1] - poses[0])[:2], [-2.0 * swung, 0.0], atol=5e-4)


def test_the_base_makes_up_for_a_lean_where_the_arm_cannot(tmp_path: Path) -> None:
    """An arm that goes up and out to the left, on a base that leans forward: its end effector is ahead by height times angle."""
    wheels = "".join(
        f'<body name="{n}" pos="0 {y} 0.1"><inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/><joint name="{n}" axis="0 1 0"/></body>'
        for n, y in (("l", 0.3), ("r", -0.3))
    )
    (tmp_path / "robot.xml").write_text(
        f"""<mujoco><compiler autolimits="true"/><worldbody><body name="base"><freejoint/><inertial pos="0 0 0" mass="20"
        diaginertia="1 1 1"/>{wheels}<body name="lift" pos="0.1 0 0.9"><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
        <joint name="up" type="slide" axis="0 0 1" range="0 1"/><body name="out"><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
        <joint name="out" type="slide" axis="0 1 0" range="0 1"/><site name="tool" pos="0 0.4 0"/></body></body></body></worldbody></mujoco>"""
    )
    (tmp_path / "robot.yaml").write_text(
        "name: lifter\nmodel: robot.xml\nbase: {type: differential, body: base, wheels: [l, r], wheel_radius: 0.1}\n"
        "arm: {joints: [up, out], tool: tool}\nlimits: {velocity: {l: 10, r: 10, up: 1, out: 1}}\n"
    )
    robot, lean = load_robot(tmp_path / "robot.yaml"), np.array([0.0, 0.02, 0.0])
    at = robot.pose(robot.home)[0]
    tilted = rotation(lean) @ at
    assert tilted[0] - at[0] == pytest.approx(0.02 * 0.9, rel=0.02)
    np.testing.assert_allclose(robot.pose(LevelArm(robot)(robot.home, lean))[0], tilted, atol=4e-4)


def test_the_simulated_inertial_unit_is_where_the_file_has_it(tmp_path: Path) -> None:
    """Truth: centripetal acceleration of a base that turns in place, ω² r towards its middle, with a link "imu" that has other axes."""
    from wbmpc.bases import base_type
    from wbmpc.bases.planar_motion.messages import PlanarCommand
    from wbmpc.bases.planar_motion.model import planar_base
    from wbmpc.simulation.any_perturbation import AnyPerturbation

    source = load_robot("mecanum-ur10").description
    body, spec = source.base.body, mujoco.MjSpec.from_file(str(source.model))
    spec.body(body).add_body(name="imu", pos=[0.2, -0.1, 0.0], quat=[0.7071, 0.0, 0.0, 0.7071])
    (tmp_path / "robot.xml").write_text(spec.to_xml())
    robot = RobotModel(source.model_copy(update={"model": tmp_path / "robot.xml"}))
    assert robot.inertial_unit == pytest.approx([0.2, -0.1, 0.0])
    plant = base_type("omnidirectional").plant(robot, AnyPerturbation.none(), 0)
    command, seen = PlanarCommand(planar_base(robot).rates @ [0.0, 0.0, 0.5], np.zeros(6)), []
    for k in range(300):
        plant.step(command, round(0.01 / plant.timestep))
        seen += [plant.measure()] if k >= 150 else []
    rate = np.mean([m.gyro[2] for m in seen])
    assert rate == pytest.approx(0.5, rel=0.1)
    assert np.mean([m.accel[:2] for m in seen], axis=0) == pytest.approx([-(rate**2) * 0.2, rate**2 * 0.1], abs=0.01)


def test_a_simulated_robot_on_soft_casters_knows_its_lean_and_one_on_rigid_wheels_needs_none() -> None:
    from wbmpc.bases import base_type
    from wbmpc.bases.planar_motion.controller import PlanarController
    from wbmpc.simulation.any_perturbation import AnyPerturbation

    robot = load_robot("fetch")
    kind = base_type("differential")
    plant = kind.plant(robot, AnyPerturbation(accel_bias=0.0), 3)
    controller = PlanarController(robot, plant.truth().pose, 0.0025, lag=0.02)
    for _ in range(round(4.0 / 0.0025)):
        controller.measure(plant.measure())
        plant.step(controller.stop(), round(0.0025 / plant.timestep))
    truth, base = plant.truth(), controller.base_pose()
    assert truth.tilt > 1e-3
    seen = base[:3] + lie.quaternion_to_rotation(base[3:]) @ truth.tool_in_base
    level = (
        np.array([*truth.pose[:2], 0.0]) + rotation(np.array([0.0, 0.0, truth.pose[2] or 1e-12])) @ truth.tool_in_base
    )
    assert np.linalg.norm((seen - truth.tool)[:2]) < 0.5 * np.linalg.norm((level - truth.tool)[:2])
    rigid = load_robot("mecanum-ur10")
    assert PlanarController(rigid, np.zeros(3), 0.0025).tilt is None
