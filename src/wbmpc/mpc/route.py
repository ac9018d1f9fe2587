"""Routes of the base, from any planner: poses that an MPC follows as references, the end effector carried along as at home."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.checks import absolute_time, positive, real_numbers
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.ocp import Reference

if TYPE_CHECKING:
    from wbmpc.mpc.mpc import MPC
    from wbmpc.solver import Solver

#: Of the end effector's weight per m², what the base's place gets; and the length [m] at which an angle of it counts as much.
SHARE, LENGTH = 0.1, 0.5
#: A route takes so long at least [s]; interval [s] of its references.
SHORTEST, SAMPLED = 0.1, 0.02
#: Time [s] in which the end effector swings from where it is to where it is carried.
SWING = 3.0
_UP = (0.0, 0.0, 1.0)


def base_part(robot: RobotModel, task: str = "route") -> slice:
    """Where (x, y, yaw) of the base are in the robot's state. Raises :class:`InputError`, which names the ``task``, where it has none."""
    if "base" not in robot.state:
        raise InputError(
            f"{task}: the state of robot '{robot.description.name}' has no pose of a base (a group 'base' with x, y, yaw); "
            "valid: a robot that drives"
        )
    start = robot.state["base"].start
    return slice(start, start + 3)


def carried_states(robot: RobotModel, base: Array, shape: Array | None = None) -> Array:
    """States (n, nx) of the robot at home, or in another ``shape`` (nx), with its base at poses (n, 3: x, y [m], yaw [rad])."""
    states = np.tile(robot.home if shape is None else shape, (len(base), 1))
    states[:, base_part(robot)] = base
    return states


def carried_poses(robot: RobotModel, base: Array, shape: Array | None = None) -> Array:
    """Poses (n, 7) of the end effector beside a base at poses (n, 3: x, y [m], yaw [rad]), as it is at home, or in another ``shape`` (nx)."""
    shape = robot.home if shape is None else shape
    home = shape[base_part(robot)]
    position, quaternion = robot.pose(shape)
    beside, turn = position[:2] - home[:2], base[:, 2] - home[2]
    c, s = np.cos(turn), np.sin(turn)
    poses = np.empty((len(base), 7))
    poses[:, 0] = base[:, 0] + c * beside[0] - s * beside[1]
    poses[:, 1] = base[:, 1] + s * beside[0] + c * beside[1]
    poses[:, 2] = position[2]
    poses[:, 3:] = [lie.quaternion_multiply(lie.quaternion_about(_UP, float(a)), quaternion) for a in turn]
    return poses


def swung_poses(robot: RobotModel, times: Array, base: Array, start: Array) -> Array:
    """Poses (n, 7) of the end effector at ``times`` (n) [s] beside a base at poses (n, 3): within :data:`SWING` from where it is in the state
    ``start`` (nx) to where it is at home. A reference that jumps there would throw the arm at what is near."""
    share = np.clip((times - times[0]) / SWING, 0.0, 1.0)
    share *= share * (3.0 - 2.0 * share)
    before, poses = carried_poses(robot, base, start), carried_poses(robot, base)
    poses[:, :3] += (1.0 - share[:, None]) * (before[:, :3] - poses[:, :3])
    poses[:, 3:] = [lie.slerp(a, b, float(k)) for a, b, k in zip(before[:, 3:], poses[:, 3:], share, strict=True)]
    return poses


def carrying_base(robot: RobotModel, pose: Array) -> Array:
    """Pose (3: x, y [m], yaw [rad]) of the base beside which the end effector, at a pose (7), is as at home."""
    home = robot.home[base_part(robot)]
    position, quaternion = robot.pose(robot.home)
    turn = lie.quaternion_log(lie.quaternion_multiply(pose[3:], lie.quaternion_conjugate(quaternion)))[2]
    beside, c, s = position[:2] - home[:2], np.cos(turn), np.sin(turn)
    place = [pose[0] - c * beside[0] + s * beside[1], pose[1] - s * beside[0] - c * beside[1]]
    return np.array([*place, home[2] + turn])


