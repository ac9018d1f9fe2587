"""The least-squares twist of steered wheels, compiled.

Wheel i moves in the body's frame by t + ψ ẑ × s_i + Δs_i. With rates that are constant over the interval its heading
turns by Δ: the path's chord is sin(Δ/2) / (Δ/2) of the rolled length, along the middle heading. The least squares
solution follows from (weighted) centroids: ψ = Σ (s − s̄) × b / Σ |s − s̄|², t = b̄ − ψ ẑ × s̄.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.compilation import compiled, step
from wbmpc.kernel.ir import Floats
from wbmpc.kernel.step import Step, bind
from wbmpc.model.wheels import ModuleGeometry


class Wheels(NamedTuple):
    """Steered wheels over an interval: n of them, on legs."""

    n: int
    hinge: Floats  # (n, 2) [m], the legs' hinges in the base's frame
    length: Floats  # (n) [m], of the legs
    leg_heading: Floats  # (n) [rad], at angle 0
    slides: Floats  # (n), 1 for legs that slide, 0 for those that turn
    wheel_heading: Floats  # (n) [rad], at angle 0
    radius: Floats  # (n) [m]
    correction: Floats  # zeros (n) [rad] of the steering, relative errors (n) of the radii
    weights: Floats  # (n)
    before: Floats  # legs, steering, wheels (n each) [rad], or [m] of legs that slide, at the beginning
    now: Floats  # and at the end
    rolled: Floats  # (n) [m]
    heading: Floats  # (n) [rad], in the middle
    axes: Floats  # (n, 2) [m], the wheels' places in the middle
    moved: Floats  # (n, 2) [m], the wheels' displacements less the legs'
    twist: Floats  # (3) [m, m, rad], the base's over the interval
    slope: Floats  # (3, n, 2), of the twist by the displacements
    residual: Floats  # (n, 2) [m], what the twist does not explain


@compiled
def sinc(x: float) -> float:
    if x == 0.0:
        return 1.0
    return np.sin(x) / x


@compiled
def move(pose: Floats, dx: float, dy: float, dyaw: float) -> tuple[float, float]:
    """Move ``pose`` (x, y, yaw) by a body twist with this integral, exactly; by what x and y moved."""
    s, c = sinc(dyaw), 0.5 * dyaw * sinc(0.5 * dyaw) ** 2
    ahead, aside = s * dx - c * dy, c * dx + s * dy
    x = np.cos(pose[2]) * ahead - np.sin(pose[2]) * aside
    y = np.sin(pose[2]) * ahead + np.cos(pose[2]) * aside
    pose[0] += x
    pose[1] += y
    pose[2] += dyaw
    return x, y


@compiled
def displacements(w: Wheels) -> None:
    """Each wheel's path (``rolled``, ``heading``), its axis in the middle of the interval and its displacement ``moved`` (n, 2)
    less the leg's."""
    n, before, now, hinge, slides, heading = w.n, w.before, w.now, w.hinge, w.slides, w.heading
    for i in range(n):
        leg0, leg1, zero = before[i], now[i], w.correction[i]
        steer0, steer1 = before[n + i] - zero, now[n + i] - zero
        turn0, turn1 = (1.0 - slides[i]) * leg0, (1.0 - slides[i]) * leg1
        turn = (turn1 - turn0) + (steer1 - steer0)
        heading[i] = w.wheel_heading[i] + 0.5 * (turn0 + turn1 + steer0 + steer1)
        way = w.radius[i] * (1.0 + w.correction[n + i]) * (now[2 * n + i] - before[2 * n + i]) * sinc(0.5 * turn)
        length0, length1 = w.length[i] + slides[i] * leg0, w.length[i] + slides[i] * leg1
        x0 = hinge[2 * i] + length0 * np.cos(w.leg_heading[i] + turn0)
        y0 = hinge[2 * i + 1] + length0 * np.sin(w.leg_heading[i] + turn0)
        x1, y1 = x0, y0
        if leg0 != leg1:
            x1 = hinge[2 * i] + length1 * np.cos(w.leg_heading[i] + turn1)
            y1 = hinge[2 * i + 1] + length1 * np.sin(w.leg_heading[i] + turn1)
        w.rolled[i] = way
        w.moved[2 * i], w.moved[2 * i + 1] = x0 - x1 + way * np.cos(heading[i]), y0 - y1 + way * np.sin(heading[i])
        w.axes[2 * i], w.axes[2 * i + 1] = 0.5 * (x0 + x1), 0.5 * (y0 + y1)


