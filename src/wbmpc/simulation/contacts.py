"""What may touch what in a simulated world, and how often it was otherwise.

Every shape has a class. Shapes of the robot's file are its hull; tires, balls, rollers and casters roll; a tool touches handles. All
classes of robot and scene collide, the robot with itself too; :data:`ALLOWED` lists the pairs that are meant to touch. Any other
contact is unwanted, and counted. Bodies that a joint connects overlap at it in most files, so they do not collide; nor do sections of a
telescope, whose shapes are full where those are hollow, nor other parts that the file draws in each other at the robot's home
or that the robot file ignores (:func:`enable`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import product

import mujoco
import numpy as np

from wbmpc.constants import TELESCOPE
from wbmpc.kernel.ir import Floats, Integers
from wbmpc.kernel.step import bind
from wbmpc.robots.checks import compiled
from wbmpc.robots.model_import import SHAPE
from wbmpc.simulation.compilation import step


@step
def near(n: int, pairs: Integers, centers: Floats, reach: Floats, found: Integers, distance: float) -> int:
    """Of n ``pairs`` of shapes those whose bounding spheres (``reach``: the sum of two radii) are nearer than ``distance`` [m]: into
    ``found``; how many they are."""
    count = 0
    for k in range(n):
        a, b = 3 * pairs[2 * k], 3 * pairs[2 * k + 1]
        x, y, z = centers[a] - centers[b], centers[a + 1] - centers[b + 1], centers[a + 2] - centers[b + 2]
        if np.sqrt(x * x + y * y + z * z) - reach[k] < distance:
            found[count] = k
            count += 1
    return count


#: Classes of shapes, the bits of MuJoCo's ``contype``.
FLOOR, ROLLS, BODY, FIXED, TOUCHES, TOUCHED = 1, 2, SHAPE, 8, 16, 32
_SCENE = FLOOR | FIXED | TOUCHED
#: Of a geom: floors and what lies on them; tires, balls and casters; rollers, whose axles are beside the hull; the robot's hull;
#: obstacles; what a tool may touch; the tool.
GROUND, ROLLING = {"contype": FLOOR, "conaffinity": ROLLS}, {"contype": ROLLS, "conaffinity": _SCENE | BODY | ROLLS}
ROLLER, HULL = {"contype": ROLLS, "conaffinity": _SCENE}, {"contype": BODY, "conaffinity": _SCENE | BODY}
OBSTACLE, HANDLE = {"contype": FIXED, "conaffinity": 0}, {"contype": TOUCHED, "conaffinity": 0}
TOOL = {"contype": TOUCHES, "conaffinity": _SCENE | BODY}
#: What is meant to touch, by classes.
ALLOWED = frozenset({(FLOOR, ROLLS), (TOUCHES, TOUCHED)})
_ALLOWED_EITHER_WAY = ALLOWED | {(second, first) for first, second in ALLOWED}
#: Hulls that come nearer than this [m] to the floor under the standing robot are drawn wheels and casters: they do not touch it.
DRAGS = 0.002
#: Two parts that have been apart for less than this [s] touch in the same event; the clearance is checked every so often [s].
APART, INTERVAL = 0.1, 0.01
#: Distances beyond this [m] are not looked for.
FAR = 1.0
#: Distances are looked for up to the smallest so far and this [m] more.
NARROW = 0.001


def enable(
    spec: mujoco.MjSpec, home: Mapping[str, float], source: object, ignore: Iterable[tuple[str, str]] = ()
) -> None:
    """Make the shapes of the robot's file collide, in place; ``home`` [rad or m] by joint, ``source``: the file, for errors; ``ignore``:
    pairs of bodies that may overlap, each with all that is fixed to it.

    Where a tire or ball stands for its body, the drawn shapes do not; what is drawn in each other at home stays without contact, and
    so do sections of a telescope.
    """
    rolling = {g.parent.name for g in spec.geoms if g.contype == ROLLS}
    for number, body in enumerate(spec.bodies):
        body.name = body.name or f"wbmpc_body_{number}"
    for geom in spec.geoms:
        if geom.contype == 0 and geom.conaffinity == SHAPE:
            hull = geom.parent.name not in rolling
            geom.contype, geom.conaffinity = (HULL["contype"], HULL["conaffinity"]) if hull else (0, 0)
    model = compiled(spec, source)
    data, geoms, drawn = _standing(model, home), {g.id: g for g in spec.geoms}, set[tuple[str, str]]()
    floor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, "floor")
    for pair in data.contact.geom.tolist():
        if floor in pair:
            dragged = geoms[pair[0] if pair[1] == floor else pair[1]]
            dragged.conaffinity &= ~FLOOR if dragged.contype == BODY else ~0
        elif all(model.geom_contype[g] in (ROLLS, BODY) for g in pair):
            first, second = sorted(str(model.body(int(model.geom_bodyid[g])).name) for g in pair)
            drawn.add((first, second))
    drawn.update(_nested(model, data))
    drawn.update(_fixed_to(model, ignore))
    for first, second in sorted(drawn):
        spec.add_exclude(bodyname1=first, bodyname2=second)


def _standing(model: mujoco.MjModel, home: Mapping[str, float]) -> mujoco.MjData:
    """The robot at home, :data:`DRAGS` deep in the floor, with its contacts."""
    data = mujoco.MjData(model)
    for joint in range(model.njnt):
        data.qpos[model.jnt_qposadr[joint]] = home.get(model.joint(joint).name, data.qpos[model.jnt_qposadr[joint]])
    mujoco.mj_kinematics(model, data)
    rolls, floor = (
        np.flatnonzero(model.geom_contype == ROLLS),
        mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, "floor"),
    )
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    if rolls.size and floor >= 0 and free.size:
        lowest = min(mujoco.mj_geomDistance(model, data, floor, int(g), 10.0, np.zeros(6)) for g in rolls)
        data.qpos[model.jnt_qposadr[free[0]] + 2] -= lowest + DRAGS
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    return data


def _nested(m: mujoco.MjModel, data: mujoco.MjData) -> set[tuple[str, str]]:
    """Pairs of bodies, by name in order, that slide along one line against each other, each section on the one before."""
    found, weld = set[tuple[str, str]](), m.body_weldid.tolist()
    for body in range(1, m.nbody):
        part, section = weld[body], np.zeros(3)
        while m.body_jntnum[part] == 1 and m.jnt_type[m.body_jntadr[part]] == mujoco.mjtJoint.mjJNT_SLIDE:
            along = data.xaxis[m.body_jntadr[part]]
            first, part = not section.any(), weld[m.body_parentid[part]]
            # the world and what stands in it is no section
            if part == 0 or not (first or abs(section @ along) > TELESCOPE):
                break
            section = along
            if first:  # bodies that one joint connects do not collide anyway
                continue
            for other in np.flatnonzero(m.body_weldid == part).tolist():
                a, b = sorted((str(m.body(body).name), str(m.body(other).name)))
                found.add((a, b))
    return found


def _fixed_to(m: mujoco.MjModel, pairs: Iterable[tuple[str, str]]) -> set[tuple[str, str]]:
    """All bodies, by name in order, that are fixed to the ones of ``pairs``."""
    found = set[tuple[str, str]]()
    for pair in pairs:
        parts = [np.flatnonzero(m.body_weldid == m.body_weldid[m.body(name).id]).tolist() for name in pair]
        for one, other in product(*parts):
            a, b = sorted((str(m.body(one).name), str(m.body(other).name)))
            found.add((a, b))
    return found


@dataclass(frozen=True)
class Touch:
    """An unwanted contact that began at ``time`` [s] between two bodies, by name."""

    time: float
    first: str
    second: str

    def __str__(self) -> str:
        return f"{self.first} touches {self.second} at {self.time:.2f} s"


@dataclass
class Contacts:
    """Unwanted contacts of a world (``touches``), and the smallest ``clearance`` [m] so far of the whole robot to all that it must not
    touch: obstacles, and itself but for parts that are joined, or joined by one other. (Not to the floor, which it drives on; to touch that
    with its hull is a contact.) It is :data:`FAR` where nothing came nearer. ``grounded``: whether the hull touches the floor now."""

    model: mujoco.MjModel
    data: mujoco.MjData
    touches: list[Touch] = field(default_factory=list)
    clearance: float = FAR
    grounded: bool = False

    def __post_init__(self) -> None:
        m = self.model
        self._class = m.geom_contype.tolist()
        self._part = m.body_weldid[m.geom_bodyid]
        self._last: dict[tuple[int, int], float] = {}
        self._looked = -np.inf
        self._pairs = np.array(_pairs(m), dtype=np.int64).reshape(-1, 2)
        self._found = np.zeros(len(self._pairs), dtype=np.int64)
        self._ends = np.zeros(6)
        arrays = {
            "pairs": self._pairs, "centers": self.data.geom_xpos, "found": self._found,
            "reach": m.geom_rbound[self._pairs].sum(axis=1),
        }  # fmt: skip
        self._near = bind(near, arrays, n=len(self._pairs))

    def update(self, time: float) -> None:
        """Take in the contacts of the present step at ``time`` [s]."""
        data = self.data
        if time - self._looked >= INTERVAL - 1e-9:
            self._looked = time
            self._measure_clearance()
        self.grounded = False
        if not data.ncon:
            return
        contact, kind = data.contact, self._class
        for geoms, distance in zip(contact.geom.tolist(), contact.dist.tolist(), strict=True):
            classes = kind[geoms[0]], kind[geoms[1]]
            if distance < 0.0 and classes not in _ALLOWED_EITHER_WAY:
                self.grounded |= classes in ((FLOOR, BODY), (BODY, FLOOR))
                self._count(geoms, time)

    def _count(self, geoms: list[int], time: float) -> None:
        first, second = sorted(int(self._part[g]) for g in geoms)
        if time - self._last.get((first, second), -np.inf) > APART:
            names = sorted(str(self.model.body(int(self.model.geom_bodyid[g])).name) for g in geoms)
            self.touches.append(Touch(time, names[0], names[1]))
        self._last[first, second] = time

    def _measure_clearance(self) -> None:
        for k in self._found[: self._near(self.clearance)].tolist():
            first, second = self._pairs[k].tolist()
            # what is farther than the smallest clearance so far need not be known
            far = max(self.clearance, 0.0) + NARROW
            distance = mujoco.mj_geomDistance(self.model, self.data, first, second, far, self._ends)
            self.clearance = min(self.clearance, distance)


def _pairs(m: mujoco.MjModel) -> list[tuple[int, int]]:
    """Pairs of geoms that collide, and are not meant to: without those of the floor, and without parts that one part connects, which
    are always near each other."""
    excluded = {(int(s) >> 16, int(s) & 0xFFFF) for s in m.exclude_signature}
    excluded |= {(b, a) for a, b in excluded}
    weld, found = m.body_weldid, []
    parent = lambda part: int(weld[m.body_parentid[part]])
    for g in range(m.ngeom):
        for h in range(g + 1, m.ngeom):
            kinds = tuple(sorted((int(m.geom_contype[g]), int(m.geom_contype[h]))))
            a, b = int(m.geom_bodyid[g]), int(m.geom_bodyid[h])
            collide = (m.geom_contype[g] & m.geom_conaffinity[h]) or (m.geom_contype[h] & m.geom_conaffinity[g])
            parts = {int(weld[a]), int(weld[b])}
            near = {q for p in parts if p for q in (parent(p), parent(parent(p)))} - {0}
            if (
                collide
                and len(parts) == 2
                and not parts & near
                and FLOOR not in kinds
                and kinds not in ALLOWED
                and (a, b) not in excluded
            ):
                found.append((g, h))
    return found
