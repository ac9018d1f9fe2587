"""Joints that move together, as the stages of a telescope: the ``couple`` key of a robot file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any

import mujoco
import numpy as np
from pydantic import BeforeValidator, Field

from wbmpc.bases.base import Section
from wbmpc.errors import InputError, unknown_name
from wbmpc.robots.checks import compiled

if TYPE_CHECKING:
    from wbmpc.robots.description import LimitsDescription, RobotDescription

#: Of the simulated coupling: time constant [s], damping ratio.
STIFF = [0.004, 1.0]


class Coupling(Section):
    """The joint's value is ``ratio`` times that of ``joint``, and ``offset`` [rad or m]."""

    joint: str
    ratio: float = Field(1.0, ge=-1e3, le=1e3)
    offset: float = Field(0.0, ge=-1e3, le=1e3)


def _of_a_name(value: Any) -> Any:
    return {"joint": value} if isinstance(value, str) else value


#: In a file: a joint's name alone for a ratio of 1.
Coupled = Annotated[Coupling, BeforeValidator(_of_a_name)]


def check_couplings(description: RobotDescription) -> None:
    """Followers are no joints of arm or base, and follow one of the arm. Raises ``ValueError`` naming the key."""
    for follower, coupling in description.couple.items():
        keys = {
            description.joint_keys(" or "): description.joints(), "fixed_joints": description.fixed_joints, "home": description.home,
        }  # fmt: skip
        if named := [key for key, joints in keys.items() if follower in joints]:
            raise ValueError(
                f"key 'couple.{follower}': what follows is not in {named[0]} too: take it out of one of the two"
            )
        if coupling.joint not in description.arm.joints:
            raise ValueError(
                f"key 'couple.{follower}': '{coupling.joint}' is no joint of the arm; valid: {', '.join(description.arm.joints)}"
            )
        if coupling.ratio == 0.0:
            raise ValueError(f"key 'couple.{follower}.ratio': 0 does not move it; hold it with 'fixed_joints'")
    if description.couple and description.base.uses_inertia:
        raise ValueError(
            f"key 'couple': a base of type {description.base.type} plans forces, and knows none of couplings"
        )


def couple(spec: mujoco.MjSpec, couplings: Mapping[str, Coupling], source: str) -> None:
    """Couple joints of a specification: planner and simulator read it there. Raises :class:`InputError` naming file and key."""
    known = [j.name for j in spec.joints]
    for follower, c in couplings.items():
        for name in (follower, c.joint):
            if name not in known:
                raise unknown_name("joint (key 'couple')", name, known, where=source)
        data = np.zeros(mujoco.mjNEQDATA)
        data[:2] = c.offset, c.ratio
        spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT, name1=follower, name2=c.joint, data=data, solref=STIFF,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
        )  # fmt: skip


def limits_of_leaders(description: RobotDescription, spec: mujoco.MjSpec) -> LimitsDescription:
    """The limits, those of leaders narrowed to what their followers can."""
    limits, model = description.limits, compiled(spec, description.model)
    position, velocity, acceleration = dict(limits.position), dict(limits.velocity), dict(limits.acceleration)
    for follower, c in description.couple.items():
        low, high = position.get(c.joint) or _range(model, c.joint)
        ends = sorted((end - c.offset) / c.ratio for end in limits.position.get(follower) or _range(model, follower))
        low, high = max(low, ends[0]), min(high, ends[1])
        if not low < high:
            raise InputError(
                f"{description.source}: key 'couple.{follower}': its range and that of '{c.joint}' do not overlap"
            )
        if np.isfinite([low, high]).all():
            position[c.joint] = (low, high)
        for largest in (velocity, acceleration):
            if follower in largest:
                largest[c.joint] = min(largest.get(c.joint, np.inf), largest[follower] / abs(c.ratio))
    return limits.model_copy(update={"position": position, "velocity": velocity, "acceleration": acceleration})


def _range(model: mujoco.MjModel, name: str) -> tuple[float, float]:
    joint = model.joint(name).id
    low, high = map(float, model.jnt_range[joint])
    return (low, high) if model.jnt_limited[joint] else (-np.inf, np.inf)


def followers(model: mujoco.MjModel) -> Iterator[tuple[int, int, float, float]]:
    """Of coupled joints of a simulated robot: number, that of the leader, ratio, offset."""
    for e in np.flatnonzero(model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)).tolist():
        offset, ratio = (float(v) for v in model.eq_data[e][:2])
        yield int(model.eq_obj1id[e]), int(model.eq_obj2id[e]), ratio, offset


def put_followers(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Place coupled joints where their leaders ask for."""
    for follower, leader, ratio, offset in followers(model):
        data.qpos[model.jnt_qposadr[follower]] = ratio * data.qpos[model.jnt_qposadr[leader]] + offset
