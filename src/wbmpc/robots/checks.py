"""What a robot's file must be so that planner and simulator mean the same machine by it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from wbmpc.errors import InputError

if TYPE_CHECKING:
    from wbmpc.robots.description import RobotDescription

#: Of a compiled model: kind of element, array, what it is, and its largest possible magnitude.
_NUMBERS = (
    ("body", "body_pos", "its position [m]", 1e4), ("body", "body_quat", "its orientation", 2.0),
    ("body", "body_mass", "its mass [kg]", 1e7), ("body", "body_inertia", "its moment of inertia [kg m²]", 1e10),
    ("body", "body_ipos", "its center of mass [m]", 1e4), ("body", "body_iquat", "its inertial frame", 2.0),
    ("joint", "jnt_pos", "its position [m]", 1e4), ("joint", "jnt_axis", "its axis", 2.0),
    ("joint", "jnt_range", "its range", 1e8), ("geom", "geom_pos", "its position [m]", 1e4),
    ("geom", "geom_size", "its size [m]", 1e6), ("site", "site_pos", "its position [m]", 1e4),
)  # fmt: skip


def compiled(spec: mujoco.MjSpec, path: object) -> mujoco.MjModel:
    """The file as MuJoCo takes it. Raises :class:`InputError` with its name where it does not, or has numbers of no machine."""
    try:
        model = spec.compile()
    except ValueError as error:
        raise InputError(f"{path}: cannot be compiled: {' '.join(str(error).split())}") from error
    for kind, name, what, largest in _NUMBERS:
        values = getattr(model, name)
        wrong = np.argwhere(~(np.abs(values) <= largest))
        if len(wrong):
            k = wrong[0][0]
            element = mujoco.mj_id2name(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), int(k)) or f"number {k}"
            raise InputError(
                f"{path}: {kind} '{element}': {what} is {values[tuple(wrong[0])]:.4g}; at most {largest:g} is possible"
            )
    return model


@contextmanager
def named(path: object) -> Iterator[None]:
    """While a plant adds what is its own: what MuJoCo does not take, as two elements of a name, is an :class:`InputError` with the
    robot's file."""
    try:
        yield
    except ValueError as error:
        if not str(error).startswith("Error:"):  # MuJoCo's own begin so
            raise
        raise InputError(f"{path}: cannot be simulated: {' '.join(str(error).split())}") from error


def check_joints(description: RobotDescription, model: mujoco.MjModel) -> None:
    """Every joint below the base moves by the description's will or not at all, and counts from where the file draws its body.

    A joint that is in no list would be free in the simulator and rigid in the planner. Raises :class:`InputError`.
    """
    listed, own = {*description.joints(), *description.couple}, set(description.base.parts().values())
    left = []
    for joint in range(model.njnt):
        body = int(model.jnt_bodyid[joint])
        if not _below(model, body, description.base.body) or model.body(body).name in own:
            continue
        name = model.joint(joint).name
        if not name:
            raise InputError(f"{description.model}: body '{model.body(body).name}' has a joint without a name")
        reject_reference(description.model, name, model.qpos0[model.jnt_qposadr[joint]])
        if name not in listed:
            left.append(name)
    if left:
        names, hold = ", ".join(f"'{n}'" for n in left), ", ".join(f"{n}: 0" for n in left)
        which, them = (f"joint {names} of", "it") if len(left) == 1 else (f"joints {names} of", "them")
        raise InputError(
            f"{description.source}: {which} {description.model} can move, but no key names {them}: "
            f"name {them} in {description.joint_keys(' or ')}, or hold {them} with 'fixed_joints: {{{hold}}}' [rad or m]"
        )


def check_tool(description: RobotDescription, model: mujoco.MjModel) -> None:
    """The arm moves its tool, and a base that moves is a body. Raises :class:`InputError` naming file and key."""
    source, body = description.source, description.base.body
    if description.base.moves and model.body(body).id == 0:
        raise InputError(f"{source}: key 'base.body': '{body}' does not move; the body of the robot's base is needed")
    name = description.arm.tool
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name)
    at = model.body(name).id if site < 0 else int(model.site_bodyid[site])
    moving = {int(model.joint(j).bodyid[0]) for j in description.arm.joints}
    while at and at not in moving:
        at = int(model.body_parentid[at])
    if not at:
        raise InputError(
            f"{source}: key 'arm.tool': '{name}' is not moved by the arm's joints; a frame that one of them moves is needed"
        )


def reject_reference(path: object, joint: str, reference: float) -> None:
    """A joint's value where its body is drawn (``ref`` of an MJCF) must be 0: planner, locks and calibrations count from there."""
    if reference:
        raise InputError(
            f"{path}: joint '{joint}' has a 'ref' of {reference:.4g}: it must be 0, draw its body where the joint's value is 0"
        )


def _below(model: mujoco.MjModel, body: int, base: str) -> bool:
    """Whether a body hangs, directly or not, on the body called ``base``."""
    root = model.body(base).id
    while body > 0 and body != root:
        body = int(model.body_parentid[body])
        if body == root:
            return True
    return False
