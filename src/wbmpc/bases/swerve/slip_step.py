"""What wheels contradict each other, message by message, compiled: see :class:`wbmpc.bases.swerve.slipping_wheels.SlippingWheels`."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.compilation import compiled, step
from wbmpc.kernel.ir import Floats, Integers

#: Windows over which squares are averaged; ratio of squares that is sudden; speed [m/s] of a base that moves.
MEMORY, SUDDEN, MOVING, FEW = 10.0, 6.0, 1e-3, 6.0
#: How many windows there are, each half as long as the one before; what is left of slip's square in the longest when it lasts a
#: quarter of it: 1 / 1.25 of white slip's.
WINDOWS, LASTING = 4, 1.25


class Slip(IntEnum):
    """Entries of the memory of :func:`slip_intensity`: one for each window, then single numbers."""

    UNSEEN = 0
    SQUARES = 4
    WEIGHT = 8
    SPEED = 12
    MOVED = 13
    NOW = 14  # mean square [m²/s²] of the residual's speed over the longest window
    INTENSITY = 15
    SIZE = 16


def slip_memory() -> Array:
    """The memory before the first interval."""
    memory = np.zeros(Slip.SIZE)
    memory[Slip.UNSEEN : Slip.UNSEEN + WINDOWS] = 1.0
    return memory


@compiled
def slip_intensity(
    slip: Floats, mean: Floats, n: int, residual: Floats, weights: Floats, rolled: Floats, window: float, h: float
) -> float:
    """Intensity [m²/s] of the wheels' slip, each component, from what they contradict each other: ``residual`` (n, 2) [m] of the
    last h [s], in which they ``rolled`` (n) [m]; ``mean`` (windows, n, 2) is memory as ``slip`` is.

    The residual's speed is averaged over the ``window`` w [s] (encoder counts cancel, slip that lasts less long than w is left
    with intensity / (2 w)); its square over ten windows of motion, for one has few degrees of freedom and would make lucky
    intervals look exact. A contradiction that is far above that counts at once. Shorter windows have more degrees of freedom in the
    same time, and see less of slip that lasts: the largest of their answers is the least wrong. Before enough was seen, the mean
    square over k degrees of freedom is taken for 1 + 2 / k of itself, as a variance that is known from k squares.
    """
    freedoms, speed = -3.0, 0.0
    for i in range(n):
        freedoms += 2.0 * min(weights[i], 1.0)
        speed += abs(rolled[i]) / (n * h)
    freedoms = max(freedoms, 1.0)
    decay = np.exp(-h / window)
    slip[Slip.SPEED] = decay * slip[Slip.SPEED] + (1.0 - decay) * speed
    moving, fade = slip[Slip.SPEED] > MOVING, decay ** (1.0 / MEMORY)
    if moving:
        slip[Slip.MOVED] = min(slip[Slip.MOVED] + h, 2.0 * MEMORY * window)
    now, first, usual_first, largest, share = 0.0, 0.0, 0.0, 0.0, 1.0
    for k in range(WINDOWS):
        decay = np.exp(-h / (share * window))
        total = 0.0
        for j in range(2 * n):
            e = k * 2 * n + j
            mean[e] = decay * mean[e] + (1.0 - decay) * (weights[j // 2] * residual[j] / h)
            total += mean[e] ** 2
        # the mean starts from 0: it is short of this share of its variance
        slip[Slip.UNSEEN + k] = slip[Slip.UNSEEN + k] * decay**2
        square, unseen = total / freedoms, slip[Slip.UNSEEN + k]
        white = h * (1.0 + decay) / (1.0 - decay)  # intensity over mean square of a window: 2 w
        if k == 0:
            now, first = square / (1.0 - unseen), white
        if moving:
            squares = fade * slip[Slip.SQUARES + k] + (1.0 - fade) * square
            weight = fade * slip[Slip.WEIGHT + k] + (1.0 - fade) * (1.0 - unseen)
            slip[Slip.SQUARES + k], slip[Slip.WEIGHT + k] = squares, weight
            usual = squares / weight
            if k == 0:
                usual_first = usual
            known = 1.0 + FEW * share * window / (freedoms * slip[Slip.MOVED])
            largest = max(largest, white * usual * known)
        share *= 0.5
    if moving and not now > SUDDEN * usual_first:
        now = usual_first
    slip[Slip.NOW] = now
    slip[Slip.INTENSITY] = LASTING * max(first * now, largest)
    return slip[Slip.INTENSITY]


class Wheels(NamedTuple):
    """Wheels in a simulated world, as MuJoCo has it; their contacts are copied."""

    geoms: Integers  # (n), shapes of the wheels
    bodies: Integers  # (n)
    roots: Integers  # (n), the robot's body
    cvel: Floats  # (bodies, 6), angular and linear velocity at the robot's center of mass, world axes
    subtree_com: Floats  # (bodies, 3) [m]
    xmat: Floats  # (bodies, 3, 3)
    touching: Integers  # (count, 2), shapes of each contact
    distance: Floats  # (count) [m]
    at: Floats  # (count, 3) [m]
    frame: Floats  # (count, 3, 3), the normal and two tangents
    slip: Floats  # (n, 2) [m/s]


@compiled
def slip_of(w: Wheels, i: int, c: int) -> None:
    """Velocity ``slip`` of wheel i at contact c, along the wheel and along its axle."""
    v, m, o = 6 * w.bodies[i], 9 * w.bodies[i], 3 * w.roots[i]
    x, y, z = (
        w.at[3 * c] - w.subtree_com[o], w.at[3 * c + 1] - w.subtree_com[o + 1], w.at[3 * c + 2] - w.subtree_com[o + 2],
    )  # fmt: skip
    vx = w.cvel[v + 3] + (w.cvel[v + 1] * z - w.cvel[v + 2] * y)
    vy = w.cvel[v + 4] + (w.cvel[v + 2] * x - w.cvel[v] * z)
    vz = w.cvel[v + 5] + (w.cvel[v] * y - w.cvel[v + 1] * x)
    nx, ny, nz = w.frame[9 * c], w.frame[9 * c + 1], w.frame[9 * c + 2]
    # the wheel's axle is its y axis
    ax = w.xmat[m + 4] * nz - w.xmat[m + 7] * ny
    ay = w.xmat[m + 7] * nx - w.xmat[m + 1] * nz
    az = w.xmat[m + 1] * ny - w.xmat[m + 4] * nx
    length = max(np.sqrt(ax * ax + ay * ay + az * az), 1e-9)
    ax, ay, az = ax / length, ay / length, az / length
    w.slip[2 * i] = vx * ax + vy * ay + vz * az
    w.slip[2 * i + 1] = vx * (ny * az - nz * ay) + vy * (nz * ax - nx * az) + vz * (nx * ay - ny * ax)


@step
def contact_slips(w: Wheels, n: int, count: int) -> None:
    """``slip`` of n wheels over what each touches, by ``count`` contacts. Of several contacts of one wheel the deepest counts; a wheel in
    the air has none."""
    for i in range(n):
        w.slip[2 * i], w.slip[2 * i + 1], depth = 0.0, 0.0, np.inf
        for c in range(count):
            own = w.touching[2 * c] == w.geoms[i] or w.touching[2 * c + 1] == w.geoms[i]
            if own and w.distance[c] < depth:
                depth = w.distance[c]
                slip_of(w, i, c)


class Legs(NamedTuple):
    """Where wheels are on the base."""

    hinge: Floats  # (n, 2) [m]
    length: Floats  # (n) [m]
    leg_heading: Floats  # (n) [rad], at a leg's zero
    slides: Floats  # (n), 1 of legs that slide
    leg: Floats  # (n) [rad or m], their positions


class Contradiction(NamedTuple):
    """What wheels said, and what is averaged of it: see :func:`detect_contradiction`."""

    residual: Floats
    twist: Floats
    contradiction: Floats
    velocity: Floats
    odd: Floats


@step
def detect_contradiction(
    n: int, legs: Legs, wheels: Contradiction, over: float, threshold: float, h: float, turn: float, gyro: bool
) -> bool:
    """After h [s] in which the wheels' ``twist`` (3) left a ``residual`` (n, 2) [m] and the gyro turned by ``turn`` [rad]: ``odd`` (n) [s],
    the averaged ``contradiction`` and each wheel's ``velocity`` (n, 2) of the base [m/s]. Whether they contradict each other by more
    than the ``threshold`` [m/s]."""
    hinge, length, leg_heading, slides, leg = legs.hinge, legs.length, legs.leg_heading, legs.slides, legs.leg
    residual, twist, odd = wheels.residual, wheels.twist, wheels.odd
    contradiction, velocity = wheels.contradiction, wheels.velocity
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
