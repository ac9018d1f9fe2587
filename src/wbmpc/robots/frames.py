"""Names of a robot's frames on a bus, in its URDF and in recordings (REP 105): one tree ``map`` → ``odom`` → ``base_link`` → links.

Links are called like the bodies of the robot's file, but for the base, and for those whose name is taken by another frame.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from wbmpc.robots.description import RobotDescription, load_spec

MAP, ODOM, BASE = "map", "odom", "base_link"
#: What is put before the name of a link that another frame has; behind that of a point on a link.
PREFIX, SUFFIX = "arm_", "_frame"


@dataclass(frozen=True)
class FixedFrame:
    """A point on a link: its ``parent``'s frame, and its ``pose`` (7) in it (position [m], quaternion)."""

    name: str
    parent: str
    pose: np.ndarray


def frame_names(base_body: str, bodies: Iterable[str], base: str = BASE, world: str = ODOM) -> dict[str, str]:
    """The frame of each body: ``base`` is that of ``base_body``; others called like it, ``world`` or ``map`` get a prefix."""
    listed = list(bodies)
    taken = {base, world, MAP, *(b for b in listed if b != base_body)}
    names = {base_body: base}
    for body in listed:
        if body == base_body:
            continue
        name = body
        while name in (base, world, MAP) or (name != body and name in taken):
            name = PREFIX + name
        taken.add(name)
        names[body] = name
    return names


def free_name(name: str, taken: set[str]) -> str:
    """A name for another frame, with a suffix where it is ``taken``, to which it is added."""
    while name in taken:
        name += SUFFIX
    taken.add(name)
    return name


def fixed_frames(description: RobotDescription, base: str = BASE, world: str = ODOM) -> list[FixedFrame]:
    """Named points on the links of a robot: tool, mount, inertial unit. A URDF has links for them."""
    model = load_spec(description).compile()
    bodies = [model.body(i).name for i in range(1, model.nbody)]
    names = frame_names(description.base.body, bodies, base, world)
    taken, found = {base, world, MAP, *names.values()}, []
    for i in range(model.nsite):
        site = model.site(i)
        parent = model.body(int(site.bodyid[0])).name
        if site.name and parent in names:
            name = free_name(site.name, taken)
            found.append(FixedFrame(name, names[parent], np.concatenate([site.pos, site.quat])))
    return found
