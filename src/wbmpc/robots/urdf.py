"""A described robot as URDF text: what ROS tools want as ``/robot_description``."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np

from wbmpc import lie
from wbmpc.robots.description import RobotDescription, load_spec
from wbmpc.robots.frames import BASE, MAP, ODOM, fixed_frames, frame_names, free_name
from wbmpc.robots.model_file import ModelFile, file_of
from wbmpc.robots.urdf_tree import BALL

_JOINTS = {
    mujoco.mjtJoint.mjJNT_HINGE: "revolute",
    mujoco.mjtJoint.mjJNT_SLIDE: "prismatic",
    mujoco.mjtJoint.mjJNT_BALL: "floating",
}
_SMALL = 1e-12


def to_urdf(
    description: RobotDescription, base: str = BASE, world: str = ODOM, joints: Mapping[str, str] | None = None
) -> str:
    """The robot's own URDF if it has one, else its bodies, joints and primitive shapes written as URDF.

    Links have the frames of MuJoCo's bodies and the names of :func:`wbmpc.robots.frames.frame_names`; the root is the base, which
    hangs on ``world`` by what ``/tf`` says. Named points (tool, mount, inertial unit) become links of their own. URDF knows no ball
    joint: it becomes a floating one, whose frame ``/tf`` has to have. Meshes and ellipsoids are left out. Of a robot's own URDF
    what is above the base is left out, links whose names are taken are renamed, joints that the robot's file holds are fixed, and
    those that it couples mimic: no joint states have them. ``joints``: what joint states call those that they do not call as the
    robot's file does; a joint without states whose name one of them gets is renamed.
    """
    file = file_of(description)
    if file.root is not None:
        return _own(description, file, base, world, joints or {})
    model = load_spec(description).compile()
    root = Xml.Element("robot", name=description.name)
    body = model.body(description.base.body).id
    inside = {body}
    bodies = [model.body(i).name for i in range(1, model.nbody)]
    points = fixed_frames(description, base, world)
    joined = [model.joint(j).name for j in range(model.njnt)]
    taken = {base, world, MAP, *bodies, *joined, *(point.name for point in points)}
    for i in range(1, model.nbody):
        if i != body and int(model.body_parentid[i]) in inside:
            inside.add(i)
            _joints(root, description, model, i, taken)
    for i in sorted(inside):
        _link(root, model, i)
    _rename(root, frame_names(description.base.body, bodies, base, world))
    links = {link.get("name") for link in root.iter("link")}
    for frame in points:
        if frame.parent in links:
            Xml.SubElement(root, "link", name=frame.name)
            name = free_name(f"{frame.name}_fixed", taken)
            _joint(root, name, "fixed", frame.parent, frame.name, frame.pose[:3], frame.pose[3:])
    _settle(root, description, joints or {})
    return _written(root)


def _written(root: Xml.Element) -> str:
    Xml.indent(root)
    return '<?xml version="1.0"?>\n' + Xml.tostring(root, encoding="unicode") + "\n"


def _own(description: RobotDescription, file: ModelFile, base: str, world: str, called: Mapping[str, str]) -> str:
    """The robot's own URDF from its base on; untouched if that changes nothing and it has no macros."""
    root = file.root
    assert root is not None
    inside, joints = {description.base.body}, root.findall("joint")
    ends = [(_end(j, "parent"), _end(j, "child")) for j in joints]
    while below := {child for parent, child in ends if parent in inside} - inside:
        inside |= below
    outside = [link for link in root.findall("link") if link.get("name") not in inside]
    names, balls = (
        frame_names(description.base.body, sorted(inside), base, world),
        [j for j in joints if j.get("type") == BALL],
    )
    settled = description.fixed_joints or description.couple or called
    if not (file.macros or outside or balls or settled) and all(body == name for body, name in names.items()):
        return file.path.read_text()
    for joint in balls:  # ROS knows none
        joint.set("type", "floating")
    for element in outside:
        root.remove(element)
    for joint, (parent, _) in zip(joints, ends, strict=True):
        if parent not in inside:
            root.remove(joint)
    _rename(root, names)
    _settle(root, description, called)
    return _written(root)


