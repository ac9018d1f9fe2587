"""Default weights by scaling rules. Truth: an arm whose telescope is one joint costs as much as the same arm with a joint for each section;
the numbers by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.ocp.scaling import free_share, scaled_weights, telescopes

INERTIAL = '<inertial><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>'
#: Sections' ranges [m] and speeds [m/s], which reach out along −y of a lift that is turned by a quarter.
RANGES, SPEEDS = (0.1, 0.1, 0.2), (0.3, 0.3, 0.6)
SECTIONS = tuple(f"section_{k}" for k in range(3))


def joint(name: str, parent: str, axis: str, limit: str, kind: str = "revolute", turned: str = "0 0 0") -> str:
    return (
        f'<link name="{name}_link">{INERTIAL}</link><joint name="{name}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{name}_link"/><origin xyz="0 0 0.2" rpy="{turned}"/><axis xyz="{axis}"/><limit {limit} effort="10"/></joint>'
    )


def robot(folder: Path, sections: bool) -> RobotModel:
    """A base that takes speeds with a lift, a telescope and a wrist; ``sections``: whether nothing couples the telescope's."""
    parts, parent = [f'<link name="foot">{INERTIAL}</link>'], "lift_link"
    parts.append(joint("lift", "foot", "0 0 1", 'lower="0" upper="1" velocity="0.5"', "prismatic"))
    for k, (name, length, speed) in enumerate(zip(SECTIONS, RANGES, SPEEDS, strict=True)):
        limit = f'lower="0" upper="{length}" velocity="{speed}"'
        parts.append(joint(name, parent, "1 0 0", limit, "prismatic", "0 0 -1.5707963" if k == 0 else "0 0 0"))
        parent = f"{name}_link"
    for name, axis in (("yaw", "0 0 1"), ("pitch", "0 1 0"), ("roll", "1 0 0")):
        parts.append(joint(name, parent, axis, 'lower="-2" upper="2" velocity="1"'))
        parent = f"{name}_link"
    (folder / "arm.urdf").write_text(f'<robot name="arm">{"".join(parts)}</robot>')
    joints = ["lift", *(SECTIONS if sections else SECTIONS[:1]), "yaw", "pitch", "roll"]
    couple = "" if sections else "couple: {section_1: section_0, section_2: {joint: section_0, ratio: 2.0}}\n"
    file = folder / "arm.yaml"
    file.write_text(
        f"name: arm\nmodel: arm.urdf\nbase: {{type: planar, body: foot, drive: omni}}\narm: {{joints: {joints}, tool: roll_link}}\n{couple}"
        "limits: {base_linear: 1.0, base_angular: 1.0}\n".replace("'", "")
    )
    return load_robot(str(file))


@pytest.fixture(scope="module")
def robots(tmp_path_factory: pytest.TempPathFactory) -> tuple[RobotModel, RobotModel]:
    return robot(tmp_path_factory.mktemp("free"), True), robot(tmp_path_factory.mktemp("coupled"), False)


def test_sections_of_a_telescope_are_found(robots: tuple[RobotModel, RobotModel]) -> None:
    assert telescopes(robots[0]) == [[1, 2, 3]]
    assert telescopes(robots[1]) == []


def test_sections_weigh_together_as_one_joint(robots: tuple[RobotModel, RobotModel]) -> None:
    """Reaching out by 0.3 m, each section by its share, with 0.9 m/s."""
    share = np.array(RANGES) / sum(RANGES)
    free, coupled = (scaled_weights(r) for r in robots)
    posture = float(free.posture[1:4] @ (0.3 * share) ** 2), float(coupled.posture[1] * (0.3 * share[0]) ** 2)
    assert posture == pytest.approx((2.0 / 3.0 * 0.5 * (0.3 / 0.2) ** 2,) * 2)
    inputs = float(np.array(free.input["arm"][1:4]) @ (0.9 * share) ** 2), coupled.input["arm"][1] * 0.225**2
    assert inputs == pytest.approx((0.4 * (0.9 / 1.2) ** 2,) * 2)


def test_the_other_joints_weigh_alike(robots: tuple[RobotModel, RobotModel]) -> None:
    free, coupled = (scaled_weights(r) for r in robots)
    for one, other in ((free.posture, coupled.posture), (free.input["arm"], coupled.input["arm"])):
        assert np.delete(np.array(one), [1, 2, 3]) == pytest.approx(np.delete(np.array(other), 1))


def test_a_telescope_leaves_as_much_free_as_one_joint(robots: tuple[RobotModel, RobotModel]) -> None:
    """Of 5 ways to move the arm and 3 of the base, 2 more than a pose has numbers."""
    assert [free_share(r) for r in robots] == pytest.approx([2.0 / 3.0] * 2)
