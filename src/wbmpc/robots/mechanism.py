"""A robot's model as it is drawn, before the robot is described: joints, bodies and shapes with all joints at zero."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import mujoco

from wbmpc.arrays import Array
from wbmpc.robots.actuation import Drive, read_drives
from wbmpc.robots.checks import compiled
from wbmpc.robots.findings import Finding
from wbmpc.robots.inertia import replace_inertias, violates_triangle_inequality
from wbmpc.robots.limited_program import strip_actuators_and_options
from wbmpc.robots.model_file import ModelFile, parse
from wbmpc.robots.read_once import once

_KINDS = {mujoco.mjtJoint.mjJNT_HINGE: "hinge", mujoco.mjtJoint.mjJNT_SLIDE: "slide"}


@dataclass(frozen=True)
class Joint:
    """A hinge or slide: ``body`` that it moves; ``position`` (3) [m] and unit ``axis`` (3) in the world with all joints at zero; ``range``
    [rad or m], None for a continuous joint; ``above``: names of the joints between the world and this one."""

    name: str
    kind: str
    body: str
    position: Array
    axis: Array
    range: tuple[float, float] | None
    above: tuple[str, ...]
    drive: Drive

    @property
    def vertical(self) -> bool:
        """Whether it turns or slides along the vertical."""
        return bool(abs(self.axis[2]) > 0.98)

    @property
    def horizontal(self) -> bool:
        """Whether its axis is parallel to the ground."""
        return bool(abs(self.axis[2]) < 0.05)

    @property
    def rest(self) -> float:
        """0 where the range includes it, otherwise the middle of the range [rad or m]."""
        if self.range is None or self.range[0] <= 0.0 <= self.range[1]:
            return 0.0
        return 0.5 * (self.range[0] + self.range[1])


@dataclass(frozen=True)
class Mechanism:
    """``model``: only primitive shapes, and the meshes that a body's mass depends on; ``replaced``: findings on inertias that were replaced, or
    balanced by the compiler; ``missing``: mesh files that do not exist."""

    file: ModelFile
    model: mujoco.MjModel
    drives: dict[str, Drive]
    replaced: tuple[Finding, ...]
    missing: tuple[str, ...] = ()

    @cached_property
    def data(self) -> mujoco.MjData:
        """Bodies with all joints at zero."""
        data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, data)
        return data

    @cached_property
    def joints(self) -> dict[str, Joint]:
        """Hinges and slides that have a name, parents first."""
        m, d, found = self.model, self.data, {}
        for j in range(m.njnt):
            name, kind = m.joint(j).name, _KINDS.get(mujoco.mjtJoint(int(m.jnt_type[j])))
            if not name or kind is None:
                continue
            low, high = map(float, m.jnt_range[j])
            found[name] = Joint(
                name, kind, m.body(int(m.jnt_bodyid[j])).name, d.xanchor[j].copy(), d.xaxis[j].copy(),
                (low, high) if m.jnt_limited[j] else None, self._above(j), self.drives.get(name, Drive()),
            )  # fmt: skip
        return found

    @property
    def bodies(self) -> list[str]:
        """Names of all links."""
        return [self.model.body(i).name for i in range(1, self.model.nbody)]

    def _above(self, joint: int) -> tuple[str, ...]:
        m, body = self.model, int(self.model.jnt_bodyid[joint])
        same = range(int(m.body_jntadr[body]), joint)
        return (*self.joints_of(int(m.body_parentid[body])), *self._named(same))

    def _named(self, joints: range) -> list[str]:
        """Names of those of the joints that are hinges or slides."""
        m = self.model
        return [m.joint(j).name for j in joints if mujoco.mjtJoint(int(m.jnt_type[j])) in _KINDS and m.joint(j).name]

    def joints_of(self, body: int) -> tuple[str, ...]:
        m, found = self.model, list[str]()
        while body > 0:
            first, count = int(m.body_jntadr[body]), int(m.body_jntnum[body])
            found[:0] = self._named(range(first, first + count))
            body = int(m.body_parentid[body])
        return tuple(found)

    def below(self, joint: str) -> list[str]:
        """Names of the joints that ``joint`` moves."""
        return [j.name for j in self.joints.values() if joint in j.above]

    def parent(self, body: str) -> str:
        return str(self.model.body(int(self.model.body_parentid[self.model.body(body).id])).name)

    def path(self, body: str) -> list[str]:
        """Names of the bodies from the world to ``body``."""
        found, i = [body], self.model.body(body).id
        while i > 0:
            i = int(self.model.body_parentid[i])
            found.insert(0, self.model.body(i).name)
        return found

    def rigid_with(self, body: str) -> list[str]:
        """Names of the bodies below ``body`` that are fixed to it; ``body`` comes first."""
        i = self.model.body(body).id
        weld = self.model.body_weldid[i]
        inside = [k for k in range(i, self.model.nbody) if self.model.body_weldid[k] == weld and self.is_below(k, i)]
        return [self.model.body(k).name for k in inside]

    def is_below(self, body: int, root: int) -> bool:
        """Whether the body with index ``body`` is ``root`` or a descendant of it."""
        while body > root:
            body = int(self.model.body_parentid[body])
        return body == root

    def frames(self, body: str) -> Iterator[tuple[str, Array]]:
        """Names and positions (3) [m] of frames that are fixed to a body: bodies below it and sites on them."""
        names = self.rigid_with(body)
        for name in names:
            yield name, self.data.xpos[self.model.body(name).id]
        ids = {self.model.body(n).id for n in names}
        for s in range(self.model.nsite):
            if int(self.model.site_bodyid[s]) in ids and self.model.site(s).name:
                yield self.model.site(s).name, self.data.site_xpos[s]


def read_mechanism(file: ModelFile) -> Mechanism:
    """Raises :class:`wbmpc.errors.InputError` naming the file where MuJoCo cannot compile it."""
    _, found = once(("mechanism", file.path, id(file)), lambda: (file, _compiled(file)))  # what is kept keeps its id()
    return found


def _compiled(file: ModelFile) -> Mechanism:
    missing: list[str] = []
    spec = parse(file, missing=missing)
    drives = read_drives(file, spec)
    strip_actuators_and_options(spec)
    for element in [*spec.sensors, *spec.keys]:  # what they refer to may be gone
        spec.delete(element)
    odd = [b.name for b in spec.bodies[1:] if b.explicitinertial and violates_triangle_inequality(b)]
    replaced = replace_inertias(spec, balance=True)
    done = {f.where for f in replaced}
    replaced += [_balanced(name) for name in odd if f"link '{name}'" not in done]
    for geom in [g for g in spec.geoms if g.type == mujoco.mjtGeom.mjGEOM_MESH and g.parent.explicitinertial]:
        spec.delete(geom)
    spec.compiler.fusestatic = False
    return Mechanism(file, compiled(spec, file.path), drives, tuple(replaced), tuple(missing))


def _balanced(link: str) -> Finding:
    return Finding(
        "warning", "inertia", f"link '{link}'",
        "one moment of inertia is larger than the sum of the two others, which is impossible; the mean of all three is used",
        "give its true inertia in the file",
    )  # fmt: skip
