"""A round tip on an end effector, a force sensor behind it, and the forces of contacts."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.simulation.contacts import TOOL

#: Radius [m] and mass [kg] of a tip; softness of the contact of one of rubber (time constant [s], damping ratio).
TIP_RADIUS, TIP_MASS, SOFT = 0.02, 0.05, (0.02, 1.0)
#: Of the tip's body, geom and spring, and of the sensor behind it.
TIP, FORCE = "hand_tip", "hand_force"


@dataclass(frozen=True)
class ForceSensor:
    """Three axes between end effector and tip, averaged between messages: noise (standard deviation) [N] of a message, and a constant
    ``bias`` [N], drawn within ± this for each axis (what is left after zeroing)."""

    noise: float = 0.1
    bias: float = 0.1


def add_tip(
    spec: mujoco.MjSpec, tool: str, grip: float, contact: tuple[float, float] = SOFT, spring: float = 0.0
) -> None:
    """A tip with the friction coefficient ``grip`` at the site ``tool``, with a force sensor in the end effector's axes; ``contact``: time
    constant [s] and damping ratio. With a ``spring`` [N/m] it slides along the z axis of the tool, critically damped."""
    site = next((s for s in spec.sites if s.name == tool), None)
    if site is None:
        raise InputError(f"tip: the end effector '{tool}' must be a site of the robot's file")
    tip = site.parent.add_body(name=TIP, pos=site.pos, quat=site.quat)
    tip.explicitinertial, tip.mass, tip.ipos = True, TIP_MASS, [0, 0, 0]
    tip.inertia = [0.4 * TIP_MASS * TIP_RADIUS**2] * 3
    if spring > 0.0:
        joint = tip.add_joint(name=TIP, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1])
        joint.stiffness, joint.damping = [spring, 0, 0], [2.0 * np.sqrt(spring * TIP_MASS), 0, 0]
    tip.add_site(name=FORCE)
    tip.add_geom(
        name=TIP, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[TIP_RADIUS, 0, 0], mass=0, condim=3,
        friction=[grip, 0.005, 1e-4], solref=contact, rgba=[0.1, 0.1, 0.1, 1], **TOOL,
    )  # fmt: skip
    spec.add_sensor(name=FORCE, type=mujoco.mjtSensor.mjSENS_FORCE, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=FORCE)


def contacts_between(data: mujoco.MjData, first: int, second: int) -> list[int]:
    """Indices in ``data.contact`` of the contacts of two geoms. All at once: a look at each takes longer than a physics step."""
    if not data.ncon:
        return []
    geoms = data.contact.geom
    return np.flatnonzero((geoms == (first, second)).all(1) | (geoms == (second, first)).all(1)).tolist()


def contact_force(model: mujoco.MjModel, data: mujoco.MjData, first: int, second: int) -> Array:
    """The force (3) [N] of the geom ``first`` on the geom ``second``, world axes, in the step that MuJoCo has just done: as soon as it
    looks for the contacts of the next one, their forces are not yet any numbers in particular."""
    total, local = np.zeros(3), np.zeros(6)
    for c in contacts_between(data, first, second):
        contact = data.contact[c]
        mujoco.mj_contactForce(model, data, c, local)
        force = contact.frame.reshape(3, 3).T @ local[:3]  # on geom2, by geom1
        total += force if contact.geom2 == second else -force
    return total
