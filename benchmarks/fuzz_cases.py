"""Generated inputs of the fuzz command: settings, robot files, recordings, logs, calibrations, buses' files, messages, scenes.

A case knows what it must lead to where that can be known: ``valid`` (accepted), ``invalid`` (rejected), or nothing (either).
"""

from __future__ import annotations

import json
import random
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from wbmpc.configuration import keys
from wbmpc.errors import InputError
from wbmpc.experiment import Experiment
from wbmpc.recording.messages import DEFINITIONS, decode, encode
from wbmpc.recording.writer import McapFile, stamp
from wbmpc.registry import REGISTRY
from wbmpc.robots.description import DATA

VALID, INVALID, OPEN = "valid", "invalid", "open"


class Accepted(BaseException):
    """A stand-in for an experiment: its settings were accepted."""


@dataclass
class Case:
    """What to do, with what to expect: arguments of the command line, or a function."""

    what: str
    expected: str
    arguments: list[str] | None = None
    call: Callable[[], object] | None = None


def registry() -> dict[str, Experiment]:
    """The experiments, none of which runs."""

    def accept(*_: object) -> Any:
        raise Accepted

    return {name: Experiment(name, e.summary, e.config_type, accept) for name, e in REGISTRY.items()}


# ---------------------------------------------------------------------- YAML
#: Values that no key takes, whatever it is.
NEVER = (
    "010", "-017", "1:30", "12:30:45", "!!python/object:os.system x", "!!int 3", "&a 1", "*a",
    "[" * 200, "{a: " * 100, "[1",
    "{a: 1, a: 2}", "{<<: {a: 1}}", '"\\ud800"', '"\\0"', '"\\UFFFFFFFF"', "9" * 5000, "1e999", "- [",
    "%YAML 1.1.1", "a: b: c",
    "0x_", "\t- 1", "@x", "`x`", "|\n\x01",
    "!<tag:x> 1", "{? [1] : 2}", "'",
)  # fmt: skip
_TOKENS = (
    "1", "-1", "0", "0.5", "1e3", "-.inf", ".nan", "true", "no", "null", "~", "a", "swerve-ur10", "[", "]", "{",
    "}", ",", ":", ": ",
    "- ", "\n", " ", "'", '"', "#", "&", "*", "!", "|", ">", "%", "?", "010", "1:30", "_", "+", "0x1", "\u00e9",
    "\u202e", "2020-01-01",
)  # fmt: skip


def soup(rng: random.Random) -> str:
    """Tokens of YAML in any order."""
    return "".join(rng.choice(_TOKENS) for _ in range(rng.randint(1, 12)))


def settings(rng: random.Random, folder: Path) -> Case:
    """Values of ``--set``."""
    name = rng.choice(list(REGISTRY))
    model = REGISTRY[name].config_type
    key = rng.choice(keys(model))
    value: Any = model().model_dump(mode="json")
    for part in key.split("."):
        value = None if value is None else value[part]
    kind, expected = rng.choice(("default", "never", "soup", "unknown", "not finite", "number")), INVALID
    text = json.dumps(value)
    if kind == "default":
        expected = VALID if value is not None else OPEN
    elif kind == "never":
        text = rng.choice(NEVER)
    elif kind == "soup":
        text, expected = soup(rng), OPEN
    elif kind == "unknown":
        key += rng.choice(("x", ".a", "-", " b", "\u00e9"))
    elif kind == "not finite":
        text = rng.choice((".nan", ".inf", "-.inf", "nan", "inf", "[.nan, 1]", "{a: .inf}"))
    else:
        text, expected = repr(rng.uniform(-1, 1) * 10.0 ** rng.randint(-320, 300)), OPEN
    return Case(f"{name}: {kind}: {key}={text[:60]}", expected, ["run", name, "--set", f"{key}={text}"])


