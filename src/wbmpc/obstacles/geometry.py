"""The shapes of a robot: those of its model's file, or by hand in its YAML; and where they are at a state."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import casadi as ca
import mujoco
import numpy as np
from numpy.typing import NDArray

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.model.tree import Frame
from wbmpc.obstacles import solids
from wbmpc.obstacles.solids import Solid
from wbmpc.robots.checks import compiled
from wbmpc.robots.collision import ShapeDescription
from wbmpc.robots.description import RobotDescription
from wbmpc.robots.inertia import replace_inertias
from wbmpc.robots.limited_program import strip_actuators_and_options
from wbmpc.robots.model_file import file_of, parse

_KINDS = {
    mujoco.mjtGeom.mjGEOM_SPHERE: "sphere", mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ellipsoid", mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder",
    mujoco.mjtGeom.mjGEOM_BOX: "box", mujoco.mjtGeom.mjGEOM_MESH: "mesh",
}  # fmt: skip
#: Directions in which a spinning part is measured: its circle is so found to within 0.01 %.
_DIRECTIONS = 256
#: Half sides [m] of the cubes whose balls cover a solid, at most; cylinders up to this radius [m] are covered along their axis.
BALL, THIN = 0.03, 0.15


@dataclass(frozen=True, eq=False)
class RobotShape:
    """A solid fixed to a frame (body or site) of a robot, in its axes."""

    frame: str
    solid: Solid


def frame_function(robot: RobotModel, frames: Sequence[Frame]) -> ca.Function:
    """Of a state (nx) the poses of frames: position (3) [m] and rotation by rows (9), one frame after the other."""
    x = ca.SX.sym("x", robot.state.size)
    chain = robot.base.chain(x)
    parts = [ca.vertcat(position, ca.vec(turn.T)) for position, turn in map(chain.frame_place, frames)]
    return ca.Function("frames", [x], [ca.cse(ca.densify(ca.vertcat(*parts)))])


def split_poses(found: Array) -> tuple[Array, Array]:
    """Positions (n, F, 3) and rotations (n, F, 3, 3) of results (n, 12 F) of a :func:`frame_function`."""
    each = found.reshape(len(found), -1, 12)
    return each[..., :3].copy(), each[..., 3:].reshape(*each.shape[:2], 3, 3).copy()


class Kinematics:
    """Where frames of a robot are at many states: positions (n, F, 3) [m] and rotations (n, F, 3, 3)."""

    def __init__(self, robot: RobotModel, frames: Sequence[Frame]) -> None:
        self._size, self._function = robot.state.size, frame_function(robot, frames)

    def __call__(self, states: Array) -> tuple[Array, Array]:
        """Of states (n, nx or more: what a problem adds comes after the robot's own)."""
        return split_poses(np.array(self._function(np.atleast_2d(states)[:, : self._size].T)).T)


class RobotGeometry:
    """Shapes of a robot by frame. ``shapes`` in the order of ``frames``; ``frame_of`` (s): of each shape the index of its frame."""

    def __init__(self, robot: RobotModel, shapes: Sequence[RobotShape]) -> None:
        self.robot = robot
        self.frames = tuple(dict.fromkeys(s.frame for s in shapes))
        self.shapes = tuple(sorted(shapes, key=lambda s: self.frames.index(s.frame)))
        self.frame_of = np.array([self.frames.index(s.frame) for s in self.shapes], int)
        self.radius = np.array([s.solid.radius for s in self.shapes])

    def fixed_to(self, frame: str) -> NDArray[np.int64]:
        """Indices of the shapes of a frame and of all frames that do not move against it."""
        same = np.array([rigid_link(self.robot, f) == rigid_link(self.robot, frame) for f in self.frames])
        return np.flatnonzero(same[self.frame_of])

    @cached_property
    def kinematics(self) -> Kinematics:
        """Poses of ``frames``."""
        return Kinematics(self.robot, [self.robot.tree.frames[f] for f in self.frames])

    @cached_property
    def extent(self) -> Array:
        """Of each frame the farthest point of its shapes from its origin (F) [m]."""
        far = np.zeros(len(self.frames))
        for s, f in zip(self.shapes, self.frame_of, strict=True):
            far[f] = max(far[f], float(np.linalg.norm(s.solid.position)) + s.solid.radius)
        return far

    @cached_property
    def lengths(self) -> Array:
        """How long (F, 3) [m] the shapes of each frame are together, along its axes."""
        low, high, axes = np.full((len(self.frames), 3), np.inf), np.full((len(self.frames), 3), -np.inf), np.eye(3)
        for s, f in zip(self.shapes, self.frame_of, strict=True):
            turn = s.solid.rotation
            ends = [s.solid.position + s.solid.support(sign * axes @ turn) @ turn.T for sign in (-1.0, 1.0)]
            low[f] = np.minimum(low[f], np.diagonal(ends[0]))
            high[f] = np.maximum(high[f], np.diagonal(ends[1]))
        return np.asarray(high - low)

    @cached_property
    def spheres(self) -> tuple[Array, Array, Array]:
        """Balls that cover all surfaces, for distances to points and grids: frame (b), center in it (b, 3), radius (b) [m]."""
        frames, centers, radii = [], [], []
        for shape, frame in zip(self.shapes, self.frame_of, strict=True):
            for center, radius in _cover(shape.solid):
                frames.append(int(frame))
                centers.append(center)
                radii.append(radius)
        return np.array(frames, int), np.array(centers).reshape(-1, 3), np.array(radii)

    def at(self, positions: Array, rotations: Array) -> tuple[Array, Array]:
        """Centers (n, s, 3) and axes (n, s, 3, 3) of all shapes at poses of the frames."""
        local = np.array([s.solid.position for s in self.shapes]).reshape(-1, 3)
        turn = np.array([s.solid.rotation for s in self.shapes]).reshape(-1, 3, 3)
        own = rotations[:, self.frame_of]
        return positions[:, self.frame_of] + np.einsum("nsij,sj->nsi", own, local), own @ turn


def _cover(solid: Solid) -> list[tuple[Array, float]]:
    """Balls (center in the frame, radius) that together contain a solid's surface: what is outside is nowhere nearer to the solid."""
    if solid.kind == "sphere":
        return [(solid.position, float(solid.size[0]))]
    half = solid.size.copy()
    if solid.kind in ("capsule", "cylinder"):
        r, h = float(solid.size[0]), float(solid.size[1])
        if solid.kind == "capsule" or r <= THIN:
            count = max(int(np.ceil(2.0 * h / max(r, BALL))), 1)
            radius, along = float(np.hypot(r, h / count)), np.linspace(-h, h, 2 * count + 1)[1::2]
            ends = [(-h, r), (h, r)] if solid.kind == "capsule" else []
            inner = [(float(z), radius) for z in along]
            return [(solid.position + z * solid.rotation[:, 2], rho) for z, rho in [*ends, *inner]]
        half = np.array([r, r, h])
    count3 = np.ceil(half / BALL).astype(int)
    part = half / count3
    grid = [part[a] * (2 * np.arange(count3[a]) + 1) - half[a] for a in range(3)]
    places3 = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, 3)
    radius = float(np.linalg.norm(part))
    depth = -solid.distance(places3)
    exact = solid.kind in (
        "box",
        "cylinder",
    )  # of others the distance is that of the box around them, whose surface is not theirs
    near = places3[(depth >= -radius) & ((depth <= radius) | (not exact))]
    if (
        solid.kind == "cylinder"
    ):  # what a ball covers of a convex solid is also covered from the ball's nearest point of it
        near[:, :2] *= np.minimum(1.0, half[0] / np.maximum(np.linalg.norm(near[:, :2], axis=1), 1e-9))[:, None]
    return [(solid.position + solid.rotation @ c, radius) for c in near]


