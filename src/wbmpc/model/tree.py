"""A kinematic tree of numbers, read through MuJoCo's compiler (URDF and MJCF alike)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import mujoco
import numpy as np

from wbmpc import lie
from wbmpc.constants import TELESCOPE
from wbmpc.errors import InputError, unknown_name

Kind = Literal["fixed", "revolute", "prismatic"]
_KINDS: dict[mujoco.mjtJoint, Kind] = {
    mujoco.mjtJoint.mjJNT_HINGE: "revolute",
    mujoco.mjtJoint.mjJNT_SLIDE: "prismatic",
}


@dataclass(frozen=True)
class Following:
    """The joint's value is ``ratio`` times that of the joint ``leader``, and ``offset`` [rad or m]."""

    leader: str
    ratio: float
    offset: float


@dataclass(frozen=True)
class Link:
    """A rigid body and the joint before it.

    ``parent``: index of the parent, −1 for the root. The link's frame at joint value 0 is at ``position`` (3) [m] and
    ``rotation`` (3, 3) in the parent's frame; ``axis`` (3) in the link's frame. ``mass`` [kg], ``com`` (3) [m] and
    ``inertia`` (3, 3) [kg m²] about the center of mass, in the link's frame. ``range``: joint limits, infinite if none. ``follows``: what
    the joint is coupled to.
    """

    name: str
    parent: int
    joint: str | None
    kind: Kind
    axis: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    mass: float
    com: np.ndarray
    inertia: np.ndarray
    range: tuple[float, float] = (-np.inf, np.inf)
    follows: Following | None = None


@dataclass(frozen=True)
class Frame:
    """A named frame fixed to a link: pose in the link's frame."""

    link: int
    position: np.ndarray
    rotation: np.ndarray


