"""A base that is led along poses, and carries its end effector along."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.route import base_part
from wbmpc.ocp import Cost, Reference
from wbmpc.tasks.path_settings import SAMPLED
from wbmpc.tasks.paths import rise

#: How long [s] a change of speed takes.
RAMP = 1.0
#: For how long [s], and the base's speeds ahead [m/s], to the left [m/s] and about the vertical [rad/s].
Order = tuple[float, float, float, float]


def base_path(orders: Sequence[Order], start: Array, since: float, twist: Array) -> tuple[Array, Array]:
    """Times (n) [s] and poses (n, 3) of a base that stands until ``since`` [s] and then drives as ordered; speeds change smoothly.
    ``twist`` (3, 3): the twist of the body's frame by the ordered speeds."""
    ends = since + np.cumsum([order[0] for order in orders])
    times = np.arange(0.0, ends[-1] + SAMPLED, SAMPLED)
    speed, current, begin = np.zeros((times.size, 3)), np.zeros(3), since
    for order, end in zip(orders, ends, strict=True):
        target = twist @ np.array(order[1:])
        speed[times >= begin] = (current + rise(times - begin, RAMP)[:, None] * (target - current))[times >= begin]
        current, begin = target, end
    poses = [start]
    for a, b in pairwise(speed):
        poses.append(lie.se2_step(poses[-1], 0.5 * (a + b) * SAMPLED))
    return times, np.array(poses)


def lead_base(robot: RobotModel, mpc: MPC, times: Array, poses: Array) -> None:
    """The base of a robot at home follows ``poses`` (n, 3) at ``times`` (n) [s] and carries its end effector along; the base itself counts
    with the weight of the end effector, where the problem has a cost of the whole state."""
    start, tool = robot.home[base_part(robot, "cmd-vel")], mpc.reference["end_effector"].at(0.0)
    carried = np.array([_carried(tool, start, pose) for pose in poses])
    mpc.reference["end_effector"] = Reference(times, carried, "pose")
    if "state" not in mpc.reference or mpc.reference["state"].values.shape[1] != robot.state.size:
        return
    part = base_part(robot, "cmd-vel")
    values = np.tile(mpc.reference["state"].values[:1], (len(times), 1))
    values[:, part] = poses
    mpc.reference["state"] = Reference(times, values)
    cost, effector = mpc.ocp.term("state"), mpc.ocp.term("end_effector")
    assert isinstance(cost, Cost) and isinstance(effector, Cost)
    pose = effector.expand(effector.weight)
    weight = np.array(cost.expand(cost.weight))
    weight[part] = [pose[0], pose[1], pose[5]]
    mpc.solver.set_weight("state", list(weight))


def _carried(tool: Array, start: Array, pose: Array) -> Array:
    """Pose (7) of what was at ``tool`` when the base stood at ``start``, now that it is at ``pose``."""
    spatial = lambda p: np.array([p[0], p[1], 0.0, *lie.quaternion_about((0.0, 0.0, 1.0), float(p[2]))])
    return lie.pose_compose(spatial(pose), lie.pose_compose(lie.pose_inverse(spatial(start)), tool))


def ordered_twist(robot: RobotModel) -> Array:
    """(3, 3): what the body's frame does when its base has speeds ahead, to the left and about the vertical."""
    matrix = robot.base.twist
    return np.asarray(matrix if matrix.shape[1] == 3 else np.column_stack([matrix[:, 0], np.zeros(3), matrix[:, -1]]))