_GEOMETRIES: WeakKeyDictionary[RobotModel, RobotGeometry] = WeakKeyDictionary()
_LOCK = threading.RLock()  # a signal's handler may come in the middle


def robot_geometry(robot: RobotModel) -> RobotGeometry:
    """The shapes of a robot, read once. Raises :class:`InputError` for a robot without any."""
    if not has_shapes(robot):
        where = f"{robot.description.source}: key 'collision.shapes'"
        raise InputError(f"{where}: {robot.description.model} has no shapes; give them by hand")
    return _GEOMETRIES[robot]


def has_shapes(robot: RobotModel) -> bool:
    """Whether a robot has any, by its file or its model. Raises :class:`InputError` where they cannot be read."""
    with _LOCK:
        if robot not in _GEOMETRIES:
            _GEOMETRIES[robot] = RobotGeometry(robot, _read(robot))
        return bool(_GEOMETRIES[robot].shapes)


def readable_shapes(robot: RobotModel) -> bool:
    """Whether a robot has shapes that can be read: for what does without where it cannot."""
    try:
        return has_shapes(robot)
    except InputError:
        return False


def _read(robot: RobotModel) -> list[RobotShape]:
    description = robot.description
    given = description.collision.shapes
    if given is not None:
        missing = [s.frame for s in given if s.frame not in robot.frames]
        if missing:
            raise InputError(
                f"{description.source}: key 'collision.shapes': frame '{missing[0]}' is no part of the robot's base or arm"
            )
        return [RobotShape(s.frame, _by_hand(s)) for s in given]
    return _of_model(robot)


def _by_hand(shape: ShapeDescription) -> Solid:
    if shape.kind == "sphere":
        return solids.sphere(shape.radius, np.array(shape.center))
    if shape.kind == "box":
        q = np.array(shape.orientation)
        turn = lie.quaternion_to_rotation(q / np.linalg.norm(q))
        return Solid("box", np.array(shape.half, float), np.array(shape.center), turn)
    return solids.along(shape.kind, np.array(shape.a, float), np.array(shape.b, float), shape.radius)


def _raw_model(description: RobotDescription) -> mujoco.MjModel:
    """The file with the shapes that collide, as its author drew it."""
    spec = parse(file_of(description), collision=True)
    strip_actuators_and_options(spec)
    for element in [*spec.sensors, *spec.keys]:  # what they refer to may be gone
        spec.delete(element)
    replace_inertias(spec, balance=True)
    spec.compiler.fusestatic = False
    return compiled(spec, description.model)