@dataclass(frozen=True)
class Tree:
    """Links in an order where parents come first; frames of all bodies and sites."""

    links: tuple[Link, ...]
    frames: dict[str, Frame]

    def joint(self, name: str) -> int:
        """Index of the link behind the joint of that name."""
        place = next((i for i, link in enumerate(self.links) if link.joint == name), None)
        if place is None:
            raise unknown_name("joint below the base's body", name, [k.joint for k in self.links if k.joint])
        return place

    def check_moves(self, upper: str, joint: str, where: str) -> None:
        """Raise :class:`InputError` that begins with ``where`` if a joint hangs on another one than ``upper``."""
        at = self.joint(joint)
        while (at := self.links[at].parent) >= 0:
            if self.links[at].joint == upper:
                return
        raise InputError(f"{where}: joint '{upper}' does not move '{joint}'")

    def units(self, names: Sequence[str]) -> tuple[str, ...]:
        """Units of the positions of joints: "m" of those that slide, "rad" of the others."""
        return tuple("m" if self.links[self.joint(n)].kind == "prismatic" else "rad" for n in names)

    def place_on(self, body: str, frame: str) -> tuple[np.ndarray, np.ndarray] | None:
        """Position (3) [m] and rotation (3, 3) of a frame in the axes of a body; None where it is not fixed to it, or there is no such
        frame."""
        if frame not in self.frames:
            return None
        own, link = self.frames[frame], self.frames[body].link
        at, position, rotation = own.link, np.asarray(own.position, float), own.rotation
        while at != link:
            child = self.links[at]
            if child.joint is not None or child.parent < 0:
                return None
            at, position, rotation = child.parent, child.position + child.rotation @ position, child.rotation @ rotation
        return position, rotation

    def zero_poses(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Position (3) [m] and rotation (3, 3) of every link in the root's frame at zero joint values."""
        poses: list[tuple[np.ndarray, np.ndarray]] = []
        for link in self.links:
            position, rotation = (np.zeros(3), np.eye(3)) if link.parent < 0 else poses[link.parent]
            poses.append((position + rotation @ link.position, rotation @ link.rotation))
        return poses

    def section_before(self, link: int) -> int:
        """The link that this one slides on along the same direction, as a telescope's section on the one before; −1: there is none."""
        links, poses, above = self.links, self.zero_poses(), self.links[link].parent
        while above >= 0 and links[above].kind == "fixed":
            above = links[above].parent
        if above < 0 or not links[link].kind == links[above].kind == "prismatic":
            return -1
        one, other = (poses[i][1] @ links[i].axis for i in (link, above))
        return above if abs(float(one @ other)) > TELESCOPE else -1


def read_tree(spec: mujoco.MjSpec, root: str, without: tuple[str, ...] = ()) -> Tree:
    """The tree of MuJoCo's ``spec`` below the body ``root`` (its own joint, if any, is left to the base model), bodies ``without`` left out."""
    model = spec.compile()
    start = model.body(root).id
    index: dict[int, int] = {}
    links: list[Link] = []
    for body in range(start, model.nbody):
        name = model.body(body).name
        parent = int(model.body_parentid[body])
        if name in without or (body != start and parent not in index):
            continue
        chain = _links_of_body(model, body, -1 if body == start else index[parent], len(links), body == start)
        links += chain
        index[body] = len(links) - 1
    frames = {}
    for body, link in index.items():
        frames[model.body(body).name] = Frame(link, np.zeros(3), np.eye(3))
    for site in range(model.nsite):
        body = int(model.site_bodyid[site])
        if body in index:
            rotation = lie.quaternion_to_rotation(model.site_quat[site].copy())
            frames[model.site(site).name] = Frame(index[body], model.site_pos[site].copy(), rotation)
    following = _followers(model)
    return Tree(tuple(replace(k, follows=following.get(k.joint or "")) for k in links), frames)


def _followers(model: mujoco.MjModel) -> dict[str, Following]:
    """By joint, what the specification couples: see :func:`wbmpc.robots.couplings.couple`."""
    found = {}
    for e in range(model.neq):
        if int(model.eq_type[e]) == int(mujoco.mjtEq.mjEQ_JOINT):
            offset, ratio = (float(v) for v in model.eq_data[e][:2])
            follower, leader = (model.joint(int(k)).name for k in (model.eq_obj1id[e], model.eq_obj2id[e]))
            found[follower] = Following(leader, ratio, offset)
    return found


def _links_of_body(model: mujoco.MjModel, body: int, parent: int, first: int, is_root: bool) -> list[Link]:
    """One link per joint of a body (massless but for the last), or one fixed link."""
    axes = lie.quaternion_to_rotation(model.body_iquat[body].copy())
    inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
    body_data = (float(model.body_mass[body]), model.body_ipos[body].copy(), inertia)
    nothing = (0.0, np.zeros(3), np.zeros((3, 3)))
    position = np.zeros(3) if is_root else model.body_pos[body].copy()
    rotation = np.eye(3) if is_root else lie.quaternion_to_rotation(model.body_quat[body].copy())
    name = model.body(body).name
    first_joint, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    if is_root or count == 0:
        return [Link(name, parent, None, "fixed", np.zeros(3), position, rotation, *body_data)]
    links = []
    for k in range(count):
        j = first_joint + k
        kind = _KINDS.get(mujoco.mjtJoint(int(model.jnt_type[j])))
        joint = model.joint(j).name
        if kind is None:
            raise InputError(
                f"joint '{joint}': only hinge and slide joints are possible in the tree of the arm and legs"
            )
        low, high = model.jnt_range[j]
        last = k == count - 1
        if kind == "revolute" and np.any(model.jnt_pos[j]):
            raise InputError(f"joint '{joint}': its axis must go through the origin of its body")
        data = body_data if last else nothing
        links.append(
            Link(
                name=name if last else f"{name}.{joint}", parent=parent if k == 0 else first + k - 1, joint=joint,
                kind=kind, axis=model.jnt_axis[j].copy(), position=position if k == 0 else np.zeros(3),
                rotation=rotation if k == 0 else np.eye(3), mass=data[0], com=data[1], inertia=data[2],
                range=(float(low), float(high)) if model.jnt_limited[j] else (-np.inf, np.inf),
            )
        )  # fmt: skip
    return links
