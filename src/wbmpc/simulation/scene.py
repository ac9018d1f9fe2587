"""What a simulated world looks like: shapes, bodies and forces as plain numbers, for recordings and views."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from wbmpc.arrays import Array
from wbmpc.kernel.ir import Floats, Integers
from wbmpc.kernel.step import bind
from wbmpc.simulation.compilation import step


@step
def from_base(
    base: Floats, rotation: Floats, tool: Floats, tool_rotation: Floats, seen: Floats, turned: Floats
) -> None:
    """Position ``seen`` (3) and rotation ``turned`` (3, 3) in the base's axes of a ``tool``; both in world axes."""
    for i in range(3):
        seen[i] = 0.0
        for j in range(3):
            seen[i] += rotation[3 * j + i] * (tool[j] - base[j])
            turned[3 * i + j] = 0.0
            for k in range(3):
                turned[3 * i + j] += rotation[3 * k + i] * tool_rotation[3 * k + j]


@step
def in_parents(poses: Floats, moving: Integers, parents: Integers, links: Floats, n: int) -> None:
    """``links`` (n, 7): rows ``moving`` (n) of ``poses`` in the frames of rows ``parents`` (n), position and quaternion."""
    for k in range(n):
        a, b, out = 7 * parents[k], 7 * moving[k], 7 * k
        w, x, y, z = poses[a + 3], poses[a + 4], poses[a + 5], poses[a + 6]
        p, q, r, s = poses[b + 3], poses[b + 4], poses[b + 5], poses[b + 6]
        dx, dy, dz = poses[b] - poses[a], poses[b + 1] - poses[a + 1], poses[b + 2] - poses[a + 2]
        links[out] = (1.0 - 2.0 * (y * y + z * z)) * dx + 2.0 * (x * y + w * z) * dy + 2.0 * (x * z - w * y) * dz
        links[out + 1] = 2.0 * (x * y - w * z) * dx + (1.0 - 2.0 * (x * x + z * z)) * dy + 2.0 * (y * z + w * x) * dz
        links[out + 2] = 2.0 * (x * z + w * y) * dx + 2.0 * (y * z - w * x) * dy + (1.0 - 2.0 * (x * x + y * y)) * dz
        links[out + 3] = w * p + x * q + y * r + z * s
        links[out + 4] = w * q - x * p - y * s + z * r
        links[out + 5] = w * r + x * s - y * p - z * q
        links[out + 6] = w * s - x * r + y * q - z * p


#: Contact forces below this [N] are none.
_MIN_FORCE = 1e-9
#: A part of a robot without shapes is drawn as rods to the parts on it: radius, shortest [m], color.
_ROD, _SHORTEST, _GRAY = 0.015, 0.03, (0.6, 0.6, 0.6, 1.0)
#: Of a scene from a file: more than a browser draws many times a second.
MAX_BODIES, MAX_SHAPES = 2_000, 5_000
_KINDS = {
    mujoco.mjtGeom.mjGEOM_PLANE: "plane", mujoco.mjtGeom.mjGEOM_BOX: "box", mujoco.mjtGeom.mjGEOM_SPHERE: "sphere",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder", mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ellipsoid", mujoco.mjtGeom.mjGEOM_MESH: "mesh",
}  # fmt: skip


@dataclass(frozen=True)
class Shape:
    """A colored shape of a body. ``kind`` and ``size`` as in MuJoCo: half lengths of a box; radius; radius and half length
    of a cylinder or capsule along z; semi-axes; a plane's half lengths (0: endless). ``pose``: position [m] and quaternion
    in the body. ``color``: red, green, blue, opacity. A mesh has ``vertices`` [m] and ``faces``."""

    body: str
    kind: str
    size: tuple[float, ...]
    pose: tuple[float, ...]
    color: tuple[float, ...]
    vertices: tuple[float, ...] = ()
    faces: tuple[int, ...] = ()


