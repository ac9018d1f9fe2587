"""Directions that a motion asks for and that a wheel cannot take, whichever way round: said before the motion begins."""

from __future__ import annotations

import numpy as np

from wbmpc.bases.swerve.model import swerve_base
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.model.wheels import wheel_velocities

#: Speed [m/s] below which a wheel need not point anywhere; angle [rad] by which it may miss its direction (it slips 2 % sideways).
ROLLS, OFF = 0.02, 0.02


def beyond_range(steer: np.ndarray | float, lower: np.ndarray | float, upper: np.ndarray | float) -> np.ndarray:
    """By how much [rad] wheels at angles ``steer`` (..., n) are out of their ranges (n), whichever way round they roll."""
    low, high = np.broadcast_arrays(np.asarray(lower, float), np.asarray(upper, float))
    all_round = high - low >= np.pi
    middle = np.where(all_round, 0.0, 0.5 * (np.where(all_round, 0.0, low) + np.where(all_round, 0.0, high)))
    off = np.abs((np.asarray(steer, float) - middle + 0.5 * np.pi) % np.pi - 0.5 * np.pi)
    return np.where(all_round, 0.0, np.maximum(off - 0.5 * (high - low), 0.0))


def reject_directions(
    robot: RobotModel, times: np.ndarray, twists: np.ndarray, legs: np.ndarray, leg_rates: np.ndarray
) -> None:
    """Raise :class:`InputError` if body ``twists`` (k, 3) at ``times`` (k,) [s] ask a wheel for a direction out of its range.

    ``legs`` and ``leg_rates``: (k, n) [rad], [rad/s]. Ranges of half a turn or more reach every direction.
    """
    part, g = robot.state["steer"], swerve_base(robot).geometry
    low, high = robot.limits.state_lower[part], robot.limits.state_upper[part]
    if (high - low >= np.pi).all():
        return
    moves = zip(legs, twists, leg_rates, strict=True)
    velocity = np.array([wheel_velocities(g, leg, twist, rate) for leg, twist, rate in moves])
    heading = np.arctan2(velocity[..., 1], velocity[..., 0])
    angle = heading - g.wheel_heading - legs * g.legs_move * (1.0 - g.slides)
    missed = beyond_range(angle, low, high) * (np.hypot(velocity[..., 0], velocity[..., 1]) > ROLLS)
    if missed.max() <= OFF:
        return
    k = int(np.argmax(missed.max(axis=1) > OFF))
    i = int(np.argmax(missed[k]))
    raise InputError(
        f"{robot.description.name}: at {times[k]:.2f} s the motion asks the wheel of '{robot.state.groups['steer'][i]}' to roll "
        f"along {np.degrees(heading[k, i]):.0f}° of the body; its range of {low[i]:g} to {high[i]:g} rad misses that by "
        f"{np.degrees(missed[k, i]):.0f}° either way round; valid: a range of half a turn, or motions within the range"
    )
