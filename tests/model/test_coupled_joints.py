"""Joints that move together (``couple``). Truth: MuJoCo's kinematics of the same file, every joint placed by hand; ranges and speeds of
the file written here."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import wbmpc as wb
from wbmpc.bases.fixed.plant import FixedPlant
from wbmpc.cli import main
from wbmpc.control.direct import InputCommand
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.robots.doctor import examine_robot
from wbmpc.simulation.any_perturbation import AnyPerturbation

INERTIAL = '<inertial><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>'


def link(name: str) -> str:
    return f'<link name="{name}">{INERTIAL}</link>'


def joint(
    name: str, parent: str, child: str, at: str, axis: str, limit: str, kind: str = "prismatic", more: str = ""
) -> str:
    return (
        f'{link(child)}<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{at}" rpy="0.1 0.2 0"/>'
        f'<axis xyz="{axis}"/><limit {limit} effort="200"/>{more}</joint>'
    )


def write(folder: Path, couple: str = "", mimic: bool = False) -> Path:
    """A column of three stages, of which the second rises half as far as the first and the third as far, and a wrist."""
    second, third = (
        ('<mimic joint="one" multiplier="0.5" offset="0.02"/>', '<mimic joint="one"/>') if mimic else ("", "")
    )
    (folder / "column.urdf").write_text(
        f'<robot name="column">{link("foot")}'
        + joint("one", "foot", "stage_1", "0 0 0.3", "0 0 1", 'lower="0" upper="0.4" velocity="0.2"')
        + joint(
            "two", "stage_1", "stage_2", "0 0.05 0.3", "0 0 1", 'lower="0" upper="0.17" velocity="0.05"', more=second
        )
        + joint("three", "stage_2", "stage_3", "0 0 0.3", "1 0 0", 'lower="-1" upper="1" velocity="1"', more=third)
        + joint("pitch", "stage_3", "upper", "0 0 0.1", "0 1 0", 'lower="-2" upper="2" velocity="1"', "revolute")
        + joint("wrist", "upper", "tool", "0.4 0 0.1", "0 0 1", 'lower="-2" upper="2" velocity="1"', "revolute")
        + "</robot>"
    )
    path = folder / "column.yaml"
    path.write_text(
        "name: column\nmodel: column.urdf\nbase: {type: fixed, body: foot}\narm: {joints: [one, pitch, wrist], tool: tool}\n"
        f"home: {{one: 0.1, pitch: 0.4, wrist: 0.5}}\nlimits: {{acceleration: {{one: 1, pitch: 3, wrist: 3}}}}\n{couple}\n"
    )
    return path


COUPLE = "couple: {two: {joint: one, ratio: 0.5, offset: 0.02}, three: one}"


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    return load_robot(write(tmp_path_factory.mktemp("column"), COUPLE))


def placed(robot: RobotModel, x: np.ndarray) -> np.ndarray:
    """Where MuJoCo has the tool when every joint is placed."""
    model = mujoco.MjModel.from_xml_path(str(robot.description.model))
    data = mujoco.MjData(model)
    values = {"one": x[0], "two": 0.5 * x[0] + 0.02, "three": x[0], "pitch": x[1], "wrist": x[2]}
    for name, value in values.items():
        data.joint(name).qpos[0] = value
    mujoco.mj_kinematics(model, data)
    return np.array(data.body("tool").xpos)


def test_poses_and_speeds_are_those_of_all_joints(robot: RobotModel) -> None:
    import casadi as ca

    assert robot.state.size == robot.input.size == 3
    x, u = ca.SX.sym("x", 3), ca.SX.sym("u", 3)
    speed = ca.Function("v", [x, u], [robot.frame_velocity(x, u, "tool")[0]])
    for seed in range(3):
        rng = np.random.default_rng(seed)
        q, v = rng.uniform(0.0, 0.3, 3), rng.normal(size=3)
        np.testing.assert_allclose(robot.pose(q)[0], placed(robot, q), atol=1e-9)
        slope = (placed(robot, q + 1e-5 * v) - placed(robot, q - 1e-5 * v)) / 2e-5
        np.testing.assert_allclose(np.array(speed(q, v))[:, 0], slope, atol=1e-6)


def test_a_leader_does_what_its_followers_can(robot: RobotModel) -> None:
    """The second stage ends at 0.17 = 0.5 · 0.3 + 0.02 and begins at 0 > 0.02 − 0.5 · 0.04; its 0.05 m/s are 0.1 of the first."""
    np.testing.assert_allclose([robot.limits.state_lower[0], robot.limits.state_upper[0]], [0.0, 0.3], atol=1e-9)
    assert robot.limits.input_upper[0] == pytest.approx(0.1)


def test_the_simulated_stages_move_together(robot: RobotModel) -> None:
    plant = FixedPlant(robot, AnyPerturbation.none())
    joint = lambda name: float(plant.data.joint(name).qpos[0])
    start = joint("one")
    assert joint("two") == pytest.approx(0.5 * start + 0.02, abs=1e-4)
    plant.step(InputCommand(np.array([0.1, 0.0, 0.0]), np.zeros(1)), 250)
    assert joint("one") - start > 0.3 * 0.1 * 250 * plant.timestep
    assert joint("two") == pytest.approx(0.5 * joint("one") + 0.02, abs=5e-4)
    assert joint("three") == pytest.approx(joint("one"), abs=5e-4)
    assert plant.truth().tool[2] == pytest.approx(placed(robot, plant.truth().state)[2], abs=1e-3)


@pytest.mark.parametrize(
    ("couple", "words"),
    [
        ("couple: {two: wrong, three: one}", ("couple.two", "wrong", "one, pitch, wrist")),
        ("couple: {two: one, three: one, wrist: one}", ("couple.wrist", "arm.joints")),
        ("couple: {two: {joint: one, ratio: 0}, three: one}", ("couple.two.ratio", "fixed_joints")),
        ("couple: {two: {joint: one, offset: 5}, three: one}", ("couple.two", "do not overlap")),
        ("couple: {two: one, four: one}", ("couple", "four")),
        ("couple: {two: one}", ("'three'",)),
    ],
)
def test_a_wrong_coupling_is_named(couple: str, words: tuple[str, ...], tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        load_robot(write(tmp_path, couple))
    assert all(word in str(error.value) for word in ("column.yaml", *words)), str(error.value)


def test_what_a_model_couples_is_proposed(tmp_path: Path) -> None:
    """As its mimic elements say, and the doctor has nothing against it; without the key it says what to write."""
    path = write(tmp_path, mimic=True)
    found = [f for f in examine_robot(str(path)).findings if f.check == "mimic"]
    assert found and "couple" in found[0].fix
    out = tmp_path / "new.yaml"
    assert main(["new", str(tmp_path / "column.urdf"), "--yes", "--out", str(out)]) == 0
    made = wb.load_robot(out)
    couple = made.description.couple
    assert (couple["two"].joint, couple["two"].ratio, couple["two"].offset) == ("one", 0.5, 0.02)
    assert (couple["three"].joint, couple["three"].ratio) == ("one", 1.0) and not made.description.fixed_joints
    assert not [f for f in examine_robot(str(out)).findings if f.severity == "error"]
    np.testing.assert_allclose(made.pose(made.home)[0], placed(made, made.home), atol=1e-9)
