"""The pose error of a frame. Truth: MuJoCo's kinematics and its quaternions."""

from __future__ import annotations

import casadi as ca
import mujoco
import numpy as np
import pytest

from toys import robot
from wbmpc.bases.swerve.perturbation import SwervePerturbation
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.ocp import residuals
from wbmpc.ocp.symbols import Symbols

SWERVE = robot("swerve-ur10")


def _pose_of_the_tool(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position and quaternion by MuJoCo."""
    plant = SwervePlant(SWERVE.description, None, SwervePerturbation.none(), settle=0.0)
    plant.arrange(x)
    truth, quaternion = plant.truth(), np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, truth.tool_rotation.ravel())
    return truth.tool, quaternion


@pytest.mark.parametrize("axes", ["world", "reference"])
@pytest.mark.parametrize("axis", range(3))
def test_a_turned_reference_is_an_error_about_the_axis_it_was_turned_about(axes: str, axis: int) -> None:
    """0.3 rad about an axis of the world, or of the reference itself; the position is 1, 2 and 3 cm off."""
    x = SWERVE.home + np.linspace(-0.3, 0.4, SWERVE.state.size)
    position, quaternion = _pose_of_the_tool(x)
    turn, target, off = np.zeros(4), np.zeros(4), np.zeros(6)
    off[:3], off[3 + axis] = [0.01, 0.02, 0.03], 0.3
    mujoco.mju_axisAngle2Quat(turn, np.eye(3)[axis], -0.3)
    pair = (turn, quaternion) if axes == "world" else (quaternion, turn)
    mujoco.mju_mulQuat(target, *pair)
    residual = residuals.FramePose(SWERVE, SWERVE.tool, axes=axes)  # type: ignore[arg-type]
    s, none = ca.SX.sym("x", SWERVE.state.size), ca.SX(0, 1)
    u, r = ca.SX(SWERVE.input.size, 1), ca.SX.sym("r", 7)
    value = ca.Function("f", [s, r], [residual(Symbols(s, u, none, none, r, s, u))])
    found = np.array(value(x, np.concatenate([position - off[:3], target]))).ravel()
    assert found[3:] == pytest.approx(off[3:], abs=1e-6)
    assert found[:3] == pytest.approx(off[:3], abs=2e-4)  # the planner's base has one height
