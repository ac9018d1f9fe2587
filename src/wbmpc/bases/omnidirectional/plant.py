"""Omni and mecanum wheels in MuJoCo: each roller is a body of its own on a passive hinge.

(MuJoCo fixes the tangents of a contact in the world, so that anisotropic friction cannot stand for rollers.) The rollers of a wheel
stand in one ring and pass through each other, as those of the two rows of a real omni wheel do side by side. A roller is an
ellipsoid of revolution with half length L and radius ρ, whose axle is h = R − ρ from the wheel's axis. When the wheel has turned by
θ, the lowest point of the roller is h cos θ + √(ρ² + (L² − ρ²) cos²γ sin²θ) below the axis: constant to the third order in θ
with L² = ρ² + h ρ / cos²γ.
"""

from __future__ import annotations

import mujoco
import numpy as np

from wbmpc import lie
from wbmpc.bases.omnidirectional.model import roller_angles
from wbmpc.bases.planar_motion.plant import PlanarPlant, contact_settings
from wbmpc.simulation.contacts import ROLLER

#: Rollers of a wheel: with 16, a mecanum or omni wheel of 0.1 m runs out of round by less than 0.1 mm.
ROLLERS = 16
#: Radius of a roller as a share of the wheel's; share of the wheel's mass that all its rollers have.
SIZE, MASS = 0.2, 0.3
#: Damping [N m s/rad] and rotor inertia [kg m²] of a roller's hinge.
_DAMPING, _ARMATURE = 1e-4, 1e-5


class OmnidirectionalPlant(PlanarPlant):
    """Physics, drives and sensors of a robot on wheels with rollers."""

    def add_wheel(self, spec: mujoco.MjSpec, index: int, radius: float, friction: list[float]) -> None:
        add_rollers(spec, spec.joint(self.base.wheels[index]), radius, self._angles()[index], friction)

    def _angles(self) -> np.ndarray:
        return roller_angles(self.description, self.model_base.geometry)


def add_rollers(
    spec: mujoco.MjSpec, joint: mujoco.MjsJoint, radius: float, angle: float, friction: list[float]
) -> None:
    """The rollers of the wheel on a joint, whose axles are at ``angle`` [rad]; they take over a share of its mass."""
    wheel, roller = joint.parent, SIZE * radius
    rim = radius - roller
    length = float(np.sqrt(roller**2 + rim * roller / np.cos(angle) ** 2))
    mass = _take_mass(spec, wheel)
    for k in range(ROLLERS):
        position, axle = _seat(joint, rim, angle, 2.0 * np.pi * k / ROLLERS)
        turned = np.zeros(4)
        mujoco.mju_quatZ2Vec(turned, axle)
        name = f"{joint.name}_roller_{k}"
        body = wheel.add_body(name=name, pos=position, quat=turned)
        body.add_joint(
            name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1], damping=[_DAMPING, 0, 0], armature=_ARMATURE,
        )  # fmt: skip
        settings = {**contact_settings(friction), **ROLLER, "rgba": [0.25, 0.25, 0.28, 1.0], "group": 1}
        body.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, size=[roller, roller, length], mass=mass, **settings
        )


def _take_mass(spec: mujoco.MjSpec, wheel: mujoco.MjsBody) -> float:
    """Mass [kg] of a roller; that of the wheel's own body becomes less by all of them."""
    nominal = spec.compile().body(wheel.name)
    wheel.explicitinertial, wheel.fullinertia = True, np.full(6, np.nan)
    wheel.mass, wheel.inertia = (1.0 - MASS) * nominal.mass[0], (1.0 - MASS) * nominal.inertia
    wheel.ipos, wheel.iquat = nominal.ipos, nominal.iquat
    return float(MASS * nominal.mass[0] / ROLLERS)


def _seat(joint: mujoco.MjsJoint, rim: float, angle: float, turn: float) -> tuple[np.ndarray, np.ndarray]:
    """Position (3) [m] and axle (3) of a roller in the axes of its wheel: ``turn`` [rad] about the wheel's axis, ``rim`` [m]
    from it, its axle turned by ``angle`` [rad] from the wheel's circumference to the wheel's axis."""
    axis = np.asarray(joint.axis, float) / np.linalg.norm(joint.axis)
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    down = np.cross(axis, other) / np.linalg.norm(np.cross(axis, other))
    down = lie.quaternion_to_rotation(lie.quaternion_about(axis, turn)) @ down
    # at the lowest point the rolling direction is axis × up
    return rim * down, np.cos(angle) * np.cross(axis, -down) + np.sin(angle) * axis
