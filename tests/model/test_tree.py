"""Kinematics and rigid-body dynamics of trees. Truth: MuJoCo and Pinocchio, two engines that share no code with ours."""

from __future__ import annotations

import casadi as ca
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import pinocchio_model, random_tree, rotation_of

from wbmpc.errors import InputError
from wbmpc.model.kinematics import Chain, FramePose, constant, solve_spd
from wbmpc.model.tree import read_tree
from wbmpc.robots import load_description, load_spec

TOLERANCE = 1e-9


def check_tree(spec: mujoco.MjSpec, root: str, seed: int) -> None:
    """Poses, velocities, inertia and inverse dynamics of our tree at random values, against both engines."""
    m = spec.compile()
    d = mujoco.MjData(m)
    rng = np.random.default_rng(seed)
    q, v, a = rng.uniform(-2, 2, m.nq), rng.uniform(-2, 2, m.nv), rng.uniform(-5, 5, m.nv)
    d.qpos[:], d.qvel[:], d.qacc[:] = q, v, a
    m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT) | int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    mujoco.mj_forward(m, d)
    d.qacc[:] = a
    mujoco.mj_inverse(m, d)

    tree = read_tree(spec, root)
    order = [tree.joint(m.joint(j).name) for j in range(m.njnt)]
    s, r, b = ca.SX.sym("q", m.nq), ca.SX.sym("v", m.nv), ca.SX.sym("a", m.nv)
    body = m.body(root).id
    place = FramePose(constant(m.body_pos[body]), constant(m.body_quat[body]), constant(rotation_of(m.body_quat[body])))
    chain = Chain(tree.links, {link: s[j] for j, link in enumerate(order)}, place)
    rates = {link: r[j] for j, link in enumerate(order)}
    named = {link: b[j] for j, link in enumerate(order)}
    columns = [order.index(link) for link in sorted(order)]
    frames = list(tree.frames)
    poses = [chain.frame_pose(tree.frames[n]) for n in frames]
    zero = ca.SX(3, 1)
    twists = [ca.vertcat(*chain.frame_velocity(tree.frames[n], rates, zero, zero)) for n in frames]
    f = ca.Function(
        "f",
        [s, r, b],
        [
            ca.horzcat(*[p.position for p in poses]),
            ca.horzcat(*[p.quaternion for p in poses]),
            ca.horzcat(*[ca.reshape(p.rotation, 9, 1) for p in poses]),
            ca.horzcat(*twists),
            chain.inverse_dynamics(rates, named),
            chain.mass_matrix(),
        ],
    )
    position, quaternion, rotation, twist, force, inertia = (np.array(o) for o in f(q, v, a))

    dense = np.zeros((m.nv, m.nv))
    mujoco.mj_fullM(m, d, dense)
    model, place_of = pinocchio_model(m)
    data = model.createData()
    pq, pv, pa = (np.zeros(m.nv) for _ in range(3))
    pq[place_of], pv[place_of], pa[place_of] = q, v, a
    pin.forwardKinematics(model, data, pq, pv)
    pin.updateFramePlacements(model, data)
    jacobian = np.zeros((6, m.nv))
    for k, name in enumerate(frames):
        is_site = any(m.site(i).name == name for i in range(m.nsite))
        if is_site:
            i = m.site(name).id
            truth = (d.site_xpos[i], d.site_xmat[i].reshape(3, 3))
            mujoco.mj_jacSite(m, d, jacobian[:3], jacobian[3:], i)
        else:
            i = m.body(name).id
            truth = (d.xpos[i], d.xmat[i].reshape(3, 3))
            mujoco.mj_jacBody(m, d, jacobian[:3], jacobian[3:], i)
        frame = model.getFrameId(("site:" if is_site else "") + name)
        other = data.oMf[frame]
        other_twist = pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED).vector
        for p, o in (truth, (other.translation, other.rotation)):
            np.testing.assert_allclose(position[:, k], p, atol=TOLERANCE)
            np.testing.assert_allclose(rotation[:, k].reshape(3, 3).T, o, atol=TOLERANCE)
            np.testing.assert_allclose(rotation_of(quaternion[:, k]), o, atol=TOLERANCE)
        np.testing.assert_allclose(twist[:, k], jacobian @ v, atol=10 * TOLERANCE)
        np.testing.assert_allclose(twist[:, k], other_twist, atol=10 * TOLERANCE)
    scale = 1.0 + np.abs(d.qfrc_inverse).max()
    free = d.qfrc_inverse + d.qfrc_passive  # the plant's dampers are no part of the model
    np.testing.assert_allclose(force.ravel(), free[columns], atol=TOLERANCE * scale)
    np.testing.assert_allclose(
        force.ravel(), pin.rnea(model, data, pq, pv, pa)[place_of][columns], atol=TOLERANCE * scale
    )
    upper = pin.crba(model, data, pq)
    upper = np.triu(upper) + np.triu(upper, 1).T
    np.testing.assert_allclose(inertia, dense[np.ix_(columns, columns)], atol=TOLERANCE * scale)
    picked = [place_of[c] for c in columns]
    np.testing.assert_allclose(inertia, upper[np.ix_(picked, picked)], atol=TOLERANCE * scale)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31), bodies=st.integers(1, 9))
