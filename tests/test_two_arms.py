"""Several arms on a torso that slides, and what their end effectors hold together. Truth: MuJoCo's kinematics of the file."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import wbmpc as wb
from wbmpc import lie
from wbmpc.robots import load_spec

YAML = """
name: twins
model: robot.xml
base: {type: fixed, body: column}
torso: [lift]
arms:
  left: {joints: [l1, l2, l3], tool: l_tip}
  right: {joints: [r1, r2, r3], tool: r_tip}
home: {lift: 0.2, l1: 0.9, l2: -1.8, l3: 0.9, r1: -0.9, r2: 1.8, r3: -0.9}
limits:
  velocity: {lift: 0.3, l1: 2, l2: 2, l3: 2, r1: 2, r2: 2, r3: 2}
"""


def arm(side: str, y: float) -> str:
    """Three vertical axes: position in the plane and yaw."""
    inertial, links = '<inertial pos="0.1 0 0" mass="0.5" diaginertia="0.002 0.002 0.002"/>', ""
    for k, x in enumerate((0.0, 0.3, 0.3), start=1):
        at = f"{x} {y if k == 1 else 0} 0"
        links += f'<body name="{side}{k}" pos="{at}">{inertial}<joint name="{side}{k}" axis="0 0 1" range="-2.5 2.5"/>'
    return links + f'<site name="{side}_tip" pos="0.2 0 0"/></body></body></body>'


@pytest.fixture
def twins(tmp_path: Path) -> Path:
    (tmp_path / "robot.xml").write_text(f"""<mujoco><compiler angle="radian"/><worldbody><body name="column">
      <inertial pos="0 0 0" mass="20" diaginertia="1 1 1"/><body name="carriage"><inertial pos="0 0 0" mass="5" diaginertia="0.1 0.1 0.1"/>
      <joint name="lift" type="slide" axis="0 0 1" range="0 0.5"/>{arm("l", 0.25)}{arm("r", -0.25)}</body></body></worldbody></mujoco>""")
    (tmp_path / "robot.yaml").write_text(YAML)
    return tmp_path / "robot.yaml"


def relative(robot: wb.RobotModel, x: np.ndarray) -> np.ndarray:
    """Pose (7) of the right tip in the left one's axes, by MuJoCo."""
    model = load_spec(robot.description).compile()
    data = mujoco.MjData(model)
    for name, value in zip(robot.state.groups["arm"], x, strict=True):
        data.joint(name).qpos[0] = value
    mujoco.mj_kinematics(model, data)
    poses = []
    for tip in ("l_tip", "r_tip"):
        site = data.site(tip)
        poses.append(np.concatenate([site.xpos, lie.rotation_to_quaternion(site.xmat.reshape(3, 3))]))
    return lie.pose_compose(lie.pose_inverse(poses[0]), poses[1])


def test_arms_and_torso_are_one_arm_with_two_tools(twins: Path) -> None:
    robot = wb.load_robot(twins)
    assert robot.state.groups == {"arm": ("lift", "l1", "l2", "l3", "r1", "r2", "r3")}
    assert robot.tool == "l_tip" and robot.tools == {"left": "l_tip", "right": "r_tip"}
    assert robot.limits.state_upper[0] == 0.5 and robot.limits.input_upper[0] == 0.3
    np.testing.assert_allclose(robot.pose(robot.home)[0][2], 0.2)


