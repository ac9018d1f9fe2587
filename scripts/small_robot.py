"""Reduce a described robot to a small file of its own: kinematics and inertias as numbers, no meshes.

``python scripts/small_robot.py robot.yaml NAME --source TEXT [--out FOLDER]`` writes NAME.xml (joints that the description uses, masses,
inertias, the frames of the end effectors, wheels as cylinders, links as capsules for the eye) and NAME.yaml. Held joints are part of
their links. The built-in robots of other people's designs were made with it; TEXT says where their numbers are from.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from wbmpc.robots import RobotDescription, load_description, load_spec
from wbmpc.robots.description import DATA
from wbmpc.robots.robot_yaml import write_yaml
from wbmpc.robots.wheel_geometry import drawn_radius
from wbmpc.yaml_file import load_yaml

HEAD = """<!--
  {source}
  Kinematics and inertias only; links are capsules for the eye: no mass, no contact. Units: m, kg, rad.
-->
<mujoco model="{name}">
  <compiler angle="radian" autolimits="true"/>
  <default>
    <default class="shape">
      <geom type="capsule" contype="0" conaffinity="0" mass="0" group="1" rgba="0.72 0.75 0.78 1"/>
    </default>
  </default>
  <worldbody>
"""
#: Radius [m] of the capsules of links, and the shortest one [m].
THICKNESS, SHORTEST = 0.04, 0.02


def numbers(values: Any) -> str:
    """As text, to nine digits; what is below 1e-9 is 0."""
    return " ".join(f"{v:.9g}" if abs(v) > 1e-9 else "0" for v in np.ravel(values))


class Writer:
    """One robot's bodies as MJCF."""

    def __init__(self, description: RobotDescription) -> None:
        self.description = description
        self.wheels = {n: self._radius(n) for n in description.base.joints()}
        spec = load_spec(description)
        self.tools = self._sites(spec)
        spec.compiler.fusestatic, body = True, spec.body(description.base.body)
        body.add_freejoint() if description.base.moves else body.add_joint(name="_stays")
        self.model = spec.compile()

    def _radius(self, joint: str) -> float | None:
        return drawn_radius(self.description, load_spec(self.description).compile(), joint) or next(
            (r.value for r in self.description.base.radii() if r.name == joint), None
        )

    def _sites(self, spec: mujoco.MjSpec) -> dict[str, str]:
        """A site at every end effector's frame that is a body, since bodies without joints are merged."""
        names = {}
        for tool in self.description.tools().values():
            if tool in [b.name for b in spec.bodies]:
                body = spec.body(tool)
                body.name = f"{tool}_body"
                body.add_site(name=tool)
            names[tool] = tool
        return names

    def lines(self, body: int, depth: int = 2) -> Iterator[str]:
        """A body with what hangs on it."""
        m, pad = self.model, "  " * depth
        inside = [b for b in range(1, m.nbody) if m.body_parentid[b] == body and b != body]
        first = depth == 2
        frame = (
            f' childclass="shape" pos="{numbers(m.body_pos[body])}"' if first else f' pos="{numbers(m.body_pos[body])}"'
        )
        if abs(m.body_quat[body][0]) < 1.0 - 1e-9:
            frame += f' quat="{numbers(m.body_quat[body])}"'
        yield f'{pad}<body name="{m.body(body).name}"{frame}>'
        turn = "" if abs(m.body_iquat[body][0]) > 1.0 - 1e-9 else f' quat="{numbers(m.body_iquat[body])}"'
        yield (
            f'{pad}  <inertial pos="{numbers(m.body_ipos[body])}"{turn} mass="{numbers(m.body_mass[body])}" '
            f'diaginertia="{numbers(m.body_inertia[body])}"/>'
        )
        yield from (f"{pad}  {line}" for line in self._joints(body))
        yield from (f"{pad}  {line}" for line in self._shapes(body, inside))
        for child in inside:
            yield from self.lines(child, depth + 1)
        yield f"{pad}</body>"

    def _joints(self, body: int) -> Iterator[str]:
        m = self.model
        for j in range(m.body_jntadr[body], m.body_jntadr[body] + m.body_jntnum[body]):
            if m.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE or m.joint(j).name == "_stays":
                continue
            kind = ' type="slide"' if m.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE else ""
            place = f' pos="{numbers(m.jnt_pos[j])}"' if np.abs(m.jnt_pos[j]).max() > 1e-9 else ""
            reach = f' range="{numbers(m.jnt_range[j])}"' if m.jnt_limited[j] else ""
            yield f'<joint name="{m.joint(j).name}"{kind} axis="{numbers(m.jnt_axis[j])}"{place}{reach}/>'

    def _shapes(self, body: int, inside: list[int]) -> Iterator[str]:
        m = self.model
        joint = m.joint(int(m.body_jntadr[body])).name if m.body_jntnum[body] else ""
        radius = self.wheels.get(joint)
        if radius is not None:
            axis = m.jnt_axis[int(m.body_jntadr[body])] * 0.02
            yield f'<geom type="cylinder" fromto="{numbers([*-axis, *axis])}" size="{numbers(radius)}" rgba="0.2 0.2 0.2 1"/>'
            return
        ends = [m.body_pos[b] for b in inside]
        for s in np.flatnonzero(m.site_bodyid == body):
            name = m.site(s).name
            if name in self.tools:
                ends.append(m.site_pos[s])
                yield f'<site name="{name}" pos="{numbers(m.site_pos[s])}" quat="{numbers(m.site_quat[s])}" size="0.01"/>'
        for end in ends:
            if np.linalg.norm(end) > SHORTEST:
                yield f'<geom fromto="0 0 0 {numbers(end)}" size="{THICKNESS}"/>'

    def text(self, source: str) -> str:
        """The whole file."""
        root = self.model.body(self.description.base.body).id
        return (
            HEAD.format(source=source, name=self.description.name)
            + "\n".join(self.lines(root))
            + "\n  </worldbody>\n</mujoco>\n"
        )


def description_of(description: RobotDescription, name: str) -> dict[str, Any]:
    """The YAML of the small file: what the larger one's says, with the limits that its model has."""
    data = load_yaml(Path(description.source))
    kept = {k: v for k, v in data.items() if k not in ("packages", "xacro_arguments", "fixed_joints")}
    effort = {n: round(v, 3) for n, v in description.limits.effort.items() if v < 1e5}
    limits = {**data.get("limits", {}), **({"effort": effort} if effort else {})}
    return {**kept, "name": name, "model": f"{name}.xml", "limits": limits}


def main() -> None:
    """Write the two files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robot", type=Path)
    parser.add_argument("name")
    parser.add_argument("--source", required=True)
    parser.add_argument("--out", type=Path, default=DATA)
    given = parser.parse_args()
    description = load_description(given.robot)
    data = description_of(description, given.name)
    (given.out / f"{given.name}.xml").write_text(Writer(description).text(given.source))
    (given.out / f"{given.name}.yaml").write_text(write_yaml(data, {"": given.source}))
    load_description(given.out / f"{given.name}.yaml")


if __name__ == "__main__":
    main()
