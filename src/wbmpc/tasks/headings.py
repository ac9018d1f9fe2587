"""Headings along a known path, of a base that cannot go sideways and whose arm cannot turn the end effector all the way round.

Such a base points ahead or back along the path of its end effector. A plan sees some seconds of that and takes what is nearer, also where
the robot's own parts are in the way of the rest. Here the whole path decides: headings over time that leave the end effector within the
turns which the arm has for it, with as little motion across the base as possible, by dynamic programming.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.route import base_part
from wbmpc.obstacles.pairs import draw_states
from wbmpc.ocp import Reference
from wbmpc.tasks.arm_reach import own_rows

if TYPE_CHECKING:
    from wbmpc.solver import Solver

#: Random postures, and more where these do not go round, that are moved to where the end effector is tilted as at home; Gauss-Newton steps for
#: that, their damping and the step [rad or m] of differences; how exact [m, 1] they then are; turns [rad] between two of which the arm has
#: no others; and how many [rad] are none.
POSTURES, STEPS, DAMPING, DIFFERENCE, EXACT, GAP, NARROW = (250, 1000), 12, 1e-4, 1e-6, 1e-3, 0.25, 1.0
#: Step [s] and turn [rad] of headings; share of the base's rate of turning that they use.
STEP, FINE, SHARE = 0.25, 0.04, 0.9
#: What turns cost [m²] beside ways across the base [m²/s²], what the last turn that the arm has does [m²/s²], and how near [rad] it counts.
EFFORT, EDGE, NEAR = 1e-2, 3e-3, 0.3
#: What a heading costs [1/rad², per second].
WEIGHT = 1.0


class Turns(NamedTuple):
    """How far [rad] an arm turns its end effector about the vertical against the base, from ``least`` to ``most``, 0 at home."""

    least: float
    most: float


def drives_ahead_only(robot: RobotModel) -> bool:
    """Whether the base drives along one direction of its own, and turns, both at once, but never goes sideways; and no joint of it, as of
    a car, has to move first."""
    return set(robot.state.groups) == {"base", "arm"} and np.shape(robot.base.twist) == (3, 2)


def turns(robot: RobotModel) -> Turns | None:
    """As far as its own parts and ranges allow, with the end effector as high and tilted as at home, wherever beside the base. None: all the
    way round."""
    found = None
    for count in POSTURES:
        if (found := _turns(robot, count)) is None:
            break
    return found


def _turns(robot: RobotModel, count: int) -> Turns | None:
    """The same by ``count`` random postures."""
    states, home = _tilted(robot, draw_states(robot, count)), robot.pose(robot.home)[1]
    rows = own_rows(robot)
    if rows is not None:
        states = states[(rows.measure(states) >= rows.margins).all(axis=1)]
    q = lie.quaternion_multiply(robot.poses(states)[:, 3:].T, lie.quaternion_conjugate(home))
    at = np.sort(np.append(lie.wrapped(2.0 * np.arctan2(q[3], q[0])), 0.0))
    gaps, middle = np.flatnonzero(np.diff(at) > GAP), int(np.searchsorted(at, 0.0))
    if not gaps.size and at[0] + 2.0 * np.pi - at[-1] <= GAP:
        return None
    below, above = gaps[gaps < middle], gaps[gaps >= middle]
    return Turns(float(at[below[-1] + 1] if below.size else at[0]), float(at[above[0]] if above.size else at[-1]))


def _tilted(robot: RobotModel, states: Array) -> Array:
    """Of states (n, nx), moved within ranges so that their end effector is as high and tilted as at home, those that get there."""
    arm, home = robot.state["arm"], robot.poses(robot.home[None])
    low, high = robot.limits.state_lower[arm], robot.limits.state_upper[arm]
    x, count = states.copy(), low.size
    moved = DIFFERENCE * np.vstack([np.zeros(count), np.eye(count)])

    def errors(states: Array) -> Array:
        return _lean(robot.poses(states)) - _lean(home)

    for _ in range(STEPS):
        near = np.repeat(x, count + 1, axis=0)
        near[:, arm] += np.tile(moved, (len(x), 1))
        values = errors(near).reshape(len(x), count + 1, -1)
        jacobian = (values[:, 1:] - values[:, :1]).transpose(0, 2, 1) / DIFFERENCE
        square = jacobian @ jacobian.transpose(0, 2, 1) + DAMPING * np.eye(4)
        step = jacobian.transpose(0, 2, 1) @ np.linalg.solve(square, values[:, 0, :, None])
        x[:, arm] = np.clip(x[:, arm] - step[:, :, 0], low, high)
    return np.asarray(x[np.abs(errors(x)).max(axis=1) < EXACT])


def _lean(poses: Array) -> Array:
    """Of poses (n, 7): height [m] and the vertical in the axes of the end effector (n, 4)."""
    w, x, y, z = poses[:, 3:].T
    return np.stack([poses[:, 2], 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)], axis=1)


def headings(robot: RobotModel, reference: Reference) -> tuple[Array, Array] | None:
    """Times (n) [s] and headings (n) [rad] of the base along poses of the end effector; None for a robot that needs none: its base goes
    sideways, or its arm turns the end effector all the way round, or hardly at all."""
    if not drives_ahead_only(robot) or len(reference.times) < 2:
        return None
    limit = turns(robot)
    return None if limit is None or limit.most - limit.least < NARROW else _planned(robot, reference, limit)


def _planned(robot: RobotModel, reference: Reference, limit: Turns) -> tuple[Array, Array] | None:
    """The same within ``limit``; None where the end effector turns too fast for the base. States of the program
    are the end effector's turns against the base."""
    times = np.arange(reference.times[0], reference.times[-1] + STEP, STEP)
    poses = np.array([reference.at(t) for t in times])
    back = lie.quaternion_conjugate(robot.pose(robot.home)[1])
    hand = np.unwrap([lie.quaternion_log(lie.quaternion_multiply(q, back))[2] for q in poses[:, 3:]])
    ways, heading = np.diff(poses[:, :2], axis=0) / STEP, robot.home[base_part(robot)][2]
    drive = heading + np.arctan2(robot.base.twist[1, 0], robot.base.twist[0, 0])
    at = np.arange(limit.least, limit.most, FINE)
    last = EDGE * np.clip(1.0 - np.minimum(at - limit.least, limit.most - at) / NEAR, 0.0, 1.0) ** 2
    fastest = SHARE * robot.limits.input_upper[robot.input["base"]][-1]
    cost, before = np.where(np.arange(at.size) == np.argmin(np.abs(at)), 0.0, np.inf), []
    for way, now, then in zip(ways, hand[:-1], hand[1:], strict=True):
        rate = (then - now + at[:, None] - at[None, :]) / STEP
        total = cost[:, None] + np.where(np.abs(rate) <= fastest, EFFORT * STEP * rate**2, np.inf)
        across = way[1] * np.cos(drive + then - at) - way[0] * np.sin(drive + then - at)
        before.append(np.argmin(total, axis=0))
        cost = total.min(axis=0) + STEP * (across**2 + last)
    if not np.isfinite(cost).any():
        return None
    chosen = [int(np.argmin(cost))]
    for row in reversed(before):
        chosen.append(int(row[chosen[-1]]))
    return times, heading + hand - at[chosen[::-1]]


def weigh_heading(solver: Solver, robot: RobotModel) -> None:
    """Give the base's heading at least :data:`WEIGHT` in the cost "state"."""
    weights, yaw = solver.constants[solver.problem.constant.slices["path.state"]].copy(), base_part(robot).stop - 1
    weights[yaw] = max(weights[yaw], WEIGHT)
    solver.set_weight("state", weights.tolist())
