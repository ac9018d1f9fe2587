"""A robot whose links hang on the world of its file itself, which is its base then. Truth: the tree that robot_state_publisher and
tf2 make of the URDF and the transforms; joint angles of the file."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from frame_tree import joined, of_transforms, of_urdf
from wbmpc.cli import main
from wbmpc.model.robot import load_robot
from wbmpc.recording.reader import read_recording
from wbmpc.simulation.inline import show

ARM = """<mujoco><worldbody><geom type="plane" size="2 2 0.1"/>
<body name="upper" pos="0 0 0.5"><joint name="pan" axis="0 0 1" range="-90 90"/><geom type="capsule" size="0.05 0.1"/>
<body name="lower" pos="0 0 0.3"><joint name="lift" axis="0 1 0" range="-90 90"/><geom type="capsule" size="0.05 0.1"/></body></body>
</worldbody></mujoco>"""
URDF = (
    '<robot name="r"><link name="world"/>{}</robot>',
    '<link name="{}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>',
    '<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/><axis xyz="0 {} 1"/><origin xyz="0 0 0.3"/>'
    '<limit lower="-1" upper="1" effort="50" velocity="1"/></joint>',
)


def tree_of(folder: Path) -> tuple[set[str], dict[str, str]]:
    """Links of the URDF, and parents by child of it and of all transforms."""
    recording = read_recording(folder)
    plain = lambda message: json.loads(json.dumps(message, default=list), object_hook=lambda d: SimpleNamespace(**d))
    messages = lambda topic: [plain(message) for _, message in recording[topic].messages()]
    links, fixed = of_urdf(messages("/robot_description")[0].data)
    return links, joined(of_transforms([*messages("/tf"), *messages("/tf_static")]), fixed)


def test_a_base_that_does_not_move_has_one_parent(tmp_path: Path) -> None:
    out = str(tmp_path / "a")
    assert main(["run", "hold", "--set", "robot=panda", "--set", "duration=0.1", "--out", out, "--quiet"]) == 0
    links, tree = tree_of(tmp_path / "a")
    assert links <= set(tree) and tree["base_link"] == "odom"


@pytest.mark.parametrize("name", ["arm.xml", "arm.urdf"])
def test_a_robot_that_hangs_on_the_world_runs_and_has_one_tree(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    parts = "".join(URDF[1].format(n) for n in ("upper", "lower"))
    parts += URDF[2].format("pan", "world", "upper", 0) + URDF[2].format("lift", "upper", "lower", 1)
    Path(name).write_text(ARM if name == "arm.xml" else URDF[0].format(parts))
    assert main(["new", name, "--yes", "--quiet"]) == 0
    assert "body: world" in Path("arm.yaml").read_text()
    assert main(["run", "hold", "--set", "robot=arm.yaml", "--set", "duration=0.1", "--out", "a", "--quiet"]) == 0
    links, tree = tree_of(Path("a"))
    assert links <= set(tree) and tree["base_link"] == "odom" and tree["upper"] == "base_link"
    robot = load_robot("arm.yaml")
    assert len(show(robot, np.array([robot.home]))._repr_html_()) > 1000