def weigh_base(solver: Solver, robot: RobotModel) -> bool:
    """Give the base a weight in the cost "state" by the end effector's, if it has less; whether the problem has such a cost."""
    slices, part = solver.problem.constant.slices, base_part(robot)
    width = solver.problem.references.slices.get("state")
    if "path.state" not in slices or width is None or width.stop - width.start != robot.state.size:
        return False
    weights, effector = solver.constants[slices["path.state"]].copy(), solver.constants[slices["path.end_effector"]]
    maximum = SHARE * float(effector[:3].max())
    weights[part] = np.maximum(weights[part], [maximum, maximum, maximum * LENGTH**2])
    solver.set_weight("state", weights.tolist())
    return True


def timed_route(poses: Array, speed: float, turn_speed: float, ramp: float) -> tuple[Array, Array]:
    """Times (m) [s] from 0 and base poses (m, 3) along straight pieces between ``poses`` (n, 3), with ``speed`` [m/s] on ways and
    ``turn_speed`` [rad/s] on turns, whichever takes longer, from rest to rest over ``ramp`` [s]."""
    poses = poses.copy()
    poses[:, 2] = np.unwrap(poses[:, 2])
    steps = np.diff(poses, axis=0)
    each = np.maximum(np.linalg.norm(steps[:, :2], axis=1) / speed, np.abs(steps[:, 2]) / turn_speed)
    at = np.concatenate([[0.0], np.cumsum(each)])
    whole = max(at[-1], SHORTEST)
    times = np.linspace(0.0, whole + ramp, max(int(np.ceil((whole + ramp) / SAMPLED)), 2) + 1)
    # the integral of a speed that rises from 0 to 1 and falls back at the end, each over the ramp
    risen = lambda t: np.where(t < ramp, 0.5 * np.clip(t, 0.0, None) ** 2 / max(ramp, 1e-9), t - 0.5 * ramp)
    along = np.clip(risen(times) - risen(times - whole), 0.0, at[-1])
    return times, np.stack([np.interp(along, at, column) for column in poses.T], axis=1)


def follow_route(
    mpc: MPC, robot: RobotModel, poses: ArrayLike, start: float = 0.0, *, speed: float = 0.3, turn_speed: float = 0.6,
    ramp: float = 1.0,
) -> float:  # fmt: skip
    """Let ``mpc`` follow a route of the base from ``start`` [s] on, with the end effector at its home pose on the base. Returns the time
    [s] at which the route ends.

    ``poses`` (n, 3): x, y [m], yaw [rad] in the world of :meth:`wbmpc.model.robot.RobotModel.pose`, the first one where the robot is: of
    :func:`wbmpc.plan_route`, of Nav2, of any other planner. ``speed`` [m/s] and ``turn_speed`` [rad/s]: of the base; ``ramp`` [s]: over
    which it starts and stops. The references "end_effector" and "state" are set; the base gets a weight in the cost "state", where the
    problem has one of the whole state. With :class:`wbmpc.PacedReferences`, made afterwards, they wait for a robot that evades something.
    Raises :class:`InputError` for poses that are no numbers, fewer than two, and a base that does not move.
    """
    route = real_numbers("route: 'poses'", poses)
    if route.ndim != 2 or route.shape[1] != 3 or len(route) < 2 or not np.isfinite(route).all():
        raise InputError(
            f"route: 'poses': two or more rows of 3 finite numbers (x, y, yaw) are needed, got shape {route.shape}"
        )
    start = absolute_time("route: 'start'", start)
    positive("route", speed=speed, turn_speed=turn_speed, ramp=ramp)
    base_part(robot)
    if "end_effector" not in mpc.reference:
        raise InputError("route: the MPC needs a reference 'end_effector'")
    times, base = timed_route(route, speed, turn_speed, ramp)
    set_carried(mpc.solver, robot, start + times, carried_poses(robot, base), carried_states(robot, base))
    return float(start + times[-1])


def set_carried(solver: Solver, robot: RobotModel, times: Array, poses: Array, states: Array) -> None:
    """References at ``times`` (n) [s]: ``poses`` (n, 7) of the end effector, and ``states`` (n, nx) where the problem has a cost of them."""
    solver.set_reference("end_effector", Reference.poses(times, poses[:, :3], poses[:, 3:]))
    if weigh_base(solver, robot):
        solver.set_reference("state", Reference(times, states))