def test_the_residual_is_the_pose_of_one_tip_in_the_other(twins: Path) -> None:
    robot = wb.load_robot(twins)
    rng = np.random.default_rng(0)
    for _ in range(3):
        x, goal = rng.uniform(-0.5, 0.5, 7), relative(robot, rng.uniform(-0.5, 0.5, 7))
        ocp = wb.OptimalControlProblem(robot.dynamics(), 0.1, 1)
        ocp.add(wb.Cost("grasp", wb.residuals.RelativePose(robot, "l_tip", "r_tip"), 2.0))
        ocp.add(wb.Cost("input", wb.residuals.Input(robot, reference=None), 1.0))
        solver = wb.Solver(ocp, wb.SQP(backend="interpreted", iterations=1))
        solver.set_reference("grasp", wb.Reference.poses([0.0], goal[:3], goal[3:]))
        solver.warm_start(x, np.zeros(7))
        found, target = relative(robot, x), goal
        turn = lie.quaternion_log(lie.quaternion_multiply(found[3:], lie.quaternion_conjugate(target[3:])))
        error = np.concatenate([found[:3] - target[:3], np.asarray(turn).ravel()])
        assert solver.solve(x).log[0, 0] == pytest.approx(0.1 * float(error @ error), rel=1e-6)


def test_two_tips_hold_one_thing(twins: Path) -> None:
    """The left one moves, the right one goes along: as an equality of velocities, to 0.05 mm."""
    robot = wb.load_robot(twins)
    ocp = wb.OptimalControlProblem(robot.dynamics(), horizon=1.0, intervals=20, first_interval=0.02)
    ocp.add(wb.Cost("end_effector", wb.residuals.FramePose(robot, robot.tool), [1000.0] * 3 + [0.0] * 3))
    ocp.add(wb.Cost("speed", wb.residuals.Input(robot, reference=None), 0.01))
    # vertical axes leave tilts alone: three of the rows are about them
    grasp = wb.residuals.RelativeMotion(robot, "l_tip", "r_tip")
    rows = wb.residuals.Expression(3, lambda s: grasp(s)[[0, 1, 5]], 7)
    ocp.add(wb.Constraint("grasp", rows, softness=1e-6))
    mpc, start = wb.MPC(ocp, rate=50.0), relative(robot, robot.home)
    mpc.reference["grasp"] = wb.Reference.constant(start)
    position, turn = robot.pose(robot.home)
    times = np.linspace(0.0, 1.0, 51)
    way = position + np.outer(0.03 * (1.0 - np.cos(np.pi * times)), [1.0, 0.5, 0.5])
    mpc.reference["end_effector"] = wb.Reference.poses(times, way, turn)
    result = wb.simulate(robot, mpc, 1.0, plant="kinematic", settle_time=0)
    assert result.completed and result.metrics["end_effector_error_max"].value < 2e-3
    states = result.log.array("state")
    assert np.abs(states - states[0]).max() > 0.05
    for x in states[::10]:
        assert np.linalg.norm(relative(robot, x)[:3] - start[:3]) < 5e-5


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("arms:", "arm: {joints: [l1], tool: l_tip}\narms:"), "with several arms there is no key 'arm'"),
        (("tool: r_tip", "tool: r_top"), r"frame \(key 'arms\.right\.tool'\).*r_top.*r_tip"),
        (("[r1, r2, r3]", "[l1, r2, r3]"), "every joint once, got 'l1' twice"),
        (
            ("tool: r_tip", "tool: r_tip, toll: 1"),
            r"unknown key 'arms\.right\.toll' .did you mean 'arms\.right\.tool'.*arms\.right\.joints",
        ),
        (("tool: r_tip", "tool: yes"), r"key 'arms\.right\.tool': a number or text is needed, not true or false"),
    ],
)
def test_faults_name_the_key(twins: Path, change: tuple[str, str], words: str) -> None:
    twins.write_text(YAML.replace(*change))
    with pytest.raises(wb.InputError, match=words):
        wb.load_robot(twins)


def test_frames_of_a_relative_pose_are_two(twins: Path) -> None:
    robot = wb.load_robot(twins)
    with pytest.raises(wb.InputError, match="'l_tip' twice"):
        wb.residuals.RelativePose(robot, "l_tip", "l_tip")
    with pytest.raises(wb.InputError, match="'r_top'"):
        wb.residuals.RelativeMotion(robot, "l_tip", "r_top")
