"""How fast joints and wheels of a robot that stands on its wheels may get faster before it tips over."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from wbmpc.constants import GRAVITY
from wbmpc.robots.mechanism import Array, Mechanism
from wbmpc.robots.wheel_search import Wheel

#: Shares of the moment that tips the robot over: of one joint of its arm, for several move at a time; of its wheels.
JOINT_SHARE, BASE_SHARE = 0.15, 0.4
#: A center of mass above the edge of what the wheels span, or beyond it, counts as within it by this share of the span's half width: where
#: casters are is assumed.
LEAST_WIDTH = 0.2
#: Postures that are tried.
POSTURES = 200


@dataclass(frozen=True)
class Steadiness:
    """``joints`` [rad/s²]: of hinges by name; ``base`` [m/s²]: of the base along the floor."""

    joints: Mapping[str, float]
    base: float


def steadiness(
    mechanism: Mechanism, wheels: Sequence[Wheel], joints: Iterable[str], angles: Mapping[str, float]
) -> Steadiness | None:
    """At the posture ``angles`` [rad, m], by masses and inertias of the file; None where nothing says on what it stands.

    A hinge that accelerates what it moves, of inertia I about its axis, needs a moment α I, of which the floor gives what lies in its
    plane: at most the weight times the distance from the center of mass to the edge of what the wheels span. Two wheels are taken to
    have casters as far ahead of their middle and behind it as they are beside it.
    """
    places = np.array([w.center[:2] for w in wheels])
    if len(places) < 2:
        return None
    model, data = mechanism.model, mujoco.MjData(mechanism.model)
    for name, angle in angles.items():
        data.qpos[model.jnt_qposadr[model.joint(name).id]] = angle
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    width = _half_width(places)
    beside = float(np.linalg.norm(data.subtree_com[0][:2] - places.mean(axis=0)))
    width = max(width - beside, LEAST_WIDTH * width)
    moments = float(model.body_mass.sum()) * GRAVITY * width
    ground = min(float(w.center[2]) - (w.radius or 0.0) for w in wheels)
    height = max(float(data.subtree_com[0][2]) - ground, 1e-3)
    found = {n: i for n in joints if (i := _tipping_inertia(mechanism, data, n)) > 0.0}
    return Steadiness(
        {name: JOINT_SHARE * moments / inertia for name, inertia in found.items()},
        BASE_SHARE * GRAVITY * width / height,
    )


def _half_width(places: Array) -> float:
    """Least distance [m] from the middle of points (n, 2) to the edge of what they span."""
    away = places - places.mean(axis=0)
    if len(places) == 2:
        return float(np.linalg.norm(away[0]))
    directions = np.stack([np.cos(a := np.linspace(0.0, 2.0 * np.pi, 73)), np.sin(a)], axis=1)
    return float(np.min(np.max(away @ directions.T, axis=0)))  # of a triangle the far corner is no edge


def _tipping_inertia(mechanism: Mechanism, data: mujoco.MjData, name: str) -> float:
    """Of what a hinge moves, about its axis [kg m²], times the share of the axis that is horizontal; 0 of a slide."""
    joint, model = mechanism.joints[name], mechanism.model
    if joint.kind != "hinge":
        return 0.0
    j = model.joint(name).id
    axis, anchor, total = data.xaxis[j], data.xanchor[j], 0.0
    top = int(model.jnt_bodyid[j])
    for b in range(top, model.nbody):
        if not mechanism.is_below(b, top):
            continue
        arm = np.cross(axis, data.xipos[b] - anchor)
        own = data.ximat[b].reshape(3, 3).T @ axis
        total += float(model.body_mass[b]) * float(arm @ arm) + float(model.body_inertia[b] @ own**2)
    return total * float(np.hypot(axis[0], axis[1]))


def tipping_share(
    mechanism: Mechanism, places: Array, ranges: Mapping[str, tuple[float, float]], held: Mapping[str, float]
) -> float:
    """Share of random postures of the arm in ``ranges`` [rad, m] in which the center of mass is not above what the wheels at ``places``
    (n, 2) [m] span: there the robot tips over at rest. ``held``: the other joints."""
    model, data = mechanism.model, mujoco.MjData(mechanism.model)
    for name, value in held.items():
        data.qpos[model.jnt_qposadr[model.joint(name).id]] = value
    at = [int(model.jnt_qposadr[model.joint(name).id]) for name in ranges]
    low, high = np.array(list(ranges.values())).reshape(-1, 2).T
    directions = np.stack([np.cos(a := np.linspace(0.0, 2.0 * np.pi, 73)), np.sin(a)], axis=1)
    edge, outside = (places @ directions.T).max(axis=0), 0
    for share in np.random.default_rng(0).uniform(size=(POSTURES, len(at))):
        data.qpos[at] = low + share * (high - low)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        outside += bool(np.any(directions @ data.subtree_com[0][:2] > edge))
    return outside / POSTURES
