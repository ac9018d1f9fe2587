"""What wheels contradict each other, message by message, compiled: see :class:`wbmpc.bases.swerve.slipping_wheels.SlippingWheels`."""

from __future__ import annotations

import numpy as np

from wbmpc.bases.swerve.compilation import step
from wbmpc.kernel.ir import Floats


@step
def contact_slip(velocity: Floats, center: Floats, axes: Floats, at: Floats, normal: Floats) -> tuple[float, float]:
    """Velocity [m/s] of a wheel's point ``at`` (3) a contact with this ``normal`` (3), along the wheel and along its axle: of a body with its
    ``center`` (3), ``axes`` (3, 3) by rows, and ``velocity`` (6), angular and linear, all in the world's axes."""
    x, y, z = at[0] - center[0], at[1] - center[1], at[2] - center[2]
    vx = velocity[3] + (velocity[1] * z - velocity[2] * y)
    vy = velocity[4] + (velocity[2] * x - velocity[0] * z)
    vz = velocity[5] + (velocity[0] * y - velocity[1] * x)
    # the wheel's axle is its y axis
    ax = axes[4] * normal[2] - axes[7] * normal[1]
    ay = axes[7] * normal[0] - axes[1] * normal[2]
    az = axes[1] * normal[1] - axes[4] * normal[0]
    length = max(np.sqrt(ax * ax + ay * ay + az * az), 1e-9)
    ax, ay, az = ax / length, ay / length, az / length
    across = vx * (normal[1] * az - normal[2] * ay)
    across += vy * (normal[2] * ax - normal[0] * az)
    across += vz * (normal[0] * ay - normal[1] * ax)
    return vx * ax + vy * ay + vz * az, across


@step
def detect_contradiction(
    n: int, hinge: Floats, length: Floats, leg_heading: Floats, slides: Floats, leg: Floats, residual: Floats, twist: Floats,
    contradiction: Floats, velocity: Floats, odd: Floats, over: float, threshold: float, h: float, turn: float,
    gyro: bool,
) -> bool:  # fmt: skip
    """After h [s] in which the wheels' ``twist`` (3) left a ``residual`` (n, 2) [m] and the gyro turned by ``turn`` [rad]: ``odd`` (n) [s],
    the averaged ``contradiction`` and each wheel's ``velocity`` (n, 2) of the base [m/s]. Whether they contradict each other by more
    than the ``threshold`` [m/s]."""
    for i in range(n):
        odd[i] = max(odd[i] - h, 0.0)
    if h <= 0.0:
        return False
    share, square = 1.0 - np.exp(-h / over), 0.0
    for i in range(n):
        x, y = 2 * i, 2 * i + 1
        contradiction[x] += share * (residual[x] / h - contradiction[x])
        contradiction[y] += share * (residual[y] / h - contradiction[y])
        square += contradiction[x] * contradiction[x] + contradiction[y] * contradiction[y]
        if gyro:
            heading, reach = leg_heading[i] + (1.0 - slides[i]) * leg[i], length[i] + slides[i] * leg[i]
            axis_x, axis_y = hinge[x] + reach * np.cos(heading), hinge[y] + reach * np.sin(heading)
            more = twist[2] - turn
            velocity[x] += share * ((residual[x] + twist[0] - more * axis_y) / h - velocity[x])
            velocity[y] += share * ((residual[y] + twist[1] + more * axis_x) / h - velocity[y])
    return square > threshold * threshold
