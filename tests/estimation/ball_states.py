"""How far two states of the ball filter are from each other."""

from __future__ import annotations

import numpy as np

from wbmpc import lie
from wbmpc.bases.ball.filter_state import BallState


def error_between(one: BallState, other: BallState) -> np.ndarray:
    """The error (16 + n) that moves ``other`` to ``one``: the inverse of :meth:`BallState.moved`."""
    turned = lie.quaternion_log(lie.rotation_to_quaternion(other.rotation.T @ one.rotation))
    return np.concatenate([
        one.position - other.position, one.velocity - other.velocity, turned, one.gyro_bias - other.gyro_bias,
        one.accel_bias - other.accel_bias, [one.scale - other.scale], one.wheel - other.wheel,
    ])  # fmt: skip
