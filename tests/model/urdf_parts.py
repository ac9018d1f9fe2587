"""Robots out of parts, as URDF text, for tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from wbmpc.cli import main
from wbmpc.robots.doctor import examine_robot

INERTIAL = '<inertial><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>'
#: Radius of wheels [m].
RADIUS = 0.1


def link(name: str, shape: str = "") -> str:
    return f'<link name="{name}">{INERTIAL}{shape}</link>'


def joint(
    name: str, parent: str, child: str, at: Sequence[float], axis: str = "", limit: str = "", kind: str = "", turn: str = "0 0 0",
    more: str = "",
) -> str:  # fmt: skip
    kind = kind or ("fixed" if not axis else "revolute" if limit else "continuous")
    place = " ".join(f"{v:.9g}" for v in at)
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{place}" rpy="{turn}"/>'
        f'{f"""<axis xyz="{axis}"/>""" if axis else ""}{f"<limit {limit}/>" if limit else ""}{more}</joint>'
    )


def wheel(
    name: str,
    at: Sequence[float],
    parent: str = "hull",
    radius: float = RADIUS,
    turn: str = "0 0 0",
    speed: float = 10.0,
) -> str:
    """A cylinder about y, with a limit of speed."""
    shape = f'<collision><origin rpy="1.5707963267948966 0 0"/><geometry><cylinder radius="{radius}" length="0.04"/></geometry></collision>'
    limit = f'<limit velocity="{speed}" effort="5"/>'
    return link(name, shape) + joint(
        f"{name}_joint", parent, name, at, "0 1 0", kind="continuous", turn=turn, more=limit
    )


def steered(name: str, at: Sequence[float], axis: str = "0 0 1", beside: float = 0.0) -> str:
    fork = link(f"{name}_fork") + joint(
        f"{name}_steer", "hull", f"{name}_fork", at, axis, kind="continuous", more='<limit velocity="5"/>'
    )
    return fork + wheel(name, (beside, 0.0, 0.0), f"{name}_fork")


#: Two links of 0.4 and 0.3 m on a vertical axis, a hand with two fingers, a head.
ARM = (
    link("shoulder") + joint("pan", "hull", "shoulder", (0.1, 0, 0.3), "0 0 1", 'lower="-3" upper="3" velocity="1.5" effort="40"')
    + link("upper") + joint("lift", "shoulder", "upper", (0, 0, 0.1), "0 1 0", 'lower="-2" upper="2" velocity="1.5" effort="40"')
    + link("fore") + joint("elbow", "upper", "fore", (0.4, 0, 0), "0 1 0", 'lower="-2.5" upper="2.5" velocity="2.5" effort="20"')
    + link("palm") + joint("mount", "fore", "palm", (0.3, 0, 0))
    + link("grasp_frame") + joint("grasp", "palm", "grasp_frame", (0.1, 0, 0))
    + link("finger_1") + joint("finger_1_joint", "palm", "finger_1", (0, 0.03, 0), "0 1 0", 'lower="0" upper="0.04"', "prismatic")
    + link("finger_2") + joint(
        "finger_2_joint", "palm", "finger_2", (0, -0.03, 0), "0 -1 0", 'lower="0" upper="0.04"', "prismatic", more='<mimic joint="finger_1_joint"/>')
    + link("head") + joint("head_pan", "hull", "head", (0, 0, 0.8), "0 0 1", 'lower="-1" upper="1" velocity="1"')
)  # fmt: skip
DIFFERENTIAL = wheel("left", (0, 0.25, RADIUS)) + wheel("right", (0, -0.25, RADIUS))
CASTER = (
    link("caster_fork") + joint("caster_turn", "hull", "caster_fork", (-0.3, 0, 0.05), "0 0 1") + link("caster_wheel")
)
CASTER += joint("caster_roll", "caster_fork", "caster_wheel", (-0.02, 0, 0), "0 1 0")
MECANUM = "".join(
    wheel(f"mecanum_{k}", (x, y, RADIUS))
    for k, (x, y) in enumerate([(0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2)])
)
OMNI = "".join(
    wheel(f"omni_{k}", (0.3 * np.cos(a), 0.3 * np.sin(a), RADIUS), turn=f"0 0 {a + np.pi / 2:.9g}")
    for k, a in enumerate([0.3, 2.4, 4.5])
)
SWERVE = (
    steered("front", (0.3, 0, RADIUS)) + steered("left", (-0.2, 0.3, RADIUS)) + steered("right", (-0.2, -0.3, RADIUS))
)


def model(folder: Path, body: str, name: str = "mover.urdf") -> Path:
    """A robot whose root is a frame on the ground."""
    path = folder / name
    path.write_text(
        f'<robot name="mover"><link name="base_footprint"/>{link("hull")}{joint("stand", "base_footprint", "hull", (0, 0, 0))}{body}</robot>'
    )
    return path


def new(path: Path, *options: str) -> Path:
    out = path.with_suffix(".yaml")
    assert main(["new", str(path), "--yes", "--out", str(out), "--force", *options]) == 0
    return out


def found(path: Path, check: str) -> str:
    """What the doctor says in that check."""
    return " | ".join(f"{f.severity}: {f.message}" for f in examine_robot(str(path)).findings if f.check == check)
