"""Joints that a description holds: taken out of a MuJoCo specification."""

from __future__ import annotations

import mujoco
import numpy as np

from wbmpc import lie
from wbmpc.errors import InputError, unknown_name
from wbmpc.robots.checks import reject_reference


def fix_joint(spec: mujoco.MjSpec, name: str, value: float, source: str) -> None:
    """Remove a hinge or slide joint after moving its body to the joint's ``value`` [rad or m].

    Nothing may refer to it any more (see :mod:`wbmpc.robots.model_import`). Raises :class:`InputError`.
    """
    joint = spec.joint(name)
    if joint is None:
        raise unknown_name("joint (key 'fixed_joints')", name, [j.name for j in spec.joints], where=source)
    reject_reference(source, name, float(joint.ref))
    body = joint.parent
    rotation = lie.quaternion_to_rotation(_body_quaternion(spec, body, source))
    axis = np.asarray(joint.axis, float) / np.linalg.norm(joint.axis)
    if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
        turn = lie.quaternion_to_rotation(lie.quaternion_about(axis, value))
        shift = np.asarray(joint.pos) - turn @ np.asarray(joint.pos)
    elif joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
        turn, shift = np.eye(3), value * axis
    else:
        raise InputError(f"{source}: key 'fixed_joints': joint '{name}' is neither a hinge nor a slide")
    body.pos = np.asarray(body.pos) + rotation @ shift
    body.quat = lie.rotation_to_quaternion(rotation @ turn)
    body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    spec.delete(joint)


def _body_quaternion(spec: mujoco.MjSpec, body: mujoco.MjsBody, source: str) -> np.ndarray:
    """Orientation of a body in its parent (or in the <frame> around it), also when the file gives Euler angles."""
    if body.alt.type == mujoco.mjtOrientation.mjORIENTATION_QUAT:
        return np.asarray(body.quat, float) / np.linalg.norm(body.quat)
    if body.frame is not None:
        raise InputError(f"{source}: key 'fixed_joints': body '{body.name}' in a frame needs its orientation as a quat")
    return np.array(spec.compile().body(body.name).quat, float)
