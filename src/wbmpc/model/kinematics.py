"""Rigid-body algorithms on CasADi SX for a chain of joints: kinematics, Newton-Euler, composite inertia.

Structural zeros of constants are kept, so that the expressions stay small. Sources: Featherstone, "Rigid Body Dynamics
Algorithms" (2008), chapters 5 and 6, in three-dimensional vectors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from wbmpc import lie
from wbmpc.constants import GRAVITY
from wbmpc.model.tree import Frame, Link

SX = ca.SX


def constant(value: ArrayLike) -> SX:
    """A numeric array as a sparse SX; rounding errors about 0 and ±1 are removed, since both make expressions shorter."""
    array = np.asarray(value, float)
    return SX(_constant(array.tobytes(), array.shape))


@lru_cache(4096)
def _constant(content: bytes, shape: tuple[int, ...]) -> SX:
    """The same of an array's memory: a robot's terms ask for its links' again and again."""
    array = np.frombuffer(content).reshape(shape)
    whole = np.round(array)
    return SX(ca.sparsify(ca.DM(np.where((np.abs(array - whole) < 1e-14) & (np.abs(whole) <= 1), whole, array))))


def rotation_about(axis: np.ndarray, angle: SX) -> SX:
    """Rotation matrix about a unit axis of numbers (Rodrigues); sparse for coordinate axes."""
    c, s = ca.cos(angle), ca.sin(angle)
    for i in range(3):
        if abs(abs(axis[i]) - 1.0) < 1e-14:
            s = s if axis[i] > 0 else -s
            r = SX(3, 3)
            a, b = (i + 1) % 3, (i + 2) % 3
            r[i, i], r[a, a], r[b, b], r[a, b], r[b, a] = 1, c, c, -s, s
            return ca.sparsify(r)
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return SX(ca.DM.eye(3)) + s * constant(k) + (1 - c) * constant(k @ k)


@dataclass(frozen=True)
class FramePose:
    """``position`` (3) [m], ``quaternion`` (4) and ``rotation`` matrix (3, 3) of a frame in the world."""

    position: SX
    quaternion: SX
    rotation: SX


@dataclass(frozen=True)
class Placement:
    """A link's joint transform: rotation and offset to the parent, and the joint's axis in the link's frame."""

    rotation: SX
    offset: SX
    axis: SX


@dataclass(frozen=True)
class RootMotion:
    """Of a chain's root, in its own axes: ``angular`` velocity (3) [rad/s], its ``spin_rate`` (3) [rad/s²], and the ``acceleration`` (3)
    [m/s²] of its origin less gravity (9.81 upwards at rest)."""

    angular: SX
    spin_rate: SX
    acceleration: SX


@dataclass(frozen=True)
class PointLoad:
    """A point of ``mass`` [kg] fixed to link ``link`` at ``place`` (3) [m] in its axes."""

    link: int
    place: SX
    mass: SX


