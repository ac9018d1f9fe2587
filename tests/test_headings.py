"""Headings along a known path of a base that cannot go sideways. Truth: the wrist's range, which alone turns the end effector; geometry by
hand; the closed loop's error on the model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import wbmpc as wb
from wbmpc.experiment import run_scenario
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.route import base_part
from wbmpc.tasks import headings as planned
from wbmpc.tasks import path_settings, track
from wbmpc.tasks.following import PathTaskSettings, Task

INERTIAL = '<inertial><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>'
#: Turns [rad] of the wrist, about the vertical.
RANGE = (-1.9, 1.2)
#: A circle to the left that begins so far aside [rad]: driving ahead asks the wrist for -1.7, which it has, back for 1.44.
ASIDE = 1.7


def joint(name: str, kind: str, parent: str, place: str, axis: str, low: float, high: float) -> str:
    return (
        f'<link name="{name}_link">{INERTIAL}</link><joint name="{name}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{name}_link"/><origin xyz="{place}"/><axis xyz="{axis}"/>'
        f'<limit lower="{low}" upper="{high}" velocity="1" effort="10"/></joint>'
    )


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two wheels, a lift, a telescope to the right, and a wrist."""
    folder = tmp_path_factory.mktemp("aside")
    wheel = lambda name, y: (
        joint(name, "continuous", "base", f"0 {y} 0.1", "0 1 0", -1e3, 1e3)
        .replace('velocity="1"', 'velocity="12"')
        .replace(
            INERTIAL,
            f'{INERTIAL}<collision><origin rpy="1.5707963 0 0"/><geometry><cylinder radius="0.1" length="0.02"/></geometry></collision>',
        )
    )
    parts = [f'<link name="base">{INERTIAL}</link>', wheel("left", 0.2), wheel("right", -0.2)]
    parts.append(joint("lift", "prismatic", "base", "0 0 0.3", "0 0 1", 0.0, 1.0))
    parts.append(joint("slide", "prismatic", "lift_link", "0 -0.3 0", "0 -1 0", 0.0, 0.5))
    parts.append(joint("wrist", "revolute", "slide_link", "0 0 0", "0 0 1", *RANGE))
    parts.append(
        '<link name="tip"/><joint name="tip" type="fixed"><parent link="wrist_link"/><child link="tip"/><origin xyz="0.2 0 0"/></joint>'
    )
    (folder / "aside.urdf").write_text(f'<robot name="aside">{"".join(parts)}</robot>')
    path = folder / "aside.yaml"
    path.write_text(
        "name: aside\nmodel: aside.urdf\nbase: {type: differential, body: base, wheels: [left, right]}\n"
        "arm: {joints: [lift, slide, wrist], tool: tip}\nhome: {lift: 0.5, slide: 0.25, wrist: 0}\n"
        "limits: {base_linear: 1.0, base_angular: 1.0}\n"
    )
    return path


@pytest.fixture(scope="module")
def robot(file: Path) -> RobotModel:
    return wb.load_robot(file)


def settings(file: Path) -> PathTaskSettings:
    path = {"kind": "circle", "length": 2.0, "laps": 0.4, "turn": True, "direction": ASIDE}
    return PathTaskSettings.model_validate({"robot": str(file), "plant": "kinematic", "path": path, "settle_time": 2.0})


def test_turns_of_an_end_effector_are_those_of_its_wrist(robot: RobotModel) -> None:
    found = planned.turns(robot)
    assert found is not None
    np.testing.assert_allclose(found, RANGE, atol=0.05)


def test_robots_that_go_sideways_or_turn_their_end_effector_round_have_no_headings() -> None:
    reference = wb.Reference.poses([0.0, 1.0], [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]], [1.0, 0.0, 0.0, 0.0])
    for name in ("mecanum-ur10", "panda", "fetch"):
        assert planned.headings(wb.load_robot(name), reference) is None


def test_headings_leave_the_end_effector_within_its_turns_and_point_along_the_path(
    file: Path, robot: RobotModel
) -> None:
    """The end effector turns with the circle: by the arc over the radius. Ahead is the only way."""
    task = Task(settings(file))
    reference = task.mpc.reference["end_effector"]
    found = planned.headings(robot, reference)
    assert found is not None
    times, yaw = found
    poses = np.array([reference.at(t) for t in times])
    turned = np.unwrap(2.0 * np.arctan2(poses[:, 6], poses[:, 3]))
    against = turned - turned[0] - yaw
    assert (against > RANGE[0]).all() and (against < RANGE[1]).all()
    assert np.abs(np.diff(yaw)).max() <= planned.SHARE * planned.STEP * 1.0 + 1e-9  # of 1 rad/s
    way = np.diff(poses[:, :2], axis=0)
    moves = (np.linalg.norm(way, axis=1) > 0.04) & (times[1:] > 5.0)
    ahead = np.cos(np.arctan2(way[:, 1], way[:, 0]) - yaw[1:])
    assert moves.sum() > 10 and (ahead[moves] > 0.95).all()
    assert task.mpc.reference["state"].at(times[-1])[base_part(robot)][2] == pytest.approx(yaw[-1], abs=0.1)


def test_a_path_is_followed_whose_nearer_heading_the_wrist_does_not_have(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with_them = run_scenario("path", track.build, settings(file), 0)
    monkeypatch.setattr(path_settings, "headings", lambda *_: None)
    without = run_scenario("path", track.build, settings(file), 0)
    mean = lambda run: run.metrics["end_effector_error_mean"].value
    assert with_them.completed and mean(with_them) < 1e-3
    assert mean(without) > 3.0 * mean(with_them)
