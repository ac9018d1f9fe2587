"""Links whose collision meshes cannot be read: what is seen of them stands for them, in plans as in the simulation. Truth: MuJoCo's
distances of a second file, in which plain boxes stand where the first one has meshes."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
import yaml
from urdf_parts import ARM, CASTER, DIFFERENTIAL, link, model, new

from wbmpc.model.robot import load_robot
from wbmpc.obstacles.geometry import robot_geometry
from wbmpc.obstacles.pairs import distances, draw_states
from wbmpc.robots import load_spec
from wbmpc.robots.model_import import SHAPE

#: Edges [m] of what is seen of the head.
EDGES = (0.2, 0.3, 0.6)
SEEN = '<visual><geometry><mesh filename="head.stl"/></geometry></visual>'
#: Collisions of the head: a mesh in a format that is not read; and beside a part of the head that is plain.
UNREAD = '<collision><geometry><mesh filename="head.dae"/></geometry></collision>'
PART = '<collision><origin xyz="0 0 0.25"/><geometry><sphere radius="0.05"/></geometry></collision>'
PALM = '<collision><geometry><sphere radius="0.04"/></geometry></collision>'


def write(folder: Path, head: str) -> Path:
    """A robot on wheels whose hand reaches its head."""
    (folder / "head.dae").write_text("<COLLADA/>")
    (folder / "head.stl").write_bytes(trimesh.creation.box(EDGES).export(file_type="stl"))
    body = (
        DIFFERENTIAL + CASTER + ARM.replace(link("head"), link("head", head)).replace(link("palm"), link("palm", PALM))
    )
    return model(folder, body, "reacher.urdf")


def truth(folder: Path, states: np.ndarray, names: tuple[str, ...], places: list[int]) -> np.ndarray:
    """Distances (n) [m] of the palm to the hull with its wheels and a plain box for a head."""
    (folder / "plain").mkdir()
    edges = " ".join(map(str, EDGES))
    path = write(folder / "plain", f'<collision><geometry><box size="{edges}"/></geometry></collision>')
    text = path.read_text().replace("</robot>", '<mujoco><compiler fusestatic="false"/></mujoco></robot>')
    m = mujoco.MjModel.from_xml_string(text)
    data, ends = mujoco.MjData(m), np.zeros(6)
    palm, *others = (int(m.body_geomadr[m.body(name).id]) for name in ("palm", "head", "left", "right"))
    apart = []
    for x in states:
        for name, place in zip(names, places, strict=True):
            data.qpos[m.jnt_qposadr[m.joint(name).id]] = x[place]
        mujoco.mj_kinematics(m, data)
        apart.append(min(mujoco.mj_geomDistance(m, data, palm, g, 1.0, ends) for g in others))
    return np.array(apart)


@pytest.mark.parametrize("collision", [UNREAD, UNREAD + PART], ids=["all", "a part"])
def test_what_is_seen_is_kept_clear_of_where_a_collision_mesh_is_not_read(collision: str, tmp_path: Path) -> None:
    path = new(write(tmp_path, SEEN + collision))
    robot = load_robot(path)
    assert yaml.safe_load(path.read_text())["collision"]["self"]["pairs"] == [
        ["hull", "palm"]
    ]  # the head is fixed to it
    states, names = draw_states(robot, 300), robot.state.groups["arm"]
    found = distances(robot_geometry(robot), [("hull", "palm")], states, 1.0)[:, 0]
    apart = truth(tmp_path, states, names, [robot.state.index(f"arm.{name}") for name in names])
    assert (apart < 0.0).any() and (apart > 0.1).any()
    np.testing.assert_allclose(np.maximum(found, 0.0), np.maximum(apart, 0.0), atol=1e-4)
    # the simulation lets the same shape collide, and no other
    spec = load_spec(robot.description, meshes=True)
    solid = [g for g in spec.body("head").geoms if g.conaffinity == SHAPE]
    assert [g.type for g in solid] == [mujoco.mjtGeom.mjGEOM_MESH]


@pytest.mark.parametrize(("collision", "shapes"), [(UNREAD, 0), (UNREAD + PART, 1)])
def test_what_can_be_read_stays_where_nothing_is_seen(collision: str, shapes: int, tmp_path: Path) -> None:
    robot = load_robot(new(write(tmp_path, collision)))
    assert [s.frame for s in robot_geometry(robot).shapes].count("head") == shapes


def test_a_collision_that_is_read_stands_alone(tmp_path: Path) -> None:
    robot = load_robot(new(write(tmp_path, SEEN + PART)))
    assert [s.solid.kind for s in robot_geometry(robot).shapes if s.frame == "head"] == ["sphere"]
