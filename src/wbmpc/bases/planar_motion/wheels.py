"""Wheels that are fixed to the body: where they are, how they roll, and the matrix from the body's twist to their rates.

A wheel at p rolls along d at a positive rate; the axles of its rollers lie, where they touch the ground, along
a = d cos γ + s sin γ with s = ẑ × d (γ = 0 for omni wheels; a tire has none). Only motion along a is passed on, so that
a · (v + ω ẑ × p) = r q̇ a · d: the rate is q̇ = (d + s tan γ) · (v + ω ẑ × p) / r. For a mecanum wheel at (lx, ly) with γ = ∓45
degrees the lever of ω is lx + ly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.planar_motion.description import PlanarBaseDescription
from wbmpc.errors import InputError
from wbmpc.model.tree import Tree
from wbmpc.robots import RobotDescription
from wbmpc.robots.wheel_geometry import drawn_radius

#: Wheels that differ by more [m] in height leave the robot standing on some of them; radii read from shapes may differ by as much.
_LEVEL = 0.001
#: A wheel's axis may be so far [rad] from horizontal.
_HORIZONTAL = 1e-3


@dataclass(frozen=True)
class FixedWheels:
    """Geometry of n wheels in the axes of the body.

    ``position`` (n, 2) [m] of their centers; ``heading`` (n) [rad]: direction in which they roll at a positive rate; ``radius``
    [m]; ``height`` [m] of the body's frame above the ground.
    """

    position: Array
    heading: Array
    radius: float
    height: float

    @property
    def forward(self) -> Array:
        """Rolling directions (n, 2)."""
        return np.stack([np.cos(self.heading), np.sin(self.heading)], axis=1)

    @property
    def side(self) -> Array:
        """Directions (n, 2) to the left of the rolling directions: along the axles."""
        return np.stack([-np.sin(self.heading), np.cos(self.heading)], axis=1)

    def along(self, direction: Array) -> Array:
        """Matrix (n, 3) from the body's twist (vx, vy, ω) to the velocity [m/s] of each wheel's center along ``direction`` (n, 2)."""
        p = self.position
        lever = p[:, 0] * direction[:, 1] - p[:, 1] * direction[:, 0]
        return np.column_stack([direction, lever])

    def rates(self, roller: Array) -> Array:
        """Matrix (n, 3) from the body's twist to wheel rates [rad/s]; ``roller`` (n) [rad]: angle γ of the rollers' axles."""
        return self.along(self.forward + np.tan(roller)[:, None] * self.side) / self.radius


def wheel_radius(description: RobotDescription, model: mujoco.MjModel) -> float:
    """Radius [m] of the wheels: the description's, or that of the shapes. Raises :class:`InputError` where there is none."""
    base = section(description)
    if base.wheel_radius is not None:
        return base.wheel_radius
    radii = [drawn_radius(description, model, wheel) for wheel in base.wheel_joints()]
    known = [r for r in radii if r is not None]
    if len(known) < len(radii) or max(known) - min(known) > _LEVEL:
        seen = ", ".join(
            f"'{w}' {'unknown' if r is None else f'{r:.4g} m'}" for w, r in zip(base.wheel_joints(), radii, strict=True)
        )
        raise InputError(
            f"{description.source}: key 'base.wheel_radius' is needed: the shapes in {description.model} do not show one radius ({seen})"
        )
    return float(np.mean(known))


def check_wheels(description: RobotDescription, model: mujoco.MjModel) -> None:
    """Raise :class:`InputError` for joints that are no wheels."""
    base, limits = section(description), description.limits
    for wheel in base.wheel_joints():
        joint = model.joint(wheel)
        if joint.type[0] != mujoco.mjtJoint.mjJNT_HINGE:
            raise InputError(
                f"{description.source}: key 'base.wheels': joint '{wheel}' does not turn; valid: hinge joints"
            )
        if wheel in limits.position or model.jnt_limited[joint.id]:
            raise InputError(
                f"{description.source}: key 'base.wheels': joint '{wheel}' has a range; a wheel turns without end (in a URDF: "
                "type continuous)"
            )


def read_wheels(description: RobotDescription, tree: Tree, radius: float) -> FixedWheels:
    """Geometry from the tree at zero joint angles. Raises :class:`InputError` for axes that are not horizontal and for wheels
    that do not stand on one level."""
    base, poses = section(description), tree.zero_poses()
    position, heading, height = [], [], []
    for name in base.wheel_joints():
        link = tree.joint(name)
        center, rotation = poses[link]
        axle = rotation @ tree.links[link].axis
        if abs(axle[2]) > _HORIZONTAL:
            raise InputError(
                f"{description.source}: key 'base.wheels': the axis of wheel '{name}' must be horizontal, it is inclined by "
                f"{np.degrees(np.arcsin(abs(axle[2]))):.2g} deg"
            )
        position.append(center[:2])
        heading.append(float(np.arctan2(-axle[0], axle[1])))  # rolling direction = axle × up
        height.append(radius - float(center[2]))
    _check_level(description, base.wheel_joints(), np.array(height))
    return FixedWheels(np.array(position), np.array(heading), radius, float(np.mean(height)))


def _check_level(description: RobotDescription, wheels: Sequence[str], height: Array) -> None:
    """All wheels touch even ground. ``height`` (n) [m]: of the body's frame over the lowest point of each."""
    if np.ptp(height) <= _LEVEL:
        return
    above = np.max(height) - height
    odd = int(np.argmax(above))
    raise InputError(
        f"{description.source}: key 'base.wheels': the wheels do not stand on one level: '{wheels[odd]}' hangs "
        f"{1e3 * above[odd]:.3g} mm above the lowest, wheels may differ by {1e3 * _LEVEL:g} mm"
    )


def section(description: RobotDescription) -> PlanarBaseDescription:
    assert isinstance(description.base, PlanarBaseDescription)
    return description.base
