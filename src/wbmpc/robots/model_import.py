"""What of a robot's file planner and simulator both use: bodies, masses, joints with their ranges, frames, shapes for the eye.

The rest acts in the simulator alone. What plants have of their own is left out here (floor, tires, drives, friction of joints,
gravity), what is part of the machine and missing in the planner's equations (springs, couplings) is rejected.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from wbmpc.errors import InputError
from wbmpc.robots.checks import compiled
from wbmpc.robots.limited_program import copy_values, strip_actuators_and_options

if TYPE_CHECKING:
    from wbmpc.robots.description import RobotDescription

#: Bit of ``conaffinity`` of shapes that stand for their body in collisions.
SHAPE = 4
#: What joints have in the file beside place, axis and range: friction is the plants' own, limits of effort are the YAML's.
_OF_JOINTS = (
    "damping", "armature", "frictionloss", "actfrclimited", "actfrcrange", "actgravcomp", "margin",
    "solref_limit", "solimp_limit", "solref_friction", "solimp_friction",
)  # fmt: skip
_OF_CONTACTS = ("condim", "friction", "priority", "solmix", "solref", "solimp", "margin", "gap")
_OF_COMPILER = ("settotalmass", "inertiafromgeom", "boundmass", "boundinertia", "fusestatic")


def keep_mechanics(spec: mujoco.MjSpec, base: str, path: object) -> None:
    """Leave out, in place, what plants have of their own, and the joints of the body ``base``, which the kind of base moves."""
    fresh = mujoco.MjSpec()
    strip_actuators_and_options(spec)
    _fix_masses(spec, fresh, path)
    own = [j for j in spec.joints if j.parent.name == base]
    lists = (spec.sensors, spec.keys, spec.excludes, spec.pairs, spec.tuples, own)
    for element in [e for elements in lists for e in elements]:
        spec.delete(element)
    _leave_the_world(spec, base)
    _mark_shapes(spec, fresh)
    for body in spec.bodies:
        body.gravcomp = 0.0
    for joint in spec.joints:
        for name in _OF_JOINTS:
            setattr(joint, name, getattr(fresh.default.joint, name))
    _reset_defaults(spec, fresh)


def _mark_shapes(spec: mujoco.MjSpec, fresh: mujoco.MjSpec) -> None:
    """Shapes touch nothing until a plant says so, and then as MuJoCo's defaults do; those that stand for their body in collisions are
    marked: of a body, those that the file lets collide, or all that it draws where it lets none."""
    for body in spec.bodies:
        shapes = [g for g in body.geoms if g.type != mujoco.mjtGeom.mjGEOM_PLANE]
        solid = [g for g in shapes if g.contype or g.conaffinity] or shapes
        for geom in body.geoms:
            for name in _OF_CONTACTS:
                setattr(geom, name, getattr(fresh.default.geom, name))
            geom.contype, geom.conaffinity = 0, SHAPE if any(geom is g for g in solid) else 0


def _fix_masses(spec: mujoco.MjSpec, fresh: mujoco.MjSpec, path: object) -> None:
    """Masses as the file's compiler makes them, for good: else it would do the same to what plants add or change, as a payload."""
    names = [n for n in _OF_COMPILER if getattr(spec.compiler, n) != getattr(fresh.compiler, n)]
    spec.compiler.fusestatic = False  # all frames are kept
    if set(names) - {"fusestatic"}:
        model = compiled(spec, path)
        for body in spec.bodies[1:]:
            body.explicitinertial, body.fullinertia = True, np.full(6, np.nan)
            body.mass, body.inertia = float(model.body_mass[body.id]), model.body_inertia[body.id]
            body.ipos, body.iquat = model.body_ipos[body.id], model.body_iquat[body.id]
    for name in names:
        setattr(spec.compiler, name, getattr(fresh.compiler, name))


def _leave_the_world(spec: mujoco.MjSpec, base: str) -> None:
    """Delete what is in the world beside the robot: floor, obstacles, light and cameras of a scene, mocap bodies."""
    parent = spec.worldbody
    if parent.find_child(base) is None:  # the check of names says so
        return
    while parent.name != base:
        inner = next(b for b in parent.bodies if b.name == base or b.find_child(base) is not None)
        for body in [b for b in parent.bodies if b is not inner]:
            spec.delete(body)
        parent = inner
    world = spec.worldbody
    for element in [*world.geoms, *world.lights, *world.cameras]:
        spec.delete(element)
    for eye in [*spec.cameras, *spec.lights]:
        if eye.targetbody and spec.body(eye.targetbody) is None:  # it looks at something of the scene
            spec.delete(eye)


def _reset_defaults(spec: mujoco.MjSpec, fresh: mujoco.MjSpec) -> None:
    """The file's elements have taken what its defaults say; what plants add (floor, tires, drives, a door) would take it too."""
    classes = {default.name: default for default in [spec.default, *(body.classname for body in spec.bodies)]}
    for default in classes.values():
        for kind in ("geom", "joint", "actuator", "site"):
            copy_values(getattr(fresh.default, kind), getattr(default, kind))


