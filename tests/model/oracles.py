"""Independent engines for the tests: MuJoCo states and Pinocchio models built from MuJoCo's compiled numbers."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin

HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


def rotation_of(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) of MuJoCo's quaternion, by MuJoCo."""
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, np.ascontiguousarray(quaternion, float))
    return out.reshape(3, 3)


def pinocchio_model(m: mujoco.MjModel) -> tuple[pin.Model, list[int]]:
    """The same tree in Pinocchio, and for each of MuJoCo's joints its index in Pinocchio's vectors (nq = nv)."""
    model = pin.Model()
    model.gravity.linear = np.array(m.opt.gravity)
    place = {0: (0, pin.SE3.Identity())}  # body -> (Pinocchio joint, pose of the body in it)
    columns = [0] * m.njnt
    for body in range(1, m.nbody):
        joint, pose = place[int(m.body_parentid[body])]
        pose = pose * pin.SE3(rotation_of(m.body_quat[body]), m.body_pos[body].copy())
        for k in range(int(m.body_jntnum[body])):
            j = int(m.body_jntadr[body]) + k
            axis = m.jnt_axis[j].copy()
            kind = {HINGE: pin.JointModelRevoluteUnaligned, SLIDE: pin.JointModelPrismaticUnaligned}[int(m.jnt_type[j])]
            joint = model.addJoint(joint, kind(axis), pose, m.joint(j).name)
            columns[j] = model.idx_vs[joint]
            pose = pin.SE3.Identity()
        axes = rotation_of(m.body_iquat[body])
        inertia = pin.Inertia(
            float(m.body_mass[body]), m.body_ipos[body].copy(), axes @ np.diag(m.body_inertia[body]) @ axes.T
        )
        model.appendBodyToJoint(joint, inertia, pose)
        model.addFrame(pin.Frame(m.body(body).name, joint, 0, pose, pin.FrameType.OP_FRAME))
        place[body] = (joint, pose)
    for site in range(m.nsite):
        joint, pose = place[int(m.site_bodyid[site])]
        local = pin.SE3(rotation_of(m.site_quat[site]), m.site_pos[site].copy())
        model.addFrame(pin.Frame("site:" + m.site(site).name, joint, 0, pose * local, pin.FrameType.OP_FRAME))
    return model, columns


def random_tree(seed: int, bodies: int) -> mujoco.MjSpec:
    """A random branched tree of fixed, hinge and slide joints; some bodies have two joints, some axes are skew."""
    rng = np.random.default_rng(seed)
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    made = [spec.worldbody.add_body(name="root")]
    _inertia(made[0], rng)
    for i in range(bodies):
        parent = made[int(rng.integers(max(0, len(made) - 3), len(made)))]
        quat = [1.0, 0, 0, 0] if rng.random() < 0.3 else _unit(rng.normal(size=4))
        body = parent.add_body(name=f"b{i}", pos=rng.uniform(-0.5, 0.5, 3), quat=quat)
        _inertia(body, rng)
        count = int(rng.choice([0, 1, 1, 1, 2])) if i else 1
        for k in range(count):
            kind = mujoco.mjtJoint.mjJNT_SLIDE if rng.random() < 0.3 else mujoco.mjtJoint.mjJNT_HINGE
            axis = np.eye(3)[k if count > 1 else rng.integers(3)] * rng.choice([-1.0, 1.0])
            if count == 1 and rng.random() < 0.5:
                axis = _unit(rng.normal(size=3))
            body.add_joint(name=f"j{i}_{k}", type=kind, axis=axis)
        body.add_site(name=f"s{i}", pos=rng.uniform(-0.3, 0.3, 3), quat=_unit(rng.normal(size=4)))
        made.append(body)
    return spec


def _inertia(body: mujoco.MjsBody, rng: np.random.Generator) -> None:
    body.explicitinertial = True
    body.mass = rng.uniform(0.1, 5.0)
    body.ipos = rng.uniform(-0.2, 0.2, 3)
    body.iquat = _unit(rng.normal(size=4))
    body.inertia = rng.uniform(0.01, 0.02, 3)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)
