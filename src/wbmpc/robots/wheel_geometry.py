"""The radius of a wheel as its shapes have it, against the one that the description gives."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import mujoco
import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.input_file import read_file
from wbmpc.robots.actuation import number
from wbmpc.robots.file_limits import LARGEST_MESH
from wbmpc.robots.model_file import ModelFile, file_of

if TYPE_CHECKING:
    from wbmpc.bases.base import Radius
    from wbmpc.robots.description import RobotDescription

#: Bytes before the first triangle of a binary STL file, and of each: normal, three points, an attribute.
_HEAD, _TRIANGLE = 84, np.dtype([("normal", "<f4", 3), ("points", "<f4", (3, 3)), ("attribute", "<u2")])
_VERTICES = {
    ".stl": re.compile(rb"^\s*vertex\s+(.+)$", re.MULTILINE),
    ".obj": re.compile(rb"^\s*v\s+(.+)$", re.MULTILINE),
}


def mesh_points(path: Path) -> Array | None:
    """Points (n, 3) of an STL or OBJ file in its own unit; None of other formats, of files that cannot be read or are too large, and of
    what holds no finite points."""
    kind = path.suffix.lower()
    if kind not in _VERTICES:
        return None
    try:
        data = read_file(path, LARGEST_MESH)
        points = _binary(data) if kind == ".stl" else None
        if points is None:
            words = [line.split()[:3] for line in _VERTICES[kind].findall(data)]
            points = np.array([[float(word) for word in row] for row in words if len(row) == 3], float)
    except (InputError, ValueError):
        return None
    return points if points.size and np.isfinite(points).all() else None


def _binary(data: bytes) -> Array | None:
    """Points of a binary STL file; None of what has not the length of one."""
    count = int.from_bytes(data[_HEAD - 4 : _HEAD], "little")
    if len(data) != _HEAD + count * _TRIANGLE.itemsize:
        return None
    return np.frombuffer(data, _TRIANGLE, offset=_HEAD)["points"].reshape(-1, 3).astype(float)


#: How far [of it] a described radius may be from that of the shapes: tires wear, and are pressed flat.
MAXIMUM = 0.05
#: How far a round shape's axis may be from the wheel's: angle [rad], and distance [of its radius].
TILT, BESIDE = 0.02, 0.05
#: A mesh is round if it reaches so far in all of so many directions, as a share of its outermost point: a prism of eight sides is, a box is
#: not.
ROUND, DIRECTIONS = 0.9, 72
_ROUND = {mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_ELLIPSOID}


def check_radii(description: RobotDescription, model: mujoco.MjModel) -> None:
    """Raise :class:`InputError` naming both figures where the shapes of a wheel, or of a body that is a ball, have another
    radius than the description.

    A wheel without round shapes about its axis, of meshes that cannot be read (see :func:`mesh_points`), or of
    several bodies (whose tire may be another one) cannot be checked.
    """
    for radius in description.base.radii():
        if radius.sphere:
            drawn = _of_sphere(model, radius.name)
        else:
            drawn = drawn_radius(description, model, radius.name)
        _compare(description, radius, drawn)


def drawn_radius(description: RobotDescription, model: mujoco.MjModel, wheel: str) -> float | None:
    """Radius [m] of the wheel on joint ``wheel`` as its shapes have it; None where they do not show it."""
    return radius_of(file_of(description), model, wheel)


def radius_of(file: ModelFile, model: mujoco.MjModel, wheel: str) -> float | None:
    """The same of a file that is read and compiled."""
    return _of_model(model, wheel) if file.root is None else _of_urdf(file, file.root, wheel)


def _compare(description: RobotDescription, radius: Radius, drawn: float | None) -> None:
    if drawn is not None and abs(radius.value - drawn) > MAXIMUM * drawn:
        raise InputError(
            f"{description.source}: key '{radius.key}': {radius.value:g} m, but the shape of the {radius.what} '{radius.name}' in "
            f"{description.model} has a radius of {drawn:.4g} m; they may differ by {100 * MAXIMUM:g} % at most"
        )


def _of_model(model: mujoco.MjModel, joint: str) -> float | None:
    """The largest radius [m] of what is round about the axis of a joint; a round mesh counts by its outermost point."""
    j = model.joint(joint).id
    if (model.body_parentid == model.jnt_bodyid[j]).any():
        return None
    axis, anchor = model.jnt_axis[j], model.jnt_pos[j]
    found = []
    for g in np.flatnonzero(model.geom_bodyid == model.jnt_bodyid[j]):
        kind, size = mujoco.mjtGeom(int(model.geom_type[g])), model.geom_size[g]
        turned = lie.quaternion_to_rotation(model.geom_quat[g].copy())
        center = model.geom_pos[g] - anchor
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = int(model.geom_dataid[g])
            start = int(model.mesh_vertadr[mesh])
            points = model.mesh_vert[start : start + int(model.mesh_vertnum[mesh])] @ turned.T + center
            found += _outline(points, axis)
            continue
        if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            flat = int(np.argmax(np.abs(turned.T @ axis)))
            turned, size = np.roll(turned, 2 - flat, axis=1), np.sort(np.delete(size, flat))[::-1]
        if not (kind == mujoco.mjtGeom.mjGEOM_SPHERE or (kind in _ROUND and _along(turned[:, 2], axis))):
            continue
        if np.linalg.norm(np.cross(center, axis)) <= BESIDE * size[0]:
            found.append(float(size[0]))
    return max(found, default=None)


def _of_sphere(model: mujoco.MjModel, body: str) -> float | None:
    geoms = np.flatnonzero(model.geom_bodyid == model.body(body).id)
    spheres = [float(model.geom_size[g][0]) for g in geoms if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_SPHERE]
    return max(spheres, default=None)


def _outline(points: np.ndarray, axis: np.ndarray) -> list[float]:
    """The radius [m] of a mesh of ``points`` (n, 3) [m] about an ``axis`` (3) through the origin, as a list of one; empty where it is not round
    about that, as the boxes are that stand for wheels in collision meshes."""
    across = np.linalg.svd(axis[None])[2][1:]
    angles = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False)
    reach = (points @ across.T @ np.array([np.cos(angles), np.sin(angles)])).max(axis=0)
    radius = float(np.linalg.norm(np.cross(points, axis), axis=1).max())
    return [radius] if reach.min() >= ROUND * radius else []


def _along(one: np.ndarray, other: np.ndarray) -> bool:
    return bool(np.linalg.norm(np.cross(one, other)) <= math.sin(TILT))


# ---------------------------------------------------------------------- URDF, whose shapes MuJoCo is not given
def _of_urdf(file: ModelFile, root: ElementTree.Element, joint: str) -> float | None:
    """The same of a URDF's own text and its mesh files; None where one of the wheel's cannot be read."""
    element = next((j for j in root.iter("joint") if j.get("name") == joint), None)
    child = None if element is None else element.find("child")
    link = next((k for k in root.iter("link") if child is not None and k.get("name") == child.get("link")), None)
    if element is None or link is None:
        return None
    parents = [p.get("link") for j in root.iter("joint") if (p := j.find("parent")) is not None]
    if link.get("name") in parents:
        return None
    axis = _vector(element.find("axis"), "xyz", (1.0, 0.0, 0.0))
    axis /= np.linalg.norm(axis)
    found = []
    for shape in [*link.findall("collision"), *link.findall("visual")]:
        geometry = shape.find("geometry")
        kinds = [] if geometry is None else list(geometry)
        origin = shape.find("origin")
        roll, pitch, yaw = _vector(origin, "rpy", (0.0, 0.0, 0.0))
        center, turned = _vector(origin, "xyz", (0.0, 0.0, 0.0)), lie.euler_zyx_to_rotation(yaw, pitch, roll)
        beside = np.linalg.norm(np.cross(center, axis))
        for kind in kinds:
            if kind.tag == "mesh":
                at = file.locate(kind.get("filename", ""))
                points = None if at is None else mesh_points(at)
                if points is None:
                    return None
                placed = (points * _vector(kind, "scale", (1.0, 1.0, 1.0))) @ turned.T + center
                found += _outline(placed, axis)
            radius = number(kind.get("radius"))
            if kind.tag == "cylinder" and not _along(turned[:, 2], axis):
                continue
            if kind.tag in ("cylinder", "sphere") and radius is not None and beside <= BESIDE * radius:
                found.append(radius)
    return max(found, default=None)


def _vector(element: ElementTree.Element | None, name: str, default: tuple[float, float, float]) -> np.ndarray:
    words = "" if element is None else element.get(name, "")
    values = [number(word) for word in words.split()]
    ok = len(values) == 3 and all(v is not None for v in values)
    return np.array(values if ok else default, float)
