"""A layout of Foxglove for a recording: the robot with its paths and contact forces, and plots, without anything to set up."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, islice
from typing import Any

from wbmpc.errors import InputError
from wbmpc.recording.quantities import Columns
from wbmpc.recording.reader import Recording
from wbmpc.robots.frames import BASE, MAP
from wbmpc.units import with_unit

#: Key of a panel's title among its settings.
TITLE = "foxglovePanelTitle"
#: Share of the width that the robot has [%].
_PICTURE = 60
#: How topics are drawn in 3D, where a recording has them.
_DRAWN: dict[str, dict[str, Any]] = {
    "/plan": {"type": "line", "lineWidth": 0.02, "gradient": ["#28a05aff", "#28a05aff"]},
    "/end_effector_plan": {"type": "line", "lineWidth": 0.02, "gradient": ["#1e6edcff", "#1e6edcff"]},
    "/end_effector_reference": {"type": "axis", "axisScale": 0.2},
    "/ground_truth/end_effector": {"type": "axis", "axisScale": 0.12},
    "/end_effector_pose": {"type": "axis", "axisScale": 0.12},
}
#: In so many messages of a recording each frame appears that has a parent.
_FRAMES = 2000


def layout(recording: Recording) -> dict[str, Any]:
    """What Foxglove imports as a layout. Raises :class:`InputError` for a recording without anything that it shows."""
    panels: dict[str, dict[str, Any]] = {}
    if "/tf" in recording.topics:
        panels["3D!robot"] = _picture(recording)
    panels |= {f"Plot!{i}": plot for i, plot in enumerate(_plots(recording), start=1)}
    if not panels:
        raise InputError(f"{recording.path}: holds no frames (/tf), joints, or numbers to plot")
    plots = [name for name in panels if name.startswith("Plot!")]
    shown: Any = _stacked(plots) if plots else "3D!robot"
    if plots and "3D!robot" in panels:
        shown = {"direction": "row", "first": "3D!robot", "second": shown, "splitPercentage": _PICTURE}
    return {
        "configById": panels, "globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}, "layout": shown,
    }  # fmt: skip


def _stacked(names: Sequence[str]) -> Any:
    """Panels one below the other, all of a height."""
    if len(names) == 1:
        return names[0]
    share = 100 / len(names)
    return {"direction": "column", "first": names[0], "second": _stacked(names[1:]), "splitPercentage": share}


def _picture(recording: Recording) -> dict[str, Any]:
    topics = {name: {"visible": True, **style} for name, style in _DRAWN.items() if name in recording.topics}
    if "/ground_truth/end_effector" in topics:  # which a real robot's bus does not have
        topics.pop("/end_effector_pose", None)
    root = _root(recording)
    topics |= {name: {"visible": True} for name in recording.topics if name.startswith("/contact/")}
    grid = {"layerId": "foxglove.Grid", "instanceId": "grid", "label": "Floor", "visible": True, "frameId": root}
    layers: dict[str, Any] = {"grid": {**grid, "size": 20, "divisions": 40, "lineWidth": 1, "color": "#9aa7b380"}}
    if "/robot_description" in recording.topics:
        layers["robot"] = {
            "layerId": "foxglove.Urdf", "instanceId": "robot", "label": "Robot", "visible": True, "sourceType": "topic",
            "topic": "/robot_description", "framePrefix": "", "displayMode": "auto",
        }  # fmt: skip
    camera = {
        "perspective": True, "distance": 5, "phi": 65, "thetaOffset": 45, "target": [0, 0, 0],
        "targetOffset": [0, 0, 0.4],
    }  # fmt: skip
    hidden = {"showLabel": False, "axisSize": 0, "lineWidth": 0}
    return {
        TITLE: "Robot",
        "fixedFrame": root, "followTf": BASE, "followMode": "follow-position", "cameraState": camera, "topics": topics, "layers": layers,
        "scene": {"transforms": hidden, "meshUpAxis": "z_up"},
    }  # fmt: skip


def _root(recording: Recording) -> str:
    """The frame in which the base's are, in the end: of a robot without a localization in a map the one of its odometry."""
    found = [recording.topics[name] for name in ("/tf", "/tf_static") if name in recording.topics]
    messages = chain.from_iterable(islice(topic.messages(), _FRAMES) for topic in found)
    parents = {f["child_frame_id"]: f["header"]["frame_id"] for _, m in messages for f in m["transforms"]}
    root = BASE
    while root in parents and root != MAP:
        root = parents.pop(root)
    return root if root != BASE else MAP


def _plots(recording: Recording) -> list[dict[str, Any]]:
    """Where the end effector is and should be, solve times, joint speeds and drive forces, contact forces."""
    topics = recording.topics
    poses = [("/end_effector_pose", "end effector"), ("/end_effector_reference", "reference")]
    hands = [(f"{t}.pose.position.{a}", f"{a}, {name}") for a in "xyz" for t, name in poses if t in topics]
    solve = [(f"/mpc/{n}.data", n.replace("_", " ")) for n in ("solve_time", "period") if f"/mpc/{n}" in topics]
    states_topic = topics.get("/joint_states")
    known = states_topic is not None and states_topic.kind == "sensor_msgs/JointState"
    joints = list(states_topic.last()["name"]) if known and states_topic else []
    units = Columns(recording)
    by_unit: dict[str, list[tuple[str, str]]] = {}
    for part, title in (("velocity", "Joint speeds"), ("effort", "Drives")):
        for i, name in enumerate(joints):
            titled_so = with_unit(title, units.unit("/joint_states", f"{part}.{name}", len(joints)))
            by_unit.setdefault(titled_so, []).append((f"/joint_states.{part}[{i}]", name))
    forces = [(f"{t}.wrench.force.z", t.removeprefix("/contact/")) for t in topics if t.startswith("/contact/")]
    titled = {
        "End effector and reference [m]": hands, "Solve time and period [s]": solve, **by_unit,
        "Vertical contact forces [N]": forces,
    }  # fmt: skip
    return [_plot(title, lines) for title, lines in titled.items() if lines]


def _plot(title: str, lines: Sequence[tuple[str, str]]) -> dict[str, Any]:
    paths = [
        {"value": path, "label": label, "enabled": True, "timestampMethod": "receiveTime"} for path, label in lines
    ]
    return {
        TITLE: title, "paths": paths, "xAxisVal": "timestamp", "isSynced": True, "showXAxisLabels": True, "showYAxisLabels": True,
        "showLegend": True, "legendDisplay": "floating", "showPlotValuesInLegend": True,
    }  # fmt: skip