@dataclass(frozen=True)
class Body:
    """A body, its parent's name (``world`` for roots) and whether it can move against it."""

    name: str
    parent: str
    moves: bool


@dataclass(frozen=True)
class Contact:
    """What acts on a body in its contacts: ``force`` (3) [N] on it, world axes, at ``point`` (3) [m]."""

    body: str
    force: Array
    point: Array


@dataclass(frozen=True)
class Scene:
    """Bodies and shapes of a world; ``robot``: the name of the robot's base body."""

    robot: str
    bodies: tuple[Body, ...]
    shapes: tuple[Shape, ...]

    @property
    def index(self) -> int:
        """The place of the robot's base among the bodies."""
        return [b.name for b in self.bodies].index(self.robot)

    def plain(self) -> dict[str, Any]:
        """What JSON can hold; :meth:`of_plain` makes a scene of it again."""
        return asdict(self)

    @classmethod
    def of_plain(cls, data: dict[str, Any]) -> Scene:
        """The inverse of :meth:`plain`. Raises KeyError or TypeError for what it cannot have made."""
        shapes: list[dict[str, Any]] = [
            {k: tuple(v) if isinstance(v, list) else v for k, v in s.items()} for s in data["shapes"]
        ]
        scene = cls(data["robot"], tuple(Body(**b) for b in data["bodies"]), tuple(Shape(**s) for s in shapes))
        _check(scene)
        return scene


def _check(scene: Scene) -> None:
    """Raise TypeError naming what of a scene from a file is of another kind than a drawing needs, or too much for one."""
    if len(scene.bodies) > MAX_BODIES or len(scene.shapes) > MAX_SHAPES:
        raise TypeError(
            f"{len(scene.bodies)} bodies and {len(scene.shapes)} shapes; at most {MAX_BODIES} and {MAX_SHAPES} are drawn"
        )
    names = [body.name for body in scene.bodies]
    for body in scene.bodies:
        if not (isinstance(body.name, str) and isinstance(body.parent, str) and isinstance(body.moves, bool)):
            raise TypeError(f"a body needs a name, a parent and whether it moves, got {body!r:.80}")
    if scene.robot not in names:
        raise TypeError(f"there is no body of the robot's name {scene.robot!r:.40}")
    known, places = set(_KINDS.values()), {*names, "world"}
    for shape in scene.shapes:
        if shape.kind not in known or shape.body not in places:
            raise TypeError(
                f"a shape of kind {shape.kind!r:.40} on body {shape.body!r:.40}; valid: {', '.join(sorted(known))}"
            )
        for field, count in (("size", 3), ("pose", 7), ("color", 4), ("vertices", None), ("faces", None)):
            values = getattr(shape, field)
            if (
                not isinstance(values, tuple)
                or not all(_is_number(v) for v in values)
                or count not in (None, len(values))
            ):
                raise TypeError(f"'{field}' of a shape needs {count or 'several'} numbers, got {values!r:.80}")
        if (
            len(shape.vertices) % 3
            or len(shape.faces) % 3
            or any(not 0 <= 3 * f < len(shape.vertices) for f in shape.faces)
        ):
            raise TypeError(f"the mesh of body {shape.body!r:.40} has faces without vertices")


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e300


