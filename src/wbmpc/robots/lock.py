"""Joints that a description holds: taken out of a MuJoCo specification, with all that refers to them."""

from __future__ import annotations

import mujoco
import numpy as np

from wbmpc import lie
from wbmpc.errors import InputError, unknown_name
from wbmpc.robots.checks import refuse_reference


def lock(spec: mujoco.MjSpec, name: str, value: float, source: str) -> None:
    """Remove a hinge or slide joint after moving its body to the joint's ``value`` [rad or m].

    Couplings with it (``mimic`` of a URDF; equalities and fixed tendons of an MJCF) go too. Raises :class:`InputError`.
    """
    joint = next((j for j in spec.joints if j.name == name), None)
    if joint is None:
        raise unknown_name("joint (key 'lock')", name, [j.name for j in spec.joints], where=source)
    refuse_reference(source, name, float(joint.ref))
    body = joint.parent
    rotation = lie.quaternion_to_rotation(_body_quaternion(spec, body, source))
    axis = np.asarray(joint.axis, float) / np.linalg.norm(joint.axis)
    if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
        turn = lie.quaternion_to_rotation(lie.quaternion_about(axis, value))
        shift = np.asarray(joint.pos) - turn @ np.asarray(joint.pos)
    elif joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
        turn, shift = np.eye(3), value * axis
    else:
        raise InputError(f"{source}: key 'lock': joint '{name}' is neither a hinge nor a slide")
    body.pos = np.asarray(body.pos) + rotation @ shift
    body.quat = lie.rotation_to_quaternion(rotation @ turn)
    body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    _uncouple(spec, name)
    spec.delete(joint)


def _uncouple(spec: mujoco.MjSpec, joint: str) -> None:
    """Delete the tendons over a joint, and the equalities of the joint and of these tendons."""
    gone = {mujoco.mjtEq.mjEQ_JOINT: {joint}, mujoco.mjtEq.mjEQ_TENDON: set()}
    for tendon in list(spec.tendons):
        over = [w.target for w in tendon.path]
        if any(isinstance(t, mujoco.MjsJoint) and t.name == joint for t in over):
            gone[mujoco.mjtEq.mjEQ_TENDON].add(tendon.name)
            spec.delete(tendon)
    for equality in list(spec.equalities):
        if equality.type in gone and gone[equality.type] & {equality.name1, equality.name2}:
            spec.delete(equality)


def _body_quaternion(spec: mujoco.MjSpec, body: mujoco.MjsBody, source: str) -> np.ndarray:
    """Orientation of a body in its parent (or in the <frame> around it), also when the file gives Euler angles."""
    if body.alt.type == mujoco.mjtOrientation.mjORIENTATION_QUAT:
        return np.asarray(body.quat, float) / np.linalg.norm(body.quat)
    if body.frame is not None:
        raise InputError(f"{source}: key 'lock': body '{body.name}' in a frame needs its orientation as a quat")
    return np.array(spec.compile().body(body.name).quat, float)
