"""Parts of `two-arms`. Truth: MuJoCo's kinematics of the robot's file; a rotation written down."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.robots import load_spec
from wbmpc.tasks.two_arms import TwoArmsSettings, build, grasp_errors


def test_the_grasp_error_is_what_one_end_effector_sees_of_the_other() -> None:
    """Base and torso move both and change nothing; an elbow moves one."""
    robot = load_robot("pr2")
    model = load_spec(robot.description).compile()
    data = mujoco.MjData(model)
    moved = robot.home.copy()
    moved[:4] += [0.5, -0.2, 0.7, 0.05]
    bent = moved.copy()
    bent[robot.state["arm"].start + robot.state.groups["arm"].index("r_elbow_flex_joint")] += 0.01
    off, turned = grasp_errors(robot, np.array([robot.home, moved, bent]))
    np.testing.assert_allclose([off[:2], turned[:2]], 0.0, atol=1e-9)
    bodies, seen = {model.body(i).name for i in range(model.nbody)}, []
    for x in (robot.home, bent):
        for name, value in zip(robot.state.groups["arm"], x[robot.state["arm"]], strict=True):
            data.joint(name).qpos[0] = value
        mujoco.mj_kinematics(model, data)
        one, other = ((data.body(f) if f in bodies else data.site(f)) for f in robot.tools.values())
        seen.append(one.xmat.reshape(3, 3).T @ (other.xpos - one.xpos))
    assert off[2] == pytest.approx(np.linalg.norm(seen[1] - seen[0]), rel=1e-6)
    assert turned[2] == pytest.approx(0.01, rel=1e-9)


def test_a_robot_with_one_arm_is_an_error() -> None:
    with pytest.raises(InputError, match=r"'fetch' has one arm; valid: .*'arms' with two"):
        build(TwoArmsSettings(robot="fetch"), 0)