class SceneReader:
    """Reads a world of MuJoCo: its :class:`Scene`, and at any time poses, joints and contact forces. ``names``: what bodies are
    called, if otherwise than in the model; ``robot`` is one of these. A robot whose links hang on the world itself has that for its base,
    which is a body of the scene then."""

    def __init__(self, model: mujoco.MjModel, robot: str, names: Mapping[str, str] | None = None) -> None:
        self.model = model
        own = [model.body(i).name or f"body_{i}" for i in range(model.nbody)]
        self._names = [(names or {}).get(name, name) for name in own]
        self._first = 0 if self._names[0] == robot else 1  # body of the model that is the scene's first
        drawn = self._shapes()
        self.scene = Scene(robot, self._bodies(), (*drawn, *self._rods(robot, {s.body for s in drawn})))
        self.joints = [i for i in range(model.njnt) if int(model.jnt_type[i]) >= int(mujoco.mjtJoint.mjJNT_SLIDE)]
        places = {b.name: k for k, b in enumerate(self.scene.bodies)}
        self.parents = [places.get(b.parent, -1) for b in self.scene.bodies]  # -1: the world
        self.moving = [i for i, b in enumerate(self.scene.bodies) if b.moves and i != self.scene.index]
        self._positions, self._speeds = model.jnt_qposadr[self.joints], model.jnt_dofadr[self.joints]
        self._body_of = model.geom_bodyid.tolist()
        self.joint_names = [model.joint(i).name or f"joint_{i}" for i in self.joints]

    @cached_property
    def _scratch(self) -> mujoco.MjData:
        return mujoco.MjData(self.model)

    def _bodies(self) -> tuple[Body, ...]:
        m, parents = self.model, [self._names[int(i)] for i in self.model.body_parentid]
        parents[0] = "world"
        return tuple(
            Body(self._names[i], parents[i], bool(m.body_jntnum[i] or m.body_mocapid[i] >= 0))
            for i in range(self._first, m.nbody)
        )

    def _shapes(self) -> tuple[Shape, ...]:
        """What can be seen: groups 0 to 2 (contact shapes are in group 3) that are not transparent."""
        m, shapes = self.model, []
        for g in range(m.ngeom):
            kind = _KINDS.get(mujoco.mjtGeom(m.geom_type[g]))
            if kind is None or m.geom_group[g] > 2 or m.geom_rgba[g, 3] == 0.0:
                continue
            vertices, faces = self._mesh(int(m.geom_dataid[g])) if kind == "mesh" else ((), ())
            body = self._names[int(m.geom_bodyid[g])]
            pose = (*map(float, m.geom_pos[g]), *map(float, m.geom_quat[g]))
            color = m.mat_rgba[m.geom_matid[g]] if m.geom_matid[g] >= 0 else m.geom_rgba[g]
            shapes.append(
                Shape(body, kind, tuple(map(float, m.geom_size[g])), pose, tuple(map(float, color)), vertices, faces)
            )
        return tuple(shapes)

    def _rods(self, robot: str, drawn: set[str]) -> Iterator[Shape]:
        """Of the robot's parts with a mass that have no shape, since their meshes are missing or of a format that is not read."""
        m, root = self.model, self._names.index(robot)
        for i in range(root + 1, m.nbody):
            parent, length = int(m.body_parentid[i]), float(np.linalg.norm(m.body_pos[i]))
            name = self._names[parent]
            if (
                m.body_rootid[i] != m.body_rootid[root]
                or name in drawn
                or not m.body_mass[parent]
                or length < _SHORTEST
            ):
                continue
            turn = np.empty(4)
            mujoco.mju_quatZ2Vec(turn, m.body_pos[i] / length)
            pose = (*map(float, 0.5 * m.body_pos[i]), *map(float, turn))
            yield Shape(name, "capsule", (_ROD, 0.5 * length, 0.0), pose, _GRAY)

    def _mesh(self, mesh: int) -> tuple[tuple[float, ...], tuple[int, ...]]:
        m = self.model
        v, n = int(m.mesh_vertadr[mesh]), int(m.mesh_vertnum[mesh])
        f, k = int(m.mesh_faceadr[mesh]), int(m.mesh_facenum[mesh])
        vertices, faces = m.mesh_vert[v : v + n].ravel().tolist(), m.mesh_face[f : f + k].ravel().tolist()
        return tuple(vertices), tuple(faces)

    # ------------------------------------------------------------------ the present state
    def poses(self, data: mujoco.MjData) -> Array:
        """Poses (bodies, 7) in the world: position [m] and quaternion, in the order of the scene's bodies."""
        return np.hstack([data.xpos[self._first :], data.xquat[self._first :]])

    @cached_property
    def _in_parents(self) -> tuple[Array, Array, Callable[[], None]]:
        """Poses of all bodies and then of the world, poses of those that move in their parents, and what makes these of those."""
        world = len(self.scene.bodies)
        poses, links = np.tile([0.0, 0, 0, 1, 0, 0, 0], (world + 1, 1)), np.zeros((len(self.moving), 7))
        above = [self.parents[i] for i in self.moving]
        rows = {"moving": self.moving, "parents": [world if i < 0 else i for i in above]}
        arrays = {name: np.array(row, np.int64) for name, row in rows.items()} | {"poses": poses, "links": links}
        return poses, links, bind(in_parents, arrays, n=len(links)).call

    def links(self, bodies: Array) -> Array:
        """Poses (n, 7) of the bodies ``moving`` in the bodies that they hang on; ``bodies`` (bodies, 7): :meth:`poses`."""
        poses, links, relate = self._in_parents
        poses[:-1] = bodies
        relate()
        return links.copy()

    def joint_states(self, data: mujoco.MjData) -> Array:
        """Position [rad or m], velocity and drive force [N m or N] (joints, 3) of all hinges and slides."""
        states = np.empty((len(self.joints), 3))
        states[:, 0], states[:, 1] = data.qpos[self._positions], data.qvel[self._speeds]
        states[:, 2] = data.qfrc_actuator[self._speeds]
        return states

    def contacts(self, data: mujoco.MjData) -> list[Contact]:
        """Sums of the contact forces by body, in the present state under the last command, at their center of pressure.

        Computed on a copy: between two steps MuJoCo holds the contacts of now with the forces of before.
        """
        m, d = self.model, self._scratch
        mujoco.mj_copyState(m, data, d, int(mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_forward(m, d)
        forces: dict[int, tuple[list[float], list[float], float]] = {}
        local, nothing, contacts = np.zeros(6), [0.0, 0.0, 0.0], d.contact
        # one by one, Python's own numbers are several times as fast
        rows = zip(contacts.geom.tolist(), contacts.pos.tolist(), contacts.frame.tolist(), strict=True)
        for c, (geoms, at, axes) in enumerate(rows):
            mujoco.mj_contactForce(m, d, c, local)
            x, y, z = local[:3].tolist()
            force = [
                x * axes[i] + y * axes[3 + i] + z * axes[6 + i] for i in range(3)
            ]  # on the second geom, by the first
            size = math.hypot(*force)
            if size < _MIN_FORCE:
                continue
            for geom, sign in zip(geoms, (-1.0, 1.0), strict=True):
                body = self._body_of[geom]
                if body:
                    total, moment, weight = forces.get(body, (nothing, nothing, 0.0))
                    total = [a + sign * b for a, b in zip(total, force, strict=True)]
                    moment = [a + size * b for a, b in zip(moment, at, strict=True)]
                    forces[body] = (total, moment, weight + size)
        return [Contact(self._names[b], np.array(f), np.array(p) / w) for b, (f, p, w) in sorted(forces.items())]


def joint_units(model: mujoco.MjModel) -> dict[str, str]:
    """Units of the positions of a world's joints that turn or slide, by their names."""
    known = {mujoco.mjtJoint.mjJNT_HINGE: "rad", mujoco.mjtJoint.mjJNT_SLIDE: "m"}
    joints = ((model.joint(i).name, mujoco.mjtJoint(int(model.jnt_type[i]))) for i in range(model.njnt))
    return {name: known[kind] for name, kind in joints if name and kind in known}


def drive_limits(model: mujoco.MjModel) -> dict[str, tuple[float, float]]:
    """(lower, upper) force or torque of each joint whose drive in the plant has limits."""
    found = {}
    for k in np.flatnonzero(model.actuator_forcelimited):
        if model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT:
            low, high = sorted(model.actuator_gear[k, 0] * model.actuator_forcerange[k])
            found[model.joint(model.actuator_trnid[k, 0]).name] = (float(low), float(high))
    return found
