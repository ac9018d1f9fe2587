"""A scene of obstacles in the simulated world: bodies in MuJoCo, what the planner sees of them, and how near the robot really comes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.obstacles.scene import SceneObstacle, read_scene
from wbmpc.obstacles.shapes import DistanceGrid, HalfSpace
from wbmpc.obstacles.solids import axes_along
from wbmpc.obstacles.world import Obstacle, Obstacles, Snapshot, place_all
from wbmpc.simulation.contacts import APART, FAR, FIXED, OBSTACLE

#: The frame in which the planner sees the scene.
SCENE = "scene"
#: Names of the obstacles' bodies begin so; where those are that have not appeared.
_PREFIX, _HIDDEN = "obstacle:", np.array([0.0, 0.0, -100.0])
_COLOR = [0.85, 0.45, 0.2, 1.0]
#: A robot that moves into an obstacle with less than this [m/s] does not cause the contact.
AT_REST = 0.02
#: Half lengths [m] of the plate that a half-space is in the world.
_PLATE = 50.0


def load_scene(path: str | Path) -> list[SceneObstacle]:
    """The obstacles of a YAML file, checked. Raises :class:`InputError` naming file, obstacle and key."""
    scene = list(read_scene(path, simulated=True))
    place_all(scene, Obstacles())
    return scene


class SimulatedObstacles:
    """Obstacles that move at constant velocities from when they appear. Coordinates are those of the planner's world, in which the floor is at
    ``ground`` [m].

    ``least`` [m]: the smallest true distance of the robot to any of them so far; ``nearest``: the name of the one nearest to it when it was measured
    last, empty if none is near; ``contacts``: how often it began to touch one;
    ``contact_speed`` [m/s]: the largest speed at which a part of the robot moved into one when a contact began; ``caused``: how many began
    with such a speed above :data:`AT_REST`, the others came to a robot that stood or backed off; ``pushed`` [s]: the longest time in
    which one of them touched the robot.
    """

    def __init__(self, scene: Sequence[SceneObstacle], ground: float = 0.0) -> None:
        self.scene, self._ground = list(scene), ground
        world = Obstacles()
        for one in self.scene:
            if isinstance(one.shape, DistanceGrid):
                raise InputError(f"{one.where or one.name}: a distance grid cannot be simulated; valid: other shapes")
            world.set(one.name, one.shape, seen=one.appears, **one.place)
        self._by_name = {o.name: o for o in world.snapshot(0.0).obstacles}
        self.least, self.nearest, self.contacts, self.contact_speed = FAR, "", 0, 0.0
        self.caused, self.pushed = 0, 0.0
        self._model: mujoco.MjModel | None = None
        self._known: set[str] = set()
        self._touching: dict[tuple[int, int], float] = {}
        self._pushes: dict[str, tuple[float, float]] = {}  # of an obstacle: since when and until when it touches

    # ------------------------------------------------------------------ the world
    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add a body for each obstacle to MuJoCo's scene; none has a mass, for nothing moves them."""
        for one in self.scene:
            at, turn = self._pose(self._by_name[one.name], 0.0)
            body = spec.worldbody.add_body(name=_PREFIX + one.name, mocap=True, pos=at, quat=turn)
            if isinstance(one.shape, HalfSpace):
                self._add_plate(body, one.shape)
                continue
            assert not isinstance(one.shape, DistanceGrid)
            solid = one.shape.solid
            point = solid.kind == "capsule" and solid.size[1] == 0.0  # a sphere, for MuJoCo
            geom = body.add_geom(
                type=getattr(mujoco.mjtGeom, f"mjGEOM_{'SPHERE' if point else solid.kind.upper()}"), size=solid.size,
                pos=solid.position, quat=lie.rotation_to_quaternion(solid.rotation), rgba=_COLOR, density=0.0, **OBSTACLE,
            )  # fmt: skip
            if solid.kind == "mesh":
                mesh = spec.add_mesh(name=_PREFIX + one.name, uservert=solid.vertices.ravel())
                mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
                geom.meshname = mesh.name

    def _add_plate(self, body: mujoco.MjsBody, shape: HalfSpace) -> None:
        """A thick plate: MuJoCo's planes do not move."""
        n = np.asarray(shape.normal, float)
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=[_PLATE, _PLATE, 1.0], pos=n * (shape.offset - 1.0),
            quat=lie.rotation_to_quaternion(axes_along(n)), rgba=_COLOR, density=0.0, **OBSTACLE,
        )  # fmt: skip

    def bind(self, model: mujoco.MjModel) -> None:
        """Take the compiled model in which they are."""
        self._model = model
        bodies = {name: model.body(_PREFIX + name).id for name in self._by_name}
        self._mocap = {name: int(model.body_mocapid[b]) for name, b in bodies.items()}
        self._name_of = {b: name for name, b in bodies.items()}
        others = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in self._name_of]
        own = np.flatnonzero(model.geom_conaffinity & FIXED)
        self._pairs = np.array([(g, o) for g in own for o in others], int).reshape(-1, 2)
        self._others = np.array(others, int)
        self._reach = model.geom_rbound[self._pairs].sum(axis=1)

    def place(self, data: mujoco.MjData, t: float) -> None:
        """Put the bodies to where they are at ``t`` [s]."""
        for name, obstacle in self._by_name.items():
            data.mocap_pos[self._mocap[name]], data.mocap_quat[self._mocap[name]] = self._pose(obstacle, t)

    def _pose(self, obstacle: Obstacle, t: float) -> tuple[Array, Array]:
        """Position (3) and quaternion (4) in MuJoCo's world, whose floor is at 0."""
        if t < obstacle.seen:
            return _HIDDEN, obstacle.orientation
        return Snapshot().pose(obstacle, np.array([t]))[0][0] - [0.0, 0.0, self._ground], obstacle.orientation

    # ------------------------------------------------------------------ the planner
    def show(self, world: Obstacles, t: float, true: Array, estimated: Array) -> None:
        """Put to ``world`` what is there at ``t`` [s], as seen from the robot, whose base is at ``true`` (x, y, yaw) and believed to be at
        ``estimated``."""
        turn = estimated[2] - true[2]
        c, s = np.cos(turn), np.sin(turn)
        shift = estimated[:2] - np.array([[c, -s], [s, c]]) @ true[:2]
        world.set_frame(SCENE, [*shift, 0.0], [np.cos(0.5 * turn), 0.0, 0.0, np.sin(0.5 * turn)])
        for one in self.scene:
            obstacle = self._by_name[one.name]
            moves = bool(obstacle.velocity.any())
            if t < one.appears or (one.name in self._known and not moves):
                continue
            self._known.add(one.name)
            seen = dict(one.place)
            if moves:  # seen again all the time: what is not known of its velocity counts from now on
                seen["position"] = Snapshot().pose(obstacle, np.array([t]))[0][0]
            world.set(one.name, one.shape, seen=max(t, one.appears) if moves else one.appears, frame=SCENE, **seen)

    # ------------------------------------------------------------------ the truth
    def distance(self, data: mujoco.MjData) -> float:
        """The least distance [m] now, :data:`~wbmpc.simulation.contacts.FAR` at most."""
        at = data.geom_xpos[self._pairs]
        assert self._model is not None
        bound = np.linalg.norm(at[:, 0] - at[:, 1], axis=1) - self._reach
        nearest, ends, self.nearest = FAR, np.zeros(6), ""
        for k in np.argsort(bound):
            if bound[k] >= nearest:
                break
            g, o = self._pairs[k].tolist()
            distance = mujoco.mj_geomDistance(self._model, data, g, o, nearest, ends)
            if distance < nearest:
                nearest, self.nearest = distance, self._name_of[int(self._model.geom_bodyid[o])]
        self.least = min(self.least, nearest)
        return nearest

    def velocity(self, name: str) -> Array:
        """Velocity (3) [m/s] of an obstacle; zero without a name."""
        return self._by_name[name].velocity if name else np.zeros(3)

    def count_contacts(self, data: mujoco.MjData, t: float) -> None:
        """Count contacts that have begun by ``t`` [s], and how fast they are."""
        if data.ncon and np.isin(data.contact.geom, self._others).any():
            for contact in data.contact:
                self._count(data, contact, t)

    def _count(self, data: mujoco.MjData, contact: Any, t: float) -> None:
        assert self._model is not None
        bodies = [int(self._model.geom_bodyid[g]) for g in contact.geom]
        if (bodies[0] in self._name_of) == (bodies[1] in self._name_of) or contact.dist >= 0.0:
            return
        own, other = bodies if bodies[1] in self._name_of else bodies[::-1]
        if not own:
            return
        name = self._name_of[other]
        since, until = self._pushes.get(name, (t, t))
        self._pushes[name] = (since if t - until < APART else t, t)
        self.pushed = max(self.pushed, t - self._pushes[name][0])
        last, self._touching[own, other] = self._touching.get((own, other), -np.inf), t
        if t - last < APART:
            return
        velocity, sign = np.zeros(6), 1.0 if own == bodies[0] else -1.0
        mujoco.mj_objectVelocity(self._model, data, mujoco.mjtObj.mjOBJ_XBODY, own, velocity, 0)
        point = velocity[3:] + np.cross(velocity[:3], contact.pos - data.xpos[own])
        self.contacts += 1
        speed = sign * float(point @ contact.frame[:3])
        self.caused += int(speed > AT_REST)
        self.contact_speed = max(self.contact_speed, speed)
