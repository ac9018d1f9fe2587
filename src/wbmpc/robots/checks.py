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

#: How far [of its radius] a ball's centre of mass, joint and frame may be from the origin of the base's frame.
OFF_CENTRE = 1e-3
#: How much the moments of inertia of a ball may differ [of the largest], and its axes from the base's [rad].
UNEVEN, TURNED = 0.01, 1e-3


def compiled(spec: mujoco.MjSpec, path: object) -> mujoco.MjModel:
    """The file as MuJoCo takes it. Raises :class:`InputError` with its name where it does not."""
    try:
        return spec.compile()
    except ValueError as error:
        raise InputError(f"{path}: cannot be compiled: {' '.join(str(error).split())}") from error


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
    listed, ball = set(description.joints()), getattr(description.base, "ball", None)
    left = []
    for joint in range(model.njnt):
        body = int(model.jnt_bodyid[joint])
        if not _below(model, body, description.base.body) or model.body(body).name == ball:
            continue
        name = model.joint(joint).name
        if not name:
            raise InputError(f"{description.model}: body '{model.body(body).name}' has a joint without a name")
        refuse_reference(description.model, name, model.qpos0[model.jnt_qposadr[joint]])
        if name not in listed:
            left.append(name)
    if left:
        names, hold = ", ".join(f"'{n}'" for n in left), ", ".join(f"{n}: 0" for n in left)
        which, them = (f"joint {names} of", "it") if len(left) == 1 else (f"joints {names} of", "them")
        lists = "arm.joints or base.modules" if hasattr(description.base, "modules") else "arm.joints"
        raise InputError(
            f"{description.source}: {which} {description.model} can move, but no key names {them}: "
            f"name {them} in {lists}, or hold {them} with 'lock: {{{hold}}}' [rad or m]"
        )


def check_tool(description: RobotDescription, model: mujoco.MjModel) -> None:
    """The arm moves its tool, and a base that moves is a body. Raises :class:`InputError` naming file and key."""
    source, body = description.source, description.base.body
    if description.base.type != "fixed" and model.body(body).id == 0:
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


def refuse_truths(value: object, source: object, key: str = "") -> None:
    """Raise :class:`InputError` for true or false (YAML: yes, on, no, off) where a file needs a number or a name."""
    if isinstance(value, bool) and key != "base.payload":
        raise InputError(f"{source}: key '{key}': a number or text is needed, not true or false")
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for name, inner in inside:
        refuse_truths(inner, source, f"{key}.{name}" if key else str(name))


def refuse_reference(path: object, joint: str, reference: float) -> None:
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


def check_ball(description: RobotDescription, model: mujoco.MjModel) -> None:
    """A ball that rolls about the origin of the base's frame, with the same inertia about every axis.

    That is what the equations of :mod:`wbmpc.model.ball` and the drives of the simulator are about; a ball elsewhere would
    be lost at once. The frame is not moved to the ball: poses are published of it, and a URDF says where it is.
    Raises :class:`InputError`.
    """
    base = description.base
    name, near = getattr(base, "ball", None), OFF_CENTRE * getattr(base, "ball_radius", 0.0)
    if name is None:
        return
    ball = model.body(name).id
    where = f"{description.model}: body '{name}' (key 'base.ball')"
    if int(model.body_parentid[ball]) != model.body(base.body).id:
        raise InputError(f"{where}: a ball needs to hang on the base's body '{base.body}' directly")
    kinds = [mujoco.mjtJoint(int(k)) for k in model.jnt_type[model.body_jntadr[ball] :][: model.body_jntnum[ball]]]
    if kinds != [mujoco.mjtJoint.mjJNT_BALL]:
        has = ", ".join(k.name.removeprefix("mjJNT_").lower() for k in kinds) or "none"
        raise InputError(f"{where}: one joint of type ball (spherical in a URDF) is needed, it has {has}")
    if model.jnt_limited[model.body_jntadr[ball]]:
        raise InputError(f"{where}: its joint has a range, at whose end the ball would stop: take it out of the file")
    offset = model.body_pos[ball] + model.jnt_pos[model.body_jntadr[ball]]
    if np.linalg.norm(offset) > near:
        raise InputError(
            f"{where}: the frame of '{base.body}' needs its origin at the ball's centre, which is at {_metres(offset)} in it: "
            "move the frame in the file"
        )
    if 2.0 * np.arccos(min(abs(float(model.body_quat[ball][0])), 1.0)) > TURNED:
        raise InputError(f"{where}: the ball's frame needs the same axes as '{base.body}' (its shapes may be turned)")
    _check_mass(model, ball, where, near)


def _check_mass(model: mujoco.MjModel, ball: int, where: str, near: float) -> None:
    """The ball is one body, and like a ball however it is turned."""
    if model.body_subtreemass[ball] > model.body_mass[ball] * (1.0 + 1e-9):
        raise InputError(f"{where}: bodies with mass hang on it; its mass and inertia need to be in the ball itself")
    if np.linalg.norm(model.body_ipos[ball]) > near:
        raise InputError(
            f"{where}: its centre of mass is at {_metres(model.body_ipos[ball])}, beside its centre: such a ball rolls by itself"
        )
    inertia = model.body_inertia[ball]
    if np.ptp(inertia) > UNEVEN * inertia.max():
        numbers = ", ".join(f"{v:.4g}" for v in inertia)
        raise InputError(
            f"{where}: its moments of inertia {numbers} kg m² differ by more than {100 * UNEVEN:g} %; a ball has one"
        )


def _metres(vector: np.ndarray) -> str:
    return f"({', '.join(f'{v:g}' for v in np.round(vector, 6))}) m"