# ---------------------------------------------------------------------- robots
def robots(rng: random.Random, folder: Path) -> Case:
    """Robot files: a built-in one that was changed."""
    name = rng.choice(("swerve-ur10", "swerve-fixed-ur10", "rezero", "swerve-mabi"))
    text = (DATA / f"{name}.yaml").read_text()
    data = yaml.safe_load(text)
    data["model"] = str(DATA / data["model"])
    place, key = rng.choice(
        [(data, k) for k in data] + [(data[s], k) for s in ("base", "arm", "limits") for k in data[s]]
    )
    kind, expected = (
        rng.choice(("as it is", "radius", "never", "twice", "missing", "unknown", "soup", "number")),
        INVALID,
    )
    out = ""
    if kind == "as it is":
        expected = VALID
    elif kind == "radius":
        radius = "ball_radius" if "ball_radius" in data["base"] else "wheel_radius"
        factor = rng.choice((0.97, 1.03, 0.5, 0.9, 1.1, 50.0, 1e9))
        data["base"][radius] *= factor
        expected = VALID if abs(factor - 1.0) < 0.05 else INVALID
    elif kind == "unknown":
        place[f"{key}_{rng.randint(0, 9)}"] = 1
        # joints' tables take any name, and say which they do not know
    elif kind == "missing":
        key = rng.choice(("name", "model", "base", "arm"))
        del data[key]
    elif kind == "number":
        place[key], expected = rng.uniform(-1, 1) * 10.0 ** rng.randint(-300, 300), OPEN
    if kind in ("never", "soup", "twice"):
        line = f"{rng.choice(list(data))}: "
        more = {"never": rng.choice(NEVER), "soup": soup(rng), "twice": "1"}[kind]
        body = {k: v for k, v in data.items() if kind == "twice" or f"{k}: " != line}
        out, expected = yaml.safe_dump(body) + f"{line}{more}\n", OPEN if kind == "soup" else INVALID
    path = folder / "robot.yaml"
    path.write_text(out or yaml.safe_dump(data, sort_keys=False), "utf-8", "surrogatepass")
    return Case(f"{name}: {kind}: {key}", expected, call=lambda: _load_robot(path))


def _load_robot(path: Path) -> None:
    from wbmpc.model.robot import load_robot

    load_robot(path)


_ARM = """<mujoco model="arm">{top}
 <worldbody><body name="b"><geom size="0.1"/>
  <body name="t" pos="0 0 {far}"><joint name="j" axis="0 0 1" range="-60 60"/>
  <geom type="box" size="{size} 0.1 0.1"/>{inside}</body>
 </body>{world}</worldbody>{end}</mujoco>"""
_URDF = """<robot name="arm"><link name="b"/><link name="t"><inertial><mass value="{size}"/><origin xyz="0 0 {far}"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>{world}
<joint name="j" type="revolute"><parent link="b"/><child link="t"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>{inside}</robot>"""
_BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
#: By name of a place in the template what makes the file too large, broken or senseless.
_HUGE: tuple[tuple[str, str], ...] = (
    ("world", '<replicate count="100000" offset="0 0 1"><body><geom size="1"/></body></replicate>'),
    ("inside", '<replicate count="999"><replicate count="999"><geom size="1"/></replicate></replicate>'),
    ("world", "<body>" * 5000 + "</body>" * 5000), ("world", "<body/>" * 3000), ("world", '<geom size="1"/>' * 4000),
    ("world", '<include file="arm.xml"/>'), ("inside", '<geom size="-1"/>'), ("world", "<body"), ("world",
    "<x y='1'/>"),
    ("top", '<asset><texture name="x" type="2d" builtin="flat" width="90000" height="90000"/></asset>'),
    ("top", '<asset><hfield name="h" nrow="90000" ncol="90000" size="1 1 1 1"/></asset>'),
    ("top", '<asset><mesh name="h" builtin="supersphere" params="9000 1 1"/></asset>'),
    ("end", '<custom><numeric name="n" size="2000000000"/></custom>'), ("top", '<size nuser_body="2000000000"/>'),
    ("inside", '<joint name="j" axis="1 0 0"/>'), ("inside", '<joint name="other" axis="1 0 0"/>'),
)  # fmt: skip


def models(rng: random.Random, folder: Path) -> Case:
    """URDF and MJCF: a small arm that was changed."""
    urdf = rng.random() < 0.4
    parts = {"top": "", "far": "0.5", "size": "0.2", "inside": "", "world": "", "end": ""}
    kind, expected = rng.choice(("as it is", "huge", "entities", "cut", "attribute", "bytes")), INVALID
    if kind == "as it is":
        parts["far"], parts["size"], expected = f"{rng.uniform(0.1, 2):.3f}", f"{rng.uniform(0.1, 2):.3f}", VALID
    elif kind == "huge" and not urdf:
        place, text = rng.choice(_HUGE)
        parts[place] = text
    elif kind == "huge":
        parts["world"] = "".join(f'<link name="l{k}"/>' for k in range(3000))
    elif kind == "attribute":
        parts[rng.choice(("far", "size"))], expected = (
            rng.choice(("nan", "inf", "1e400", "", "a", "0x1", "-1", "1 2", "1e-320")),
            OPEN,
        )
    text = (_URDF if urdf else _ARM).format(**parts)
    if kind == "entities":
        text = _BOMB + text
    data = text.encode()
    if kind == "cut":
        data = data[: rng.randint(0, len(data) - 8)]
    elif kind == "bytes":
        data, expected = _flipped(rng, data), OPEN
    name = "arm.urdf" if urdf else "arm.xml"
    (folder / name).write_bytes(data)
    path = folder / "arm.yaml"
    path.write_text(f"name: arm\nmodel: {name}\nbase: {{type: fixed, body: b}}\narm: {{joints: [j], tool: t}}\n")
    return Case(f"{name}: {kind}: {text[:60]!r}", expected, call=lambda: _load_robot(path))


