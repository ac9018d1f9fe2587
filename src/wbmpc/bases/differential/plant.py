"""A differential drive in MuJoCo: driven tires, and ball casters on springs.

Level casters that are rigid would lift the driven wheels off the floor wherever it or the robot is not exact. Here each stands on a
spring that carries a share of the weight at level height; it touches the floor without friction.
"""

from __future__ import annotations

import mujoco
import numpy as np

from wbmpc.bases.differential.model import caster_places
from wbmpc.bases.planar_motion.plant import PlanarPlant, contact_settings
from wbmpc.constants import GRAVITY
from wbmpc.simulation.contacts import FLOOR
from wbmpc.simulation.world import Array

#: Half width [m] of a tire.
HALF_WIDTH = 0.02
#: All casters together carry this share of the weight when the base is level; how far [m] their springs are pressed in by that;
#: damping ratio; mass [kg] and radius (share of the wheels') of a caster.
SHARE, TRAVEL, DAMPING = 0.3, 0.0015, 1.0
_MASS, _SIZE = 0.5, 0.4


class DifferentialPlant(PlanarPlant):
    """Physics, drives and sensors of a robot with a differential drive."""

    def add_wheel(self, spec: mujoco.MjSpec, index: int, radius: float, friction: list[float]) -> None:
        add_tire(spec.joint(self.base.wheels[index]), radius, friction)

    def add_supports(self, spec: mujoco.MjSpec, weight: float) -> None:
        add_casters(self, spec, weight, caster_places(self.description, self.model_base.geometry))


def add_tire(joint: mujoco.MjsJoint, radius: float, friction: list[float]) -> None:
    """An ellipsoid about a wheel's axis: cylinders take the load off wheels in combined motion."""
    turned = np.zeros(4)
    mujoco.mju_quatZ2Vec(turned, np.asarray(joint.axis, float))
    joint.parent.add_geom(
        name=f"tire_{joint.name}", type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, size=[radius, radius, HALF_WIDTH], quat=turned, mass=0,
        **contact_settings(friction),
    )  # fmt: skip


def add_casters(plant: PlanarPlant, spec: mujoco.MjSpec, weight: float, at: Array) -> None:
    """Ball casters on springs at (n, 2) [m] in the axes of the body, of a robot of ``weight`` [N]."""
    load, radius = SHARE * weight / len(at), _SIZE * plant.model_base.geometry.radius
    stiffness = load / TRAVEL
    damping = 2.0 * DAMPING * np.sqrt(stiffness * load / GRAVITY)
    for i, (x, y) in enumerate(at):
        body = spec.body(plant.base.body).add_body(
            name=f"wbmpc_caster_{i}", pos=[x, y, radius - plant.model_base.geometry.height]
        )
        body.add_joint(
            name=f"wbmpc_caster_{i}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1], stiffness=[stiffness, 0, 0],
            damping=[damping, 0, 0], springref=-TRAVEL,
        )  # fmt: skip
        settings = {
            **contact_settings([0.0, 0.0, 0.0]),
            "conaffinity": FLOOR,  # the robot's file has none: where they are is assumed
            "condim": 1,
            "priority": 1,
            "rgba": [0.2, 0.2, 0.2, 1.0],
            "group": 1,
        }
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], mass=_MASS, **settings)
