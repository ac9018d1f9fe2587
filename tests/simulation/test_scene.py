"""What is drawn of a robot whose file shows nothing. Truth: the places of its joints in MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np

from wbmpc import lie
from wbmpc.simulation.scene import SceneReader

BODY = '<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>'
MODEL = f"""<mujoco><worldbody>
<body name="post" pos="1 0 0">{BODY}<body name="sign" pos="0 0 1">{BODY}</body></body>
<body name="hull" pos="0 0 0.2">{BODY}
  <body name="near" pos="0 0.01 0">{BODY}</body>
  <body name="upper" pos="0.1 -0.2 0.3">{BODY}<joint name="lift" axis="0 1 0"/>
    <body name="fore" pos="0.3 0.1 -0.2">{BODY}<joint name="elbow" axis="0 0 1"/><geom name="drawn" size="0.05"/>
      <body name="palm" pos="0 0 0.2">{BODY}<body name="frame" pos="0 0.2 0"/></body>
    </body>
  </body>
</body></worldbody></mujoco>"""


def test_parts_without_shapes_are_rods_between_joints() -> None:
    """Those of the robot that have a mass and are not at one place; parts with shapes and other things stay as they are drawn."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    reader, data = SceneReader(model, "hull"), mujoco.MjData(model)
    rods = [s for s in reader.scene.shapes if s.kind == "capsule"]
    assert [s.body for s in rods] == ["hull", "upper", "palm"] and len(reader.scene.shapes) == 4
    rng = np.random.default_rng(0)
    for _ in range(5):
        data.qpos[:] = rng.uniform(-2.0, 2.0, model.nq)
        mujoco.mj_kinematics(model, data)
        for shape, end in zip(rods, ("upper", "fore", "frame"), strict=True):
            body, turn, axis = data.body(shape.body), np.empty(4), np.empty(3)
            mujoco.mju_mulQuat(turn, body.xquat, np.array(shape.pose[3:]))
            mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, shape.size[1]]), turn)
            middle = body.xpos + body.xmat.reshape(3, 3) @ shape.pose[:3]
            np.testing.assert_allclose([middle - axis, middle + axis], [body.xpos, data.body(end).xpos], atol=1e-12)


def test_links_are_poses_in_the_bodies_that_they_hang_on() -> None:
    """Truth: :func:`wbmpc.lie.pose_between`, one by one."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    reader, data = SceneReader(model, "hull"), mujoco.MjData(model)
    data.qpos[:] = [0.4, -1.1]
    mujoco.mj_kinematics(model, data)
    bodies = reader.poses(data)
    assert [reader.scene.bodies[i].name for i in reader.moving] == ["upper", "fore"]
    expected = [lie.pose_between(bodies[reader.parents[i]], bodies[i]) for i in reader.moving]
    np.testing.assert_allclose(reader.links(bodies), expected, atol=1e-14)