def test_random_trees_equal_mujoco_and_pinocchio(seed: int, bodies: int) -> None:
    check_tree(random_tree(seed, bodies), "root", seed)


@pytest.mark.parametrize("name", ["swerve-ur10", "swerve-fixed-ur10"])
def test_swerve_robots_equal_mujoco_and_pinocchio(name: str) -> None:
    check_tree(load_spec(load_description(name)), "body", 1)


def test_rezero_without_its_ball_equals_mujoco_and_pinocchio() -> None:
    spec = load_spec("rezero")
    spec.delete(spec.body("ball"))
    check_tree(spec, "base", 2)


def test_locked_joints_stay_where_the_free_ones_would_be() -> None:
    """Truth: the unlocked robot in MuJoCo with its hinges at the locked angles."""
    free, locked = load_description("swerve-ur10"), load_description("swerve-fixed-ur10")
    a, b = load_spec(free).compile(), load_spec(locked).compile()
    da, db = mujoco.MjData(a), mujoco.MjData(b)
    for name, angle in locked.fixed_joints.items():
        da.qpos[a.joint(name).qposadr[0]] = angle
    mujoco.mj_forward(a, da)
    mujoco.mj_forward(b, db)
    assert [b.joint(j).name for j in range(b.njnt)] == [
        a.joint(j).name for j in range(a.njnt) if a.joint(j).name not in locked.fixed_joints
    ]
    np.testing.assert_allclose(db.xpos, da.xpos, atol=1e-12)
    np.testing.assert_allclose(db.xmat, da.xmat, atol=1e-12)


@pytest.mark.parametrize(
    ("joint", "body"),
    [('axis="1 2 2" pos="0.1 0.2 0.3"', 'euler="0.3 0.2 0.1"'), ('type="slide" axis="0 3 4"', 'axisangle="1 0 0 0.7"')],
)
def test_lock_of_skew_joints_in_rotated_bodies(tmp_path, joint: str, body: str) -> None:
    """Truth: MuJoCo with the joint at that value."""
    xml = f"""<mujoco><compiler angle="radian"/><worldbody><body name="base"><geom size="0.1"/>
      <body name="a" pos="0.1 0.2 0.3" {body}><joint name="locked" {joint}/><geom size="0.1" pos="0.1 0 0"/>
      <body name="b" pos="0 0 0.5"><joint name="free"/><geom size="0.1" pos="0 0.1 0"/><site name="tip"/></body></body>
      </body></worldbody></mujoco>"""
    (tmp_path / "r.xml").write_text(xml)
    (tmp_path / "r.yaml").write_text(
        "name: r\nmodel: r.xml\nbase: {type: fixed, body: base}\narm: {joints: [free], tool: tip}\nfixed_joints: {locked: 0.6}\n"
    )
    a = mujoco.MjModel.from_xml_string(xml)
    b = load_spec(load_description(tmp_path / "r.yaml")).compile()
    da, db = mujoco.MjData(a), mujoco.MjData(b)
    da.qpos[:] = [0.6, 0.4]
    db.qpos[:] = [0.4]
    mujoco.mj_forward(a, da)
    mujoco.mj_forward(b, db)
    np.testing.assert_allclose(db.xpos, da.xpos, atol=1e-12)
    np.testing.assert_allclose(db.xmat, da.xmat, atol=1e-12)


def test_a_hinge_off_its_body_origin_is_read_or_rejected() -> None:
    spec = mujoco.MjSpec.from_string(
        """<mujoco><worldbody><body name="root"><geom size="0.1"/><body name="a"><joint name="j" pos="0 0 1"/>
        <geom size="0.1"/></body></body></worldbody></mujoco>"""
    )
    with pytest.raises(InputError, match="joint 'j'"):
        read_tree(spec, "root")


@given(seed=st.integers(0, 2**31), n=st.integers(1, 6))
@settings(max_examples=20, deadline=None)
def test_solve_spd_equals_numpy(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    root, right = rng.normal(size=(n, n)), rng.normal(size=(n, 3))
    matrix = root @ root.T + np.eye(n)
    m, b = ca.SX.sym("m", n, n), ca.SX.sym("b", n, 3)
    got = np.array(ca.Function("f", [m, b], [solve_spd(m, b)])(matrix, right))
    np.testing.assert_allclose(got, np.linalg.solve(matrix, right), atol=1e-9)
