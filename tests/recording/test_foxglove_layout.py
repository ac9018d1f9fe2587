"""The layout for Foxglove. Truth: the topics and fields of the recording itself; the settings that `foxglove.layouts` of Foxglove's SDK
documents (version 0.30)."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from wbmpc.cli import main
from wbmpc.errors import InputError
from wbmpc.recording.layout import TITLE, layout
from wbmpc.recording.reader import read_recording
from wbmpc.recording.writer import McapFile, stamp

#: Settings of panels and of their parts by their class in the SDK: those that the layout uses, and how it fills them.
DOCUMENTED = {
    "PlotConfig": "paths isSynced legendDisplay showLegend showPlotValuesInLegend showXAxisLabels showYAxisLabels xAxisVal",
    "PlotSeries": "value label enabled timestampMethod",
    "ThreeDeeConfig": "fixedFrame followTf followMode cameraState topics layers scene",
    "ThreeDeeCameraState": "perspective distance phi thetaOffset target targetOffset",
    "BaseRendererSceneSettings": "transforms meshUpAxis",
    "BaseRendererTransforms": "showLabel axisSize lineWidth",
    "BaseRendererGridLayerSettings": "layerId instanceId label visible frameId size divisions lineWidth color",
    "BaseRendererUrdfLayerSettings": "layerId instanceId label visible sourceType topic framePrefix displayMode",
    "BaseRendererPosesTopicSettings": "visible type lineWidth gradient",
    "BaseRendererPoseTopicSettings": "visible type axisScale",
}


def header(t: float, frame: str) -> dict[str, Any]:
    return {"stamp": stamp(t), "frame_id": frame}


@pytest.fixture
def run(tmp_path: Path) -> Path:
    file = McapFile(tmp_path / "run.mcap")
    pose = np.array([0.0, 0, 0, 0, 0, 0, 1])
    path = {"header": header(0.0, "map"), "poses": [{"header": header(0.0, "map"), "pose": pose}]}
    link = {"header": header(0.0, "map"), "child_frame_id": "base_link", "transform": pose}
    joints = {"header": header(0.0, ""), "name": ["a", 'b"<']} | dict.fromkeys(
        ("position", "velocity", "effort"), np.zeros(2)
    )
    file.put("/tf", "tf2_msgs/TFMessage", 0.0, {"transforms": [link]})
    file.put("/joint_states", "sensor_msgs/JointState", 0.0, joints)
    for topic in ("/end_effector_pose", "/end_effector_reference"):
        file.put(topic, "geometry_msgs/PoseStamped", 0.0, {"header": header(0.0, "odom"), "pose": pose})
    for topic in ("/plan", "/end_effector_plan"):
        file.put(topic, "nav_msgs/Path", 0.0, path)
    file.put("/robot_description", "std_msgs/String", 0.0, {"data": "<robot/>"})
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
    assert set(picture["topics"]) <= set(recording.topics) and picture["layers"]["robot"]["topic"] in recording.topics
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


@pytest.mark.parametrize(("frames", "truth", "fixed"), [
    (["odom base_link"], False, "odom"), (["odom base_link"] * 20 + ["map odom"], False, "map"), (["odom base_link", "map odom"], True, "map"),
])  # fmt: skip
def test_what_a_real_robots_bus_says_is_drawn(tmp_path: Path, frames: list[str], truth: bool, fixed: str) -> None:
    """It has no true poses, and ``map`` only with a localization: Foxglove draws nothing in a frame that is not there. Truth: the frames
    themselves."""
    file, pose = McapFile(tmp_path / "run.mcap"), np.array([0.0, 0, 0, 0, 0, 0, 1])
    for k, (parent, child) in enumerate(map(str.split, frames)):
        link = {"header": header(0.01 * k, parent), "child_frame_id": child, "transform": pose}
        file.put("/tf", "tf2_msgs/TFMessage", 0.01 * k, {"transforms": [link]})
    for topic in ("/end_effector_pose", *["/ground_truth/end_effector"] * truth):
        file.put(topic, "geometry_msgs/PoseStamped", 0.0, {"header": header(0.0, "odom"), "pose": pose})
    file.close()
    picture = layout(read_recording(tmp_path))["configById"]["3D!robot"]
    assert picture["fixedFrame"] == picture["layers"]["grid"]["frameId"] == fixed
    assert list(picture["topics"]) == ["/ground_truth/end_effector" if truth else "/end_effector_pose"]


POSES = ("/end_effector_reference", "/ground_truth/end_effector", "/end_effector_pose")


def test_every_setting_is_one_that_foxglove_documents(run: Path) -> None:
    """A key that it does not know is ignored without a word."""
    panels = layout(read_recording(run))["configById"]
    picture = panels["3D!robot"]
    found: dict[str, list[dict[str, Any]]] = {
        "PlotConfig": [p for name, p in panels.items() if name.startswith("Plot!")],
        "ThreeDeeConfig": [picture], "ThreeDeeCameraState": [picture["cameraState"]],
        "BaseRendererSceneSettings": [picture["scene"]], "BaseRendererTransforms": [picture["scene"]["transforms"]],
        "BaseRendererGridLayerSettings": [picture["layers"]["grid"]], "BaseRendererUrdfLayerSettings": [picture["layers"]["robot"]],
        "BaseRendererPosesTopicSettings": [s for topic, s in picture["topics"].items() if topic.endswith("plan")],
        "BaseRendererPoseTopicSettings": [s for topic, s in picture["topics"].items() if topic in POSES],
    }  # fmt: skip
    found["PlotSeries"] = [s for plot in found["PlotConfig"] for s in plot["paths"]]
    for kind, parts in found.items():
        assert parts and all(set(part) - {TITLE} == set(DOCUMENTED[kind].split()) for part in parts), kind


def test_what_is_documented_is_what_the_sdk_has() -> None:
    sdk = pytest.importorskip("foxglove.layouts")
    for kind, keys in DOCUMENTED.items():
        assert set(keys.split()) <= set(getattr(sdk, kind)()._to_dict()), kind
