"""The layout for Foxglove. Truth: the topics and fields of the recording itself."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from wbmpc.cli import main
from wbmpc.errors import InputError
from wbmpc.recording.layout import layout
from wbmpc.recording.reader import read_recording
from wbmpc.recording.writer import McapFile, stamp


def header(t: float, frame: str) -> dict[str, Any]:
    return {"stamp": stamp(t), "frame_id": frame}


@pytest.fixture
def run(tmp_path: Path) -> Path:
    file = McapFile(tmp_path / "run.mcap")
    pose = np.array([0.0, 0, 0, 0, 0, 0, 1])
    link = {"header": header(0.0, "map"), "child_frame_id": "base_link", "transform": pose}
    joints = {"header": header(0.0, ""), "name": ["a", 'b"<']} | dict.fromkeys(
        ("position", "velocity", "effort"), np.zeros(2)
    )
    file.put("/tf", "tf2_msgs/TFMessage", 0.0, {"transforms": [link]})
    file.put("/joint_states", "sensor_msgs/JointState", 0.0, joints)
    for topic in ("/end_effector/pose_odom", "/end_effector/reference"):
        file.put(topic, "geometry_msgs/PoseStamped", 0.0, {"header": header(0.0, "odom"), "pose": pose})
    file.put("/mpc/solve_time", "std_msgs/Float64", 0.0, [0.001])
    file.close()
    return tmp_path


def leaves(tree: Any) -> list[str]:
    return [tree] if isinstance(tree, str) else leaves(tree["first"]) + leaves(tree["second"])


def test_every_panel_is_shown_once_and_every_path_is_in_the_recording(run: Path) -> None:
    recording = read_recording(run)
    made = layout(recording)
    assert sorted(leaves(made["layout"])) == sorted(made["configById"])
    picture = made["configById"]["3D!robot"]
    assert (
        set(picture["topics"]) <= set(recording.topics) and "robot" not in picture["layers"]
    )  # no description was recorded
    paths = [p for panel in made["configById"].values() for p in panel.get("paths", ())]
    assert {p["label"] for p in paths} >= {"a", 'b"<', "x, reference", "solve time"}
    for path in paths:
        topic, field = next(
            (t, path["value"].removeprefix(f"{t}.")) for t in recording.topics if path["value"].startswith(f"{t}.")
        )
        columns = recording.table(topic).columns
        joint = re.fullmatch(r"(\w+)\[(\d)\]", field)
        assert (f"{joint[1]}.{['a', chr(98) + chr(34) + '<'][int(joint[2])]}" if joint else field) in columns


def test_the_command_writes_it_beside_the_recording(run: Path) -> None:
    assert main(["log", "layout", str(run), "--json"]) == 0
    assert json.loads((run / "foxglove.json").read_text()) == layout(read_recording(run))
    assert main(["log", "layout", str(run)]) == 0 and (run / "foxglove-2.json").is_file()  # the first one stays


def test_a_recording_with_nothing_to_show_is_an_error(tmp_path: Path) -> None:
    file = McapFile(tmp_path / "run.mcap")
    file.put("/mode", "std_msgs/String", 0.0, {"data": "H"})
    file.close()
    with pytest.raises(InputError, match="holds no frames"):
        layout(read_recording(tmp_path))
