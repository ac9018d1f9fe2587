"""How far along a path the arm of a robot whose base stands can go, and how far its parts are from each other."""

from __future__ import annotations

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.clearance.rows import SelfRows
from wbmpc.model.robot import RobotModel
from wbmpc.obstacles.geometry import has_shapes
from wbmpc.obstacles.pairs import self_pairs
from wbmpc.ocp.clearance_residuals import SelfClearance

#: Poses along a path that are checked; how near [m] the end effector has to come; what a rotation counts [m/rad].
POSES, THERE, LEVER = 40, 1e-3, 0.2
#: The same of arms of fewer joints than a pose has numbers: they go where they shall and turn as they can.
NUMBERS, WEAK = 6, 1e-3
#: Gauss-Newton steps for a pose, at most, their damping (share of the largest singular value), and the step [rad or m] of differences.
STEPS, DAMPING, DIFFERENCE = 20, 1e-3, 1e-6


def reached_share(robot: RobotModel, points: Array, turns: Array) -> float:
    """The share (0 to 1) of poses, positions (n, 3) [m] and quaternions (n, 4) in the world, through which the arm goes from home on
    within its ranges."""
    x = robot.home.copy()
    for k in np.unique(np.linspace(0, len(points) - 1, POSES).round().astype(int)):
        x, error = _nearest(robot, x, points[k], turns[k])
        if error > THERE:
            return float(k / len(points))
    return 1.0


def _nearest(robot: RobotModel, start: Array, point: Array, turn: Array) -> tuple[Array, float]:
    """A state within ranges whose end effector is near a pose, and how far [m] it is."""
    arm, target, x = robot.state["arm"], lie.quaternion_conjugate(turn), start.copy()
    low, high = robot.limits.state_lower[arm], robot.limits.state_upper[arm]
    lever = LEVER if low.size >= NUMBERS else WEAK

    def errors(states: Array) -> Array:
        poses = robot.poses(states)
        turned = [lie.quaternion_log(lie.quaternion_multiply(pose[3:], target)) for pose in poses]
        return np.hstack([poses[:, :3] - point, lever * np.array(turned)])

    for _ in range(STEPS):
        states = np.tile(x, (low.size + 1, 1))
        states[1:, arm] += DIFFERENCE * np.eye(low.size)
        values = errors(states)
        left = float(np.linalg.norm(values[0, : 6 if lever == LEVER else 3]))
        if left <= 0.1 * THERE:
            break
        x[arm] = _step(x[arm], values[0], (values[1:] - values[0]).T / DIFFERENCE, low, high)
    return x, left


def _step(q: Array, error: Array, jacobian: Array, low: Array, high: Array) -> Array:
    """A damped Gauss-Newton step within ranges: joints that would leave theirs stop there, the others do the rest."""
    free, step = np.ones(q.size, bool), np.zeros(q.size)
    while free.any():
        part = jacobian[:, free]
        damping = (DAMPING * np.linalg.norm(part, 2)) ** 2 * np.eye(len(error))
        step[free] = -part.T @ np.linalg.solve(part @ part.T + damping, error + jacobian[:, ~free] @ step[~free])
        beyond = free & ((q + step < low) | (q + step > high))
        if not beyond.any():
            break
        step[beyond] = np.clip(q + step, low, high)[beyond] - q[beyond]
        free &= ~beyond
    return np.asarray(q + step)


def own_rows(robot: RobotModel) -> SelfRows | None:
    """Distances of the robot's pairs; None of one that has none, as without shapes. Raises :class:`InputError` for shapes that cannot be
    read, or are too many to find pairs."""
    return SelfRows(SelfClearance(robot)) if has_shapes(robot) and self_pairs(robot) else None