class Chain:
    """``links`` with their symbolic joint ``values`` (by link index); ``root``: pose of the root's outer frame in the world; ``load``:
    a frame and the mass [kg] of a point there. ``moving``: indices of links with a value; ``places``: how each is joined to its parent.
    ``gravity`` (3) [m/s²] in the world."""

    def __init__(
        self, links: Sequence[Link], values: dict[int, SX], root: FramePose | None = None,
        load: tuple[Frame, SX] | None = None,
    ) -> None:  # fmt: skip
        self.links = tuple(links)
        self.root, self.load = root, load
        self.moving = [i for i, link in enumerate(links) if i in values]
        self._leader = {i: _joint(links, k.follows.leader) for i, k in enumerate(links) if k.follows is not None}
        self.values = self._with_followers(values, 1.0)
        self.places = [self._place(i) for i in range(len(links))]
        self._placed: dict[int, tuple[SX, SX]] = {}
        self._turned: dict[int, SX] = {}

    def _with_followers(self, given: dict[int, SX], offsets: float = 0.0) -> dict[int, SX]:
        """Also of coupled joints: values (``offsets`` 1) or rates of those whose leader has one."""
        found = dict(given)
        for i, leader in self._leader.items():
            follows = self.links[i].follows
            if leader in given and follows is not None:
                found[i] = follows.ratio * given[leader] + offsets * follows.offset
        return found

    def _place(self, i: int) -> Placement:
        link = self.links[i]
        fixed, offset, axis = constant(link.rotation), constant(link.position), constant(link.axis)
        if i not in self.values or link.kind == "fixed":
            return Placement(fixed, offset, axis)
        if link.kind == "revolute":
            return Placement(ca.sparsify(fixed @ rotation_about(link.axis, self.values[i])), offset, axis)
        return Placement(fixed, offset + fixed @ axis * self.values[i], axis)

    # ------------------------------------------------------------------ kinematics
    def link_pose(self, i: int) -> FramePose:
        """Pose of link i in the world."""
        position, rotation = self.link_place(i)
        return FramePose(position, self._quaternion(i), rotation)

    def link_place(self, i: int) -> tuple[SX, SX]:
        """Position (3) [m] and rotation matrix (3, 3) of link i in the world: without its quaternion, half the work."""
        if i not in self._placed:
            place, parent = self.places[i], self.links[i].parent
            if parent >= 0:
                at, turn = self.link_place(parent)
                self._placed[i] = at + turn @ place.offset, turn @ place.rotation
            elif self.root is None:
                self._placed[i] = place.offset, place.rotation
            else:
                up = self.root
                self._placed[i] = up.position + up.rotation @ place.offset, up.rotation @ place.rotation
        return self._placed[i]

    def _quaternion(self, i: int) -> SX:
        if i not in self._turned:
            link = self.links[i]
            turn = constant(lie.rotation_to_quaternion(link.rotation))
            if i in self.values and link.kind == "revolute":
                turn = lie.quaternion_multiply(turn, ca.sparsify(lie.quaternion_about(link.axis, self.values[i])))
            if link.parent >= 0 or self.root is not None:
                up = self.root.quaternion if link.parent < 0 and self.root else self._quaternion(link.parent)
                same = np.array_equal(link.rotation, np.eye(3)) and link.kind != "revolute"
                turn = up if same else lie.quaternion_multiply(up, turn)
            self._turned[i] = turn
        return self._turned[i]

    def frame_pose(self, frame: Frame) -> FramePose:
        """Pose of a frame fixed to a link."""
        turn = constant(lie.rotation_to_quaternion(frame.rotation))
        position, rotation = self.frame_place(frame)
        return FramePose(position, lie.quaternion_multiply(self._quaternion(frame.link), turn), rotation)

    def frame_place(self, frame: Frame) -> tuple[SX, SX]:
        """Position (3) [m] and rotation matrix (3, 3) of a frame fixed to a link."""
        position, rotation = self.link_place(frame.link)
        return position + rotation @ constant(frame.position), rotation @ constant(frame.rotation)

    def center_of_mass(self) -> SX:
        """Of all links (3) [m], in the axes of the root's outer frame: where that is plays no part."""
        mass = [link.mass for link in self.links]
        moment = [link.mass * constant(link.com) for link in self.links]
        total, about = 0.0, SX(3, 1)
        for i in reversed(range(len(self.links))):
            place, up = self.places[i], self.links[i].parent
            carried = place.rotation @ moment[i] + mass[i] * place.offset
            if up >= 0:
                mass[up], moment[up] = mass[up] + mass[i], moment[up] + carried
            else:
                total, about = total + mass[i], about + carried
        return about / total

    def frame_velocity(self, frame: Frame, rates: dict[int, SX], linear: SX, angular: SX) -> tuple[SX, SX]:
        """(linear, angular) velocity in world axes; the root's outer frame moves with a twist in its own axes."""
        v, w, rates = linear, angular, self._with_followers(rates)
        for i in self._path(frame.link):
            link, place = self.links[i], self.places[i]
            v = place.rotation.T @ (v + ca.cross(w, place.offset))
            w = place.rotation.T @ w
            if i in rates and link.kind == "revolute":
                w = w + place.axis * rates[i]
            elif i in rates:
                v = v + place.axis * rates[i]
        rotation = self.link_place(frame.link)[1]
        return rotation @ (v + ca.cross(w, constant(frame.position))), rotation @ w

    def _path(self, i: int) -> list[int]:
        path = []
        while i >= 0:
            path.append(i)
            i = self.links[i].parent
        return path[::-1]

    # ------------------------------------------------------------------ dynamics
    def inverse_dynamics(self, rates: dict[int, SX], accelerations: dict[int, SX], gravity: float = GRAVITY) -> SX:
        """Generalized forces of the moving joints for given rates and accelerations (recursive Newton-Euler)."""
        root = RootMotion(SX(3, 1), SX(3, 1), constant([0, 0, gravity]))
        forces = self._forces(rates, accelerations, root, self._point_load())
        return self._collect(*forces)

    def root_wrench(
        self, rates: dict[int, SX], accelerations: dict[int, SX], root: RootMotion, load: PointLoad | None = None
    ) -> tuple[SX, SX]:
        """Force (3) [N] and moment (3) [N m] about the root's outer frame, in its axes, that move all links as given (recursive
        Newton-Euler). Joints that are not in ``rates`` are locked, those that are not in ``accelerations`` keep their rate. ``load``: a
        point mass beside the links'."""
        force, moment = self._forces(rates, accelerations, root, load)
        total, about = SX(3, 1), SX(3, 1)
        for i in reversed(range(len(self.links))):
            p, up = self.places[i], self.links[i].parent
            carried, turned = p.rotation @ force[i], p.rotation @ moment[i]
            turned = turned + ca.cross(p.offset, carried)
            if up >= 0:
                force[up], moment[up] = force[up] + carried, moment[up] + turned
            else:
                total, about = total + carried, about + turned
        return total, about

    def _forces(
        self, rates: dict[int, SX], accelerations: dict[int, SX], root: RootMotion, load: PointLoad | None
    ) -> tuple[list[SX], list[SX]]:
        """What each link's own inertia asks for: force (3) and moment (3) about its frame, in its axes."""
        n = len(self.links)
        rates, accelerations = self._with_followers(rates), self._with_followers(accelerations)
        w: list[SX] = [SX(3, 1)] * n
        aw: list[SX] = [SX(3, 1)] * n
        av: list[SX] = [SX(3, 1)] * n
        force: list[SX] = [SX(3, 1)] * n
        moment: list[SX] = [SX(3, 1)] * n
        for i, link in enumerate(self.links):
            p = self.places[i]
            up = link.parent
            w0, aw0, av0 = (w[up], aw[up], av[up]) if up >= 0 else (root.angular, root.spin_rate, root.acceleration)
            back = p.rotation.T
            w[i], aw[i] = back @ w0, back @ aw0
            av[i] = back @ (av0 + ca.cross(aw0, p.offset) + ca.cross(w0, ca.cross(w0, p.offset)))
            if i in rates:
                turn = p.axis * rates[i]
                push = p.axis * accelerations[i] if i in accelerations else SX(3, 1)
                if link.kind == "revolute":
                    aw[i] = aw[i] + ca.cross(w[i], turn) + push
                    w[i] = w[i] + turn
                else:
                    av[i] = av[i] + 2 * ca.cross(w[i], turn) + push
            if link.mass > 0.0:
                com, inertia = constant(link.com), constant(link.inertia)
                force[i] = link.mass * (av[i] + ca.cross(aw[i], com) + ca.cross(w[i], ca.cross(w[i], com)))
                moment[i] = inertia @ aw[i] + ca.cross(w[i], inertia @ w[i]) + ca.cross(com, force[i])
        if load is not None:
            i, place = load.link, load.place
            weight = load.mass * (av[i] + ca.cross(aw[i], place) + ca.cross(w[i], ca.cross(w[i], place)))
            force[i], moment[i] = force[i] + weight, moment[i] + ca.cross(place, weight)
        return force, moment

    def _point_load(self) -> PointLoad | None:
        return None if self.load is None else PointLoad(*self._loaded(), self.load[1])

    def _loaded(self) -> tuple[int, SX]:
        """The link that the load is fixed to, and where on it (3) [m]."""
        assert self.load is not None
        return self.load[0].link, constant(self.load[0].position)

    def _collect(self, force: list[SX], moment: list[SX]) -> SX:
        torques: dict[int, SX] = {}
        for i in reversed(range(len(self.links))):
            link, p = self.links[i], self.places[i]
            if i in self.values:
                torques[i] = ca.dot(p.axis, moment[i] if link.kind == "revolute" else force[i])
            if link.parent >= 0:
                carried = p.rotation @ force[i]
                force[link.parent] = force[link.parent] + carried
                moment[link.parent] = moment[link.parent] + p.rotation @ moment[i] + ca.cross(p.offset, carried)
        return ca.vertcat(*[torques[i] for i in self.moving])

    def mass_matrix(self) -> SX:
        """Joint-space inertia of the moving joints (composite rigid bodies)."""
        n = len(self.links)
        mass: list[Any] = [link.mass for link in self.links]
        first = [constant(link.mass * link.com) for link in self.links]
        inertia = [
            constant(link.inertia + link.mass * (link.com @ link.com * np.eye(3) - np.outer(link.com, link.com)))
            for link in self.links
        ]
        if self.load is not None:
            (i, at), point = self._loaded(), self.load[1]
            mass[i], first[i] = mass[i] + point, first[i] + point * at
            inertia[i] = inertia[i] + point * (ca.dot(at, at) * SX(ca.DM.eye(3)) - at @ at.T)
        row = {link: k for k, link in enumerate(self.moving)}
        m = SX(len(self.moving), len(self.moving))
        for i in reversed(range(n)):
            link, p = self.links[i], self.places[i]
            if i in row:
                if link.kind == "revolute":
                    f, t = ca.cross(p.axis, first[i]), inertia[i] @ p.axis
                else:
                    f, t = mass[i] * p.axis, ca.cross(first[i], p.axis)
                self._spread(m, row, i, f, t)
            up = link.parent
            if up >= 0:
                r, o = p.rotation, p.offset
                h = r @ first[i]
                oh, oo = ca.dot(o, h), ca.dot(o, o)
                shifted = r @ inertia[i] @ r.T + (2 * oh + mass[i] * oo) * SX(ca.DM.eye(3))
                shifted = shifted - (h @ o.T + o @ h.T) - mass[i] * (o @ o.T)
                inertia[up] = inertia[up] + shifted
                first[up] = first[up] + h + mass[i] * o
                mass[up] += mass[i]
        return m

    def _spread(self, m: SX, row: dict[int, int], i: int, f: SX, t: SX) -> None:
        """Column of joint i: its composite force seen by all joints before it."""
        j = i
        while j >= 0:
            link, p = self.links[j], self.places[j]
            if j in row:
                value = ca.dot(p.axis, t if link.kind == "revolute" else f)
                m[row[i], row[j]] = value
                m[row[j], row[i]] = value
            f, t = p.rotation @ f, p.rotation @ t + ca.cross(p.offset, p.rotation @ f)
            j = link.parent


def _joint(links: Sequence[Link], name: str) -> int:
    return next(i for i, link in enumerate(links) if link.joint == name)


def solve_spd(m: SX, right: SX) -> SX:
    """m⁻¹ right by an LDLᵀ factorization written out (m symmetric positive definite)."""
    n = m.shape[0]
    factor: list[list[SX]] = [[SX(0)] * n for _ in range(n)]
    d: list[SX] = []
    for j in range(n):
        pivot = m[j, j]
        for k in range(j):
            pivot = pivot - factor[j][k] ** 2 * d[k]
        d.append(pivot)
        for i in range(j + 1, n):
            value = m[i, j]
            for k in range(j):
                value = value - factor[i][k] * factor[j][k] * d[k]
            factor[i][j] = value / pivot
    out = SX(right)
    for i in range(n):
        for k in range(i):
            out[i, :] -= factor[i][k] * out[k, :]
    for i in range(n):
        out[i, :] = out[i, :] / d[i]
    for i in reversed(range(n)):
        for k in range(i + 1, n):
            out[i, :] -= factor[k][i] * out[k, :]
    return out