def widen(spec: mujoco.MjSpec, position: dict[str, tuple[float, float]], path: object) -> None:
    """Move the stops of joints that the YAML's ``limits.position`` [rad or m] reaches beyond, which the planner may use; a narrower
    one is the planner's alone."""
    if not position:
        return
    model = compiled(spec, path)
    for joint in spec.joints:
        if joint.name not in position or not model.jnt_limited[joint.id]:
            continue
        (low, high), (minimum, maximum) = position[joint.name], model.jnt_range[joint.id]
        if low < minimum or high > maximum:
            turns = joint.type == mujoco.mjtJoint.mjJNT_HINGE and spec.compiler.degree
            stops = np.array([min(low, minimum), max(high, maximum)])
            joint.range = np.rad2deg(stops) if turns else stops


# ---------------------------------------------------------------------- springs and couplings
def reject_couplings(spec: mujoco.MjSpec, description: RobotDescription) -> None:
    """Reject springs, couplings and plugins that act on joints which are used, and delete those that do not.

    Before joints are locked: a coupling of fingers that are all held does nothing. Raises :class:`InputError` with file and joint.
    """
    used, own, path = (
        {*description.joints(), *description.couple}, set(description.base.parts().values()), description.model,
    )  # fmt: skip
    known = [{follower, c.joint} for follower, c in description.couple.items()]
    for joint in spec.joints:
        sprung = np.any(joint.stiffness) or np.any(joint.springdamper)
        if sprung and (joint.name in used or joint.parent.name in own):
            raise InputError(f"{path}: joint '{joint.name}' has a spring ('stiffness'), {_UNKNOWN}")
    for body in spec.bodies:
        if body.plugin.active:
            raise InputError(f"{path}: body '{body.name}' has a plugin, {_UNKNOWN}")
    if spec.flexes:
        raise InputError(f"{path}: flex '{spec.flexes[0].name}' is soft, {_UNKNOWN}")
    if not (spec.tendons or spec.equalities):
        return
    model = compiled(spec, path)
    for what, joints in _couplings(model):
        names = [model.joint(j).name for j in joints]
        on = [n for j, n in zip(joints, names, strict=True) if n in used or _body_of(model, j) in own]
        if on and set(names) not in known:
            raise InputError(f"{path}: {what} acts on joint {', '.join(repr(n) for n in on)}, {_UNKNOWN}")
    for element in [*spec.equalities, *spec.tendons]:
        spec.delete(element)


_UNKNOWN = (
    "of which the planner's equations know nothing: take it out of the file, or hold its joints with 'fixed_joints'"
)


def _body_of(model: mujoco.MjModel, joint: int) -> str:
    return str(model.body(int(model.jnt_bodyid[joint])).name)


def _couplings(model: mujoco.MjModel) -> Iterator[tuple[str, list[int]]]:
    """What couples joints, in words, and which joints: equalities that are active, tendons that can pull."""
    for t in range(model.ntendon):
        parts = ("stiffness", "stiffnesspoly", "damping", "dampingpoly", "frictionloss", "armature", "limited")
        if any(np.any(getattr(model, f"tendon_{p}")[t]) for p in parts):
            yield f"tendon '{model.tendon(t).name}'", _along(model, t)
    for e in range(model.neq):
        if model.eq_active0[e]:
            kind = mujoco.mjtEq(int(model.eq_type[e])).name.removeprefix("mjEQ_").lower()
            yield f"the coupling '{kind}' (an equality, or 'mimic' of a URDF)", _coupled(model, e, kind)


def _coupled(model: mujoco.MjModel, equality: int, kind: str) -> list[int]:
    """Joints that an equality couples; a weld or a connection: those between its bodies."""
    ends = [int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])]
    if kind == "joint":
        return [j for j in ends if j >= 0]
    if kind == "tendon":
        return [j for t in ends if t >= 0 for j in _along(model, t)]
    if int(model.eq_objtype[equality]) == int(mujoco.mjtObj.mjOBJ_SITE):
        ends = [int(model.site_bodyid[s]) for s in ends]
    return _between(model, ends)


def _along(model: mujoco.MjModel, tendon: int) -> list[int]:
    """Joints with which the length of a tendon can change."""
    joints, bodies, start = [], [], int(model.tendon_adr[tendon])
    for w in range(start, start + int(model.tendon_num[tendon])):
        kind, what = mujoco.mjtWrap(int(model.wrap_type[w])), int(model.wrap_objid[w])
        if kind == mujoco.mjtWrap.mjWRAP_JOINT:
            joints.append(what)
        elif kind == mujoco.mjtWrap.mjWRAP_SITE:
            bodies.append(int(model.site_bodyid[what]))
        elif kind != mujoco.mjtWrap.mjWRAP_PULLEY:
            bodies.append(int(model.geom_bodyid[what]))
    return joints + _between(model, bodies)


def _between(model: mujoco.MjModel, bodies: list[int]) -> list[int]:
    """Joints that move one of the bodies against another."""
    chains: list[set[int]] = [set(_chain(model, b)) for b in bodies]
    return sorted(chains[0].union(*chains) - chains[0].intersection(*chains)) if chains else []


def _chain(model: mujoco.MjModel, body: int) -> Iterator[int]:
    while body > 0:
        first = int(model.body_jntadr[body])
        yield from range(first, first + int(model.body_jntnum[body]))
        body = int(model.body_parentid[body])
