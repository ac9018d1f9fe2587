"""What a robot carries and where it stands: masses at the tool and on the body, a sloping floor, cables on it. The planner knows of
none."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from wbmpc.stability import slope_gravity

#: Radius [m] of the ball that is a payload; half sizes [m] of the box that is a payload on the body, and its center above that
#: of the body.
PAYLOAD_RADIUS, BOX, BOX_HEIGHT = 0.05, (0.3, 0.25, 0.1), 0.24
#: Distance [m] between cables on the floor.
CABLES = 0.2
_COLOR = [0.9, 0.6, 0.1, 1.0]
PAYLOAD, BODY_PAYLOAD = "payload", "body_payload"


def add_payload(spec: mujoco.MjSpec, tool: str, mass: float) -> None:
    """A ball of ``mass`` [kg] with its center at the tool (a site or a body); it touches nothing."""
    site = next((s for s in spec.sites if s.name == tool), None)
    parent, pos = (spec.body(tool), np.zeros(3)) if site is None else (site.parent, site.pos)
    inertia = [mass * 0.4 * PAYLOAD_RADIUS**2] * 3
    _add(parent, PAYLOAD, pos, mass, inertia, mujoco.mjtGeom.mjGEOM_SPHERE, [PAYLOAD_RADIUS, 0, 0])


def add_body_payload(spec: mujoco.MjSpec, body: str, mass: float) -> None:
    """A box of ``mass`` [kg] on a body; it touches nothing."""
    square = np.array(BOX) ** 2
    inertia = mass / 3.0 * (square.sum() - square)
    _add(spec.body(body), BODY_PAYLOAD, [0.0, 0.0, BOX_HEIGHT], mass, inertia, mujoco.mjtGeom.mjGEOM_BOX, BOX)


def _add(
    parent: mujoco.MjsBody, name: str, pos: ArrayLike, mass: float, inertia: ArrayLike, shape: mujoco.mjtGeom,
    size: ArrayLike,
) -> None:  # fmt: skip
    body = parent.add_body(name=name, pos=pos)
    # an unset ipos would become the body's pos
    body.explicitinertial, body.mass, body.ipos, body.inertia = True, mass, [0, 0, 0], inertia
    body.add_geom(type=shape, size=size, mass=0, contype=0, conaffinity=0, rgba=_COLOR)


def incline(spec: mujoco.MjSpec, slope: float, downhill: float) -> None:
    """Stand on a floor that falls by ``slope`` [rad] in the direction ``downhill`` [rad]: the frame of the world stays that of
    the floor, gravity turns."""
    size = float(np.linalg.norm(spec.option.gravity))
    spec.option.gravity = slope_gravity(slope, downhill + np.pi, size)


def lay_cables(spec: mujoco.MjSpec, height: float, friction: ArrayLike, solref: ArrayLike, **masks: Any) -> None:
    """A grid of cables that rise ``height`` [m] above the floor, :data:`CABLES` apart in both directions; a robot at the origin
    stands between them. ``masks``: what they touch."""
    for at in CABLES * (np.arange(-4, 4) + 0.5):
        for ends in ([at, -1.0, 0.0, at, 1.0, 0.0], [-1.0, at, 0.0, 1.0, at, 0.0]):
            spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=ends, size=[height, 0, 0], condim=4, friction=friction,
                solref=solref, rgba=[0.2, 0.2, 0.2, 1.0], **masks,
            )  # fmt: skip