def _flipped(rng: random.Random, data: bytes) -> bytes:
    out = bytearray(data)
    for _ in range(rng.randint(1, 8)):
        out[rng.randrange(len(out))] = rng.randrange(256)
    return bytes(out)


# ---------------------------------------------------------------------- recordings
@cache
def _recording() -> bytes:
    """A small whole recording."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        file = McapFile(path)
        file.metadata("run", {"experiment": "toy", "seed": 7, "started": "then", "settings": '{"a": 1}'})
        file.attach(
            "scene.json", {"robot": "b", "bodies": [{"name": "b", "parent": "world", "moves": True}], "shapes": []}
        )
        for k in range(20):
            header = {"stamp": stamp(0.01 * k), "frame_id": "map"}
            pose = np.array([k, 0, 0, 0, 0, 0, 1.0])
            file.put("/hand/pose", "geometry_msgs/PoseStamped", 0.01 * k, {"header": header, "pose": pose})
            frame = {"header": header, "child_frame_id": "b", "transform": pose}
            file.put("/tf", "tf2_msgs/TFMessage", 0.01 * k, {"transforms": [frame]})
            joints = {"header": header, "name": ["a", "b"], "position": pose[:2], "velocity": [], "effort": []}
            file.put("/joint_states", "sensor_msgs/JointState", 0.01 * k, joints)
        file.metadata("result", {"completed": "true", "metrics": '{"error": 0.1}'})
        file.close()
        return path.read_bytes()


def recordings(rng: random.Random, folder: Path) -> Case:
    """Recordings: cut, with other bytes, with a chunk that says it is huge."""
    data = _recording()
    kind, expected = rng.choice(("as it is", "cut", "bytes", "magic", "chunk")), OPEN
    if kind == "as it is":
        expected = VALID
    elif kind == "cut":
        data = data[: rng.randint(0, len(data))]
        expected = INVALID if len(data) < 8 else OPEN
    elif kind == "bytes":
        data = data[:8] + _flipped(rng, data[8:])
    elif kind == "magic":
        data, expected = bytes(rng.randrange(1, 256) for _ in range(8)) + data[8:], INVALID
    else:
        data = data.replace(b"zstd", rng.choice((b"lz4\0", b"zst\xff", b"\xff\xff\xff\xff")), 1)
    path = folder / "run.mcap"
    path.write_bytes(data)
    todo = rng.choice((["log", "info", str(path)], ["log",
    "export", str(path), "--out", str(folder / "export"), "--force"],
                       ["compare", str(path), str(path), "--out", str(folder / "page.html"), "--force"]))  # fmt: skip
    # without topics there is nothing to compare; info alone takes every recording
    return Case(f"{' '.join(todo[:2])}: {kind}", expected if todo[1] == "info" or expected == INVALID else OPEN, todo)


def messages(rng: random.Random, folder: Path) -> Case:
    """Bytes of ROS messages."""
    kind = rng.choice(list(DEFINITIONS))
    data = encode(kind, {}, look=_look, missing={})
    how, expected = rng.choice(("as it is", "cut", "longer", "bytes", "noise", "header")), OPEN
    if how == "as it is":
        expected = VALID
    elif how == "cut":
        data = data[: rng.randint(0, len(data) - 1)]
        # the end of an empty text or list may be a part of the padding
        expected = INVALID if len(data) < 4 else OPEN
    elif how == "longer":
        data, expected = data + bytes(rng.randint(16, 64)), INVALID
    elif how == "bytes" and len(data) > 4:
        data = data[:4] + _flipped(rng, data[4:])
    elif how == "noise":
        data = data[:4] + rng.randbytes(rng.randint(0, 200))
    elif how == "header":
        data, expected = b"\x05\x00\x00\x00" + data[4:], INVALID
    return Case(f"{kind}: {how}: {data[:24].hex()}", expected, call=lambda: decode(kind, data))


def _look(kind: str) -> Any:
    from wbmpc.recording.messages import fields

    return fields(kind)


def scenes(rng: random.Random, folder: Path) -> Case:
    """Scenes in recordings."""
    scene: dict[str, Any] = {
        "robot": "b", "bodies": [{"name": "b", "parent": "world", "moves": True}],
        "shapes": [{"body": "b", "kind": "box", "size": [1.0, 1.0, 1.0], "pose": [0.0, 0, 0, 1, 0, 0, 0],
                    "colour": [1.0, 1, 1, 1], "vertices": [], "faces": []}],
    }  # fmt: skip
    kind, expected = rng.choice(("as it is", "missing", "other", "deep", "text")), INVALID
    text = ""
    if kind == "as it is":
        expected = VALID
    elif kind == "missing":
        del scene[rng.choice(list(scene))]
    elif kind == "other":
        inner: Any = rng.choice((scene, scene["bodies"][0], scene["shapes"][0]))
        inner[rng.choice(list(inner))] = rng.choice((None, 5, [[]], {"a": 1}, [None]))
    elif kind == "deep":
        text = "[" * rng.choice((200, 5000, 200000))
        text += "]" * len(text)
    else:
        text = json.dumps(scene)[: rng.randint(0, 60)]
    text = text or json.dumps(scene)
    return Case(f"scene: {kind}: {text[:60]}", expected, call=lambda: _scene(text))


def _scene(text: str) -> None:
    from wbmpc.recording.reader import Recording, Topic
    from wbmpc.view.replay import Film

    kind = "tf2_msgs/TFMessage"
    header = {"stamp": stamp(0.0), "frame_id": "map"}
    frame = {"header": header, "child_frame_id": "b", "transform": np.array([0, 0, 0, 0, 0, 0, 1.0])}
    topic = Topic(kind, [0.0], [encode(kind, {"transforms": [frame]})])
    Film(Recording(Path("run.mcap"), {"/tf": topic}, {}, {"scene.json": (0.0, text.encode())}, True))


# ---------------------------------------------------------------------- logs and metrics
def runs(rng: random.Random, folder: Path) -> Case:
    """log.npz and metrics.json, compared and calibrated from."""
    n = rng.randint(2, 20)
    arrays: dict[str, Any] = {"hand": np.zeros((n, 3)), "hand.time": np.arange(n) * 0.01}
    metrics: dict[str, Any] = {
        "experiment": "toy", "seed": 1, "completed": True, "reason": "", "settings": {"robot": "swerve-ur10"},
        "metrics": {"error": {"value": 0.1, "unit": "m"}},
    }  # fmt: skip
    kind, expected = rng.choice(("as it is", "log cut", "log bytes", "rows", "type", "metric", "json")), INVALID
    text = ""
    if kind == "as it is":
        expected = VALID
    elif kind == "rows":
        arrays["hand"] = rng.choice((np.zeros((n + 1, 3)), np.zeros((n, 3, 3)), np.float64(1.0)))
    elif kind == "type":
        arrays[rng.choice(("hand", "hand.time"))] = rng.choice(
            (np.array(["a"] * n), np.full(n, 1j), np.zeros(n, "M8[s]"))
        )
    elif kind == "metric":
        metrics["metrics"] = rng.choice(([], 5, {"error": 5}, {"error": {"value": "x",
        "unit": "m"}}, {"error": {"value": 1}},
                                         {"error": {"value": [1], "unit": "m"}}, {"error": {"unit": "m"}}))  # fmt: skip
    elif kind == "json":
        text = rng.choice(
            ("", "[]", "5", "{", "[" * 100000, '{"a":' * 5000, '{"metrics": {"a": {"value": NaN, "unit": ""}}}', "null")
        )
    for name in ("a", "b"):
        (folder / name).mkdir(exist_ok=True)
        (folder / name / "metrics.json").write_text(text if kind == "json" else json.dumps(metrics))
        np.savez(folder / name / "log.npz", **arrays)
    if kind in ("log cut", "log bytes"):
        path = folder / "b" / "log.npz"
        data = path.read_bytes()
        path.write_bytes(data[: rng.randint(0, len(data) - 30)] if kind == "log cut" else _flipped(rng, data))
        expected = INVALID if kind == "log cut" else OPEN
    if kind not in ("metric", "json") and rng.random() < 0.5:  # these have no channels of wheels
        return Case(f"calibrate: {kind}", INVALID, ["calibrate", str(folder / "b")])
    paths = [str(folder / "a"), str(folder / "b")]
    return Case(
        f"compare: {kind}: {text[:40]}", expected, ["compare", *paths, "--out", str(folder / "page.html"), "--force"]
    )


# ---------------------------------------------------------------------- calibrations and buses
@cache
def _base() -> tuple[Any, list[str]]:
    from wbmpc.model.robot import load_robot

    robot = load_robot("swerve-ur10")
    return robot, list(robot.state.groups["steer"])


def calibrations(rng: random.Random, folder: Path) -> Case:
    """Calibrations of wheels."""
    from wbmpc.estimation.wheel_calibration import WheelCalibration

    robot, names = _base()
    rows: dict[str, dict[str, Any]] = {
        n: {"steer_offset": 0.001, "wheel_radius": 0.1, "steer_offset_std": 1e-3, "wheel_radius_std": 1e-3}
        for n in names
    }
    data: dict[str, Any] = {"modules": rows}
    kind, expected = (
        rng.choice(("as it is", "never", "twice", "missing", "unknown", "value", "correlation", "soup")),
        INVALID,
    )
    more, name = "", rng.choice(names)
    if kind == "as it is":
        expected = VALID
    elif kind == "never":
        more = f"correlation: {rng.choice(NEVER)}\n"
    elif kind == "twice":
        more = "modules: {}\n"
    elif kind == "missing":
        del rows[name]
    elif kind == "unknown":
        rows[name]["radius"] = 0.1
    elif kind == "value":
        rows[name]["wheel_radius"] = rng.choice((0.0, -0.1, float("nan"), float("inf"), "a", None, [0.1], True, {}))
    elif kind == "correlation":
        data["correlation"] = rng.choice(([], "a", [[1.0]], np.zeros((8, 8)).tolist(), [[None] * 8] * 8))
    else:
        more, expected = f"correlation: {soup(rng)}\n", OPEN
    path = folder / "calibration.yaml"
    Dumper = type("Dumper", (yaml.SafeDumper,), {"ignore_aliases": lambda *_: True})
    path.write_text(yaml.dump(data, Dumper=Dumper) + more, "utf-8", "surrogatepass")
    return Case(
        f"calibration: {kind}: {more[:50]!r}",
        expected,
        call=lambda: WheelCalibration.load(path, robot.base.geometry, names),
    )


def buses(rng: random.Random, folder: Path) -> Case:
    """Files of ``wbmpc ros2``."""
    from wbmpc.ros2.settings import load_settings, settings_of

    robot, _ = _base()
    known = keys(settings_of(robot))
    key = rng.choice(known)
    kind, expected = rng.choice(("nothing", "never", "twice", "unknown", "soup", "number")), INVALID
    value: str = {
        "nothing": "", "never": rng.choice(NEVER), "twice": "1", "unknown": "1", "soup": soup(rng),
        "number": repr(rng.uniform(-1, 1) * 10.0 ** rng.randint(-320, 300)),
    }[kind]  # fmt: skip
    *parents, last = key.split(".")
    last += "_x" if kind == "unknown" else ""
    text = "".join(f"{'  ' * i}{p}:\n" for i, p in enumerate(parents)) + f"{'  ' * len(parents)}{last}: {value}\n"
    if kind == "twice":
        text += text
    if kind == "nothing":
        text, expected = rng.choice(("", "# nothing\n", "{}\n")), VALID
    elif kind in ("soup", "number"):
        expected = OPEN
    path = folder / "bus.yaml"
    path.write_text(text, "utf-8", "surrogatepass")
    return Case(f"bus: {kind}: {text[:60]!r}", expected, call=lambda: load_settings(path, robot))


#: By kind: how many of a hundred cases, and what makes one.
KINDS: dict[str, tuple[int, Callable[[random.Random, Path], Case]]] = {
    "settings": (32, settings), "robots": (10, robots), "models": (12, models),
    "recordings": (8, recordings), "messages": (16, messages),
    "scenes": (5, scenes), "runs": (4, runs), "calibrations": (6, calibrations), "buses": (7, buses),
}  # fmt: skip


def make(kind: str, seed: int, number: int, folder: Path) -> Case:
    """Case ``number`` of a kind: the same for the same seed. Its files go into ``folder``."""
    rng = random.Random(zlib.crc32(f"{kind} {seed} {number}".encode()))
    return KINDS[kind][1](rng, folder)


__all__ = ["KINDS", "Accepted", "Case", "InputError", "make", "registry"]