def _of_model(robot: RobotModel) -> list[RobotShape]:
    """Per body those geoms that collide, or all where none does. Wheels, and parts that the planner does not know, stand as all that
    they sweep, on the body they hang on."""
    model = _raw_model(robot.description)
    found = []
    for body in range(1, model.nbody):
        first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
        geoms = [g for g in range(first, first + count) if mujoco.mjtGeom(int(model.geom_type[g])) in _KINDS]
        collide = [g for g in geoms if model.geom_contype[g] or model.geom_conaffinity[g]]
        parts = [_solid(model, g) for g in collide or geoms]
        place = _attach(robot, model, body, parts)
        if place is not None:
            found += [RobotShape(place[0], solid) for solid in place[1]]
    return found


def _solid(model: mujoco.MjModel, geom: int) -> Solid:
    kind = _KINDS[mujoco.mjtGeom(int(model.geom_type[geom]))]
    position, turn = model.geom_pos[geom].copy(), lie.quaternion_to_rotation(model.geom_quat[geom].copy())
    if kind != "mesh":
        return Solid(kind, model.geom_size[geom].copy(), position, turn)
    mesh = int(model.geom_dataid[geom])
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = np.array(model.mesh_vert[first : first + count], float)
    try:
        return solids.mesh(vertices).moved(position, turn)
    except ValueError:  # a flat mesh: the box around it
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        half = np.maximum(0.5 * (high - low), 1e-4)
        return Solid("box", half, 0.5 * (low + high)).moved(position, turn)


def _attach(robot: RobotModel, model: mujoco.MjModel, body: int, parts: list[Solid]) -> tuple[str, list[Solid]] | None:
    """The frame that carries shapes of a body, and what they are there; None for what is no part of the robot."""
    spins = set(robot.description.base.joints())
    while body > 0 and parts:
        name, joints = (
            model.body(body).name,
            range(int(model.body_jntadr[body]), int(model.body_jntadr[body]) + int(model.body_jntnum[body])),
        )
        turns = [j for j in joints if model.joint(j).name in spins and not model.jnt_limited[j]]
        if name in robot.tree.frames and not turns:
            return name, parts
        if turns:
            parts = [_revolved(parts, model.jnt_pos[turns[0]], model.jnt_axis[turns[0]])]
        elif [j for j in joints if int(model.jnt_type[j]) == int(mujoco.mjtJoint.mjJNT_BALL)]:
            parts = [_rolled(parts, model.jnt_pos[int(joints[0])])]
        turn = lie.quaternion_to_rotation(model.body_quat[body].copy())
        parts = [p.moved(model.body_pos[body].copy(), turn) for p in parts]
        body = int(model.body_parentid[body])
    return None


def _reaches(part: Solid, direction: Array, about: Array) -> Array:
    """How far (n) a part reaches along unit directions (n, 3) from a point."""
    return np.asarray(
        np.sum((part.support(direction @ part.rotation) @ part.rotation.T + part.position - about) * direction, axis=1)
    )


def _revolved(parts: Sequence[Solid], position: Array, axis: Array) -> Solid:
    """The cylinder that parts sweep when they turn about an axis."""
    axes = solids.axes_along(np.asarray(axis, float))
    angle = np.linspace(0.0, 2.0 * np.pi, _DIRECTIONS, endpoint=False)
    around = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1) @ axes.T
    radius = max(float(_reaches(p, around, position).max()) for p in parts)
    up = max(float(_reaches(p, axes[None, :, 2], position)[0]) for p in parts)
    down = max(float(_reaches(p, -axes[None, :, 2], position)[0]) for p in parts)
    return solids.along("cylinder", position - down * axes[:, 2], position + up * axes[:, 2], radius)


def _rolled(parts: Sequence[Solid], position: Array) -> Solid:
    """The ball that parts sweep when they turn about a point."""
    radius = max(
        float(np.linalg.norm(p.position - position)) + (float(p.size[0]) if p.kind == "sphere" else p.radius)
        for p in parts
    )
    return solids.sphere(radius, np.asarray(position, float))


def path_of(robot: RobotModel, link: int) -> list[int]:
    """Links from the root to one."""
    path: list[int] = []
    while link >= 0:
        path.insert(0, link)
        link = robot.tree.links[link].parent
    return path


def rigid_link(robot: RobotModel, frame: str) -> int:
    """The highest link that does not move against a frame."""
    links, link = robot.tree.links, robot.tree.frames[frame].link
    while links[link].joint is None and links[link].parent >= 0:
        link = links[link].parent
    return link


def common_link(robot: RobotModel, first: int, second: int) -> int:
    """The last link that two links hang on."""
    pairs = zip(path_of(robot, first), path_of(robot, second))
    return [a for a, b in pairs if a == b][-1]


def link_frames(links: Sequence[int]) -> list[Frame]:
    return [Frame(link, np.zeros(3), np.eye(3)) for link in links]