def _end(joint: Xml.Element, tag: str) -> str:
    found = joint.find(tag)
    return "" if found is None else found.get("link", "")


def _rename(root: Xml.Element, names: dict[str, str]) -> None:
    """Links, and the joints and others (Gazebo's, MoveIt's) that name them."""
    for link in root.findall("link"):
        link.set("name", names.get(link.get("name", ""), link.get("name", "")))
    for element in root.iter():
        for key in ("link", "reference"):
            if element.get(key) in names:
                element.set(key, names[str(element.get(key))])


def _settle(root: Xml.Element, description: RobotDescription, called: Mapping[str, str]) -> None:
    """Joints as a robot's file has them: held, coupled, and called as joint states call them, also where others (mimics,
    transmissions, ros2_control's) name them."""
    for joint in root.findall("joint"):
        name = joint.get("name", "")
        if name in description.fixed_joints:
            _hold(joint, description.fixed_joints[name])
        elif name in description.couple:
            leads = description.couple[name]
            _drop(joint, "mimic")
            values = {"multiplier": f"{leads.ratio:.9g}", "offset": f"{leads.offset:.9g}"}
            Xml.SubElement(joint, "mimic", {"joint": leads.joint, **values})
    called = {**_moved_aside(root, called), **called}
    for element in root.iter():
        for key in ("joint", "name") if element.tag == "joint" else ("joint",):
            if element.get(key) in called:
                element.set(key, called[str(element.get(key))])


def _moved_aside(root: Xml.Element, called: Mapping[str, str]) -> dict[str, str]:
    """Other names of joints that joint states do not have, and whose names others are called by: names of joints are unique."""
    names = [joint.get("name", "") for joint in root.findall("joint")]
    given = set(called.values())
    taken = given.union(names)
    return {name: free_name(name, taken) for name in names if name in given and name not in called}


def _hold(joint: Xml.Element, value: float) -> None:
    """Fix a joint at a value [rad or m]."""
    origin, found = joint.find("origin"), joint.find("axis")
    numbers = lambda text: np.array([float(v) for v in text.split()])
    read = lambda element, key, other: numbers(other if element is None else element.get(key, other))
    axis = read(found, "xyz", "1 0 0")
    axis = axis / np.linalg.norm(axis)
    roll, pitch, yaw = read(origin, "rpy", "0 0 0")
    turned, position = lie.euler_zyx_to_rotation(yaw, pitch, roll), read(origin, "xyz", "0 0 0")
    if joint.get("type") == "prismatic":
        position = position + turned @ (value * axis)
    else:
        turned = turned @ lie.quaternion_to_rotation(lie.quaternion_about(axis, value))
    joint.set("type", "fixed")
    _drop(joint, "origin", "axis", "limit", "mimic", "dynamics", "calibration", "safety_controller")
    _origin(joint, position, lie.rotation_to_quaternion(turned))


def _drop(joint: Xml.Element, *tags: str) -> None:
    for tag in tags:
        for element in joint.findall(tag):
            joint.remove(element)


def _text(values: np.ndarray) -> str:
    return " ".join(f"{v:.9g}" for v in values)


def _origin(parent: Xml.Element, position: np.ndarray, quaternion: np.ndarray) -> None:
    yaw, pitch, roll = lie.rotation_to_euler_zyx(lie.quaternion_to_rotation(quaternion))
    Xml.SubElement(parent, "origin", xyz=_text(position), rpy=_text(np.array([roll, pitch, yaw])))


def _joint(
    root: Xml.Element, name: str, kind: str, parent: str, child: str, position: np.ndarray, quaternion: np.ndarray
) -> Xml.Element:
    joint = Xml.SubElement(root, "joint", name=name, type=kind)
    Xml.SubElement(joint, "parent", link=parent)
    Xml.SubElement(joint, "child", link=child)
    _origin(joint, position, quaternion)
    return joint


