"""A swerve robot of one's own, from a URDF whose root link is the base. Truth: MuJoCo's physics: it stands, and drives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.perturbation import SwervePerturbation
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.model.robot import load_robot

PLACES = {"lf": (0.4, 0.3), "rf": (0.4, -0.3), "lb": (-0.4, 0.3), "rb": (-0.4, -0.3)}


def link(name: str, mass: float) -> str:
    inertia = '<inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/>'
    return f'<link name="{name}"><inertial><mass value="{mass}"/>{inertia}</inertial></link>'


def joint(name: str, kind: str, parent: str, child: str, place: str, axis: str = "0 0 1") -> str:
    limit = '<limit lower="-3" upper="3" effort="60" velocity="3"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{place}"/><axis xyz="{axis}"/>{limit}</joint>'
    )


def urdf() -> str:
    parts = [link("base_link", 40.0)]
    for name, (x, y) in PLACES.items():
        parts += [link(f"{name}_fork", 3.0), link(f"{name}_rim", 1.5)]
        parts.append(joint(f"{name}_steer", "revolute", "base_link", f"{name}_fork", f"{x} {y} -0.2"))
        parts.append(joint(f"{name}_wheel", "continuous", f"{name}_fork", f"{name}_rim", "0 0 -0.1", "0 1 0"))
    parts += [link("upper", 2.0), joint("shoulder", "revolute", "base_link", "upper", "0.2 0 0.2", "0 1 0")]
    return f'<robot name="own">{"".join(parts)}</robot>'


@pytest.fixture
def robot(tmp_path: Path):  # type: ignore[no-untyped-def]
    (tmp_path / "own.urdf").write_text(urdf())
    modules = "".join(f"    - {{steer: {n}_steer, wheel: {n}_wheel}}\n" for n in PLACES)
    (tmp_path / "own.yaml").write_text(
        "name: own\nmodel: own.urdf\nbase:\n  type: swerve\n  body: base_link\n  wheel_radius: 0.1\n  modules:\n"
        f"{modules}arm: {{joints: [shoulder], tool: upper}}\n"
    )
    return load_robot(tmp_path / "own.yaml")


def test_it_stands_and_drives(robot) -> None:  # type: ignore[no-untyped-def]
    plant = SwervePlant(robot.description, None, SwervePerturbation.none())
    start = plant.truth()
    assert start.tilt < 1e-3
    # the planner's height of the end effector is the simulated one, but for what the tires give way
    assert start.tool[2] == pytest.approx(robot.pose(robot.home)[0][2], abs=5e-3)
    for _ in range(200):
        plant.step(SwerveCommand(np.full(4, 2.0), np.zeros(4), np.zeros(1), np.zeros(0)), 10)
    moved = plant.truth().pose - start.pose
    assert moved[0] == pytest.approx(0.2, abs=0.02)
    np.testing.assert_allclose(moved[1:], 0.0, atol=5e-3)
    assert not plant.fell