@step
def fit(w: Wheels) -> None:
    """The ``twist`` from true angles ``before`` and ``now``, and its ``slope``."""
    n, weights, axes, moved, slope, twist = w.n, w.weights, w.axes, w.moved, w.slope, w.twist
    displacements(w)
    total, mx, my = 0.0, 0.0, 0.0
    for i in range(n):
        total += weights[i]
    for i in range(n):
        share = weights[i] / total
        mx += share * axes[2 * i]
        my += share * axes[2 * i + 1]
    square = 0.0
    for i in range(n):
        share = weights[i] / total
        square += share * ((axes[2 * i] - mx) ** 2 + (axes[2 * i + 1] - my) ** 2)
    dx, dy, dyaw, m = 0.0, 0.0, 0.0, 2 * n
    for i in range(n):
        share, j = weights[i] / total, 2 * i
        fx, fy = -share * (axes[j + 1] - my) / square, share * (axes[j] - mx) / square
        slope[2 * m + j], slope[2 * m + j + 1] = fx, fy
        slope[j], slope[j + 1] = share + my * fx, my * fy
        slope[m + j], slope[m + j + 1] = -mx * fx, share - mx * fy
        dx += slope[j] * moved[j] + slope[j + 1] * moved[j + 1]
        dy += slope[m + j] * moved[j] + slope[m + j + 1] * moved[j + 1]
        dyaw += fx * moved[j] + fy * moved[j + 1]
    twist[0], twist[1], twist[2] = dx, dy, dyaw
    for i in range(n):
        w.residual[2 * i] = moved[2 * i] - dx + dyaw * axes[2 * i + 1]
        w.residual[2 * i + 1] = moved[2 * i + 1] - dy - dyaw * axes[2 * i]


@step
def dead_reckon(w: Wheels, pose: Floats) -> None:
    """As :func:`fit`; ``pose`` (3) moves by the twist."""
    fit(w)
    move(pose, w.twist[0], w.twist[1], w.twist[2])


class WheelFit:
    """The step :func:`fit` of one geometry with its arrays in ``memory``: ``before`` and ``now`` (3n) go in, ``twist`` (3),
    ``residual`` (2n), ``rolled``, ``heading`` (n) and ``slope`` (3 · 2n) come out. ``correction`` (2n) is 0, ``weights`` (n) are 1.
    ``given``: arrays to be used instead of own ones.
    """

    def __init__(self, geometry: ModuleGeometry, radius: Array, **given: Array) -> None:
        n = geometry.modules
        sizes = {
            "twist": 3, "residual": 2 * n, "rolled": n, "heading": n, "slope": 6 * n, "axes": 2 * n, "moved": 2 * n,
        }  # fmt: skip
        sizes |= {"before": 3 * n, "now": 3 * n, "correction": 2 * n}
        self.memory = {
            "hinge": np.array(geometry.hinge, float).ravel(), "length": np.array(geometry.leg_length, float),
            "leg_heading": np.array(geometry.leg_heading, float), "slides": np.array(geometry.slides, float),
            "wheel_heading": np.array(geometry.wheel_heading, float),
            "radius": np.array(np.broadcast_to(radius, n), float), "weights": np.ones(n),
            **{name: np.zeros(size) for name, size in sizes.items()}, **given,
        }  # fmt: skip
        self.n = n
        self.run = bind(fit, self.memory, n=n)

    def with_pose(self, pose: Array) -> Step:
        """The step :func:`dead_reckon` on the same arrays and on a ``pose`` (3)."""
        return bind(dead_reckon, self.memory | {"pose": pose}, n=self.n)