def _joints(root: Xml.Element, description: RobotDescription, model: mujoco.MjModel, i: int, taken: set[str]) -> None:
    """The joints between a body and its parent, with links without mass between several, or beside the body's origin; what the model
    does not name gets names that are not ``taken``."""
    name, parent = model.body(i).name, model.body(int(model.body_parentid[i])).name
    position, quaternion = model.body_pos[i].copy(), model.body_quat[i].copy()
    first, count = int(model.body_jntadr[i]), int(model.body_jntnum[i])
    unit = np.array([1.0, 0.0, 0.0, 0.0])
    for j in range(first, first + count):
        anchor = model.jnt_pos[j]
        direct = j == first + count - 1 and np.abs(anchor).max() < _SMALL
        child = name if direct else free_name(f"{model.joint(j).name}_link", taken)
        if not direct:
            Xml.SubElement(root, "link", name=child)
        at = position + lie.quaternion_to_rotation(quaternion) @ anchor
        _movable(root, description, model, j, parent, child, at, quaternion)
        parent, position, quaternion = child, -anchor, unit
    if parent != name:
        _joint(root, free_name(f"{name}_fixed", taken), "fixed", parent, name, position, quaternion)


def _movable(
    root: Xml.Element, description: RobotDescription, model: mujoco.MjModel, j: int,
    parent: str, child: str, position: np.ndarray, quaternion: np.ndarray,
) -> None:  # fmt: skip
    name, limits = model.joint(j).name, description.limits
    kind = _JOINTS.get(mujoco.mjtJoint(int(model.jnt_type[j])), "floating")
    limited = bool(model.jnt_limited[j])
    if kind == "revolute" and not limited:
        kind = "continuous"
    joint = _joint(root, name, kind, parent, child, position, quaternion)
    if kind == "floating":
        return
    Xml.SubElement(joint, "axis", xyz=_text(model.jnt_axis[j]))
    bounds = {"velocity": limits.velocity.get(name, 1e3), "effort": limits.effort.get(name, 1e4)}
    if kind != "continuous":
        low, high = limits.position.get(name, model.jnt_range[j] if limited else (-1e3, 1e3))
        bounds |= {"lower": low, "upper": high}
    Xml.SubElement(joint, "limit", {k: f"{float(v):.9g}" for k, v in bounds.items()})


def _link(root: Xml.Element, model: mujoco.MjModel, i: int) -> None:
    link = Xml.SubElement(root, "link", name=model.body(i).name)
    if model.body_mass[i] > 0.0:
        inertial = Xml.SubElement(link, "inertial")
        _origin(inertial, model.body_ipos[i], model.body_iquat[i])
        Xml.SubElement(inertial, "mass", value=f"{model.body_mass[i]:.9g}")
        moments = dict(zip(("ixx", "iyy", "izz"), (f"{v:.9g}" for v in model.body_inertia[i]), strict=True))
        Xml.SubElement(inertial, "inertia", {**moments, "ixy": "0", "ixz": "0", "iyz": "0"})
    for g in range(model.ngeom):
        if int(model.geom_bodyid[g]) == i and model.geom_group[g] <= 2 and model.geom_rgba[g, 3] > 0.0:
            _visuals(link, model, g)


def _visuals(link: Xml.Element, model: mujoco.MjModel, g: int) -> None:
    size, position, quaternion = model.geom_size[g], model.geom_pos[g], model.geom_quat[g]
    kind = mujoco.mjtGeom(int(model.geom_type[g]))
    shapes: list[tuple[str, dict[str, str], np.ndarray]] = []
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        shapes.append(("box", {"size": _text(2.0 * size)}, position))
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        shapes.append(("sphere", {"radius": f"{size[0]:.9g}"}, position))
    if kind in (mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE):
        shapes.append(("cylinder", {"radius": f"{size[0]:.9g}", "length": f"{2.0 * size[1]:.9g}"}, position))
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        half = lie.quaternion_to_rotation(quaternion) @ np.array([0.0, 0.0, size[1]])
        shapes += [("sphere", {"radius": f"{size[0]:.9g}"}, position + end) for end in (half, -half)]
    for name, attributes, at in shapes:
        visual = Xml.SubElement(link, "visual")
        _origin(visual, at, quaternion)
        Xml.SubElement(Xml.SubElement(visual, "geometry"), name, attributes)
        material = Xml.SubElement(visual, "material", name=f"geom_{g}")
        Xml.SubElement(material, "color", rgba=_text(model.geom_rgba[g]))
