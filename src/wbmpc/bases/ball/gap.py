"""A gap in time of the ball filter: what the wheels say about it, and how little is known afterwards.

Three wheels that do not slip turn with the ball relative to the base: two parts of that are the ball's way over the floor, the
third is the base's turning about the vertical, if the base leans as little as a robot that stands. See docs/explanation/ball-robot.md for the
same relation in the filter's rolling rows.
"""

from __future__ import annotations

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array

#: An interval longer than this [s] is a gap: what the inertial unit said at its end says nothing of the time before.
GAP = 0.1
#: After a gap: standard deviation by this share of the way and of the turn, and by so much in a second [m/s, rad/s] besides; of the
#: lean [rad]; of the velocity beside its mean over the gap [m/s].
GAP_SHARE, GAP_SPEED, GAP_TURN = 0.2, 0.05, 0.1
GAP_LEAN, GAP_VELOCITY = 0.1, 0.5


def bridged(turn: Array, radius: float, rotation: Array, wheel: Array) -> tuple[Array, float]:
    """Way (3) [m] of the ball and turn [rad] of an upright base about the vertical, for wheels that turned by ``wheel`` (n) [rad];
    ``turn`` (n, 3): wheel speeds over the ball's rate relative to the base, ``rotation`` of the base before."""
    rolled = np.linalg.lstsq(turn, wheel, rcond=None)[0]
    yaw = -float(rolled[2])
    heading = lie.rotation_to_euler_zyx(rotation)[0] + 0.5 * yaw
    c, s = np.cos(heading), np.sin(heading)
    about = np.array([c * rolled[0] - s * rolled[1], s * rolled[0] + c * rolled[1]])
    return radius * np.array([about[1], -about[0], 0.0]), yaw


def spreads(h: float, shift: Array, yaw: float) -> tuple[float, float, float]:
    """Standard deviations after a gap of ``h`` [s]: position [m], yaw [rad], velocity [m/s]."""
    way = float(np.linalg.norm(shift))
    return GAP_SHARE * way + GAP_SPEED * h, GAP_SHARE * abs(yaw) + GAP_TURN * h, GAP_VELOCITY + way / h
