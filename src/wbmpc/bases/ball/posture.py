"""Where a ball robot rests when its end effector has to be somewhere."""

from __future__ import annotations

import numpy as np

from wbmpc import lie
from wbmpc.bases.ball.model import ball_base
from wbmpc.model.robot import RobotModel

#: Evaluations at most: poses within reach take up to 20, one far out of reach would take hundreds and come no nearer.
EVALUATIONS = 40


def resting(robot: RobotModel, position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """State (nx) in which the robot rests with its end effector as near as it can be to a pose, and its arm near that of home.

    Where the arm does not decide (place and heading of the base), a weak pull towards home does.
    """
    from scipy.optimize import least_squares

    arm, target = robot.home[robot.state["arm"]], lie.quaternion_conjugate(quaternion)

    def state(z: np.ndarray) -> np.ndarray:
        x = ball_base(robot).numeric.equilibrium(z[3:], yaw=float(z[2]))[0]
        x[:2] = z[:2]
        return x

    def error(z: np.ndarray) -> np.ndarray:
        place, turn = robot.pose(state(z))
        turned = lie.quaternion_log(lie.quaternion_multiply(turn, target))
        return np.concatenate([place - position, 0.3 * turned, 1e-3 * (z[3:] - arm)])

    start = np.concatenate([np.zeros(3), arm])
    return state(least_squares(error, start, diff_step=1e-5, max_nfev=EVALUATIONS).x)
