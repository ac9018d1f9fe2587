"""Recordings, ROS messages and scenes."""

from __future__ import annotations

import json
import random
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fuzzing.case import INVALID, OPEN, VALID, Case, flipped
from wbmpc.recording.messages import DEFINITIONS, decode, encode
from wbmpc.recording.writer import McapFile, stamp

DEFINITION_NAMES = sorted(DEFINITIONS)


@cache
def _recording(kind: str = "", other: str = "", topic: str = "/ground_truth/end_effector") -> bytes:
    """A small whole recording. Of a ``kind`` that is given there are messages on /mixed whose bytes are those of an ``other``."""
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
            file.put(topic, "geometry_msgs/PoseStamped", 0.01 * k, {"header": header, "pose": pose})
            frame = {"header": header, "child_frame_id": "b", "transform": pose}
            file.put("/tf", "tf2_msgs/TFMessage", 0.01 * k, {"transforms": [frame]})
            joints = {"header": header, "name": ["a", "b"], "position": pose[:2], "velocity": [], "effort": []}
            if kind:
                file.put_bytes("/mixed", kind, 0.01 * k, encode(other, {}, lookup=_look, missing={}))
            file.put("/joint_states", "sensor_msgs/JointState", 0.01 * k, joints)
        file.metadata("result", {"completed": "true", "metrics": '{"error": 0.1}'})
        file.close()
        return path.read_bytes()


def recordings(rng: random.Random, folder: Path) -> Case:
    """Recordings: cut, with other bytes, with a chunk that says it is huge."""
    data = _recording()
    kind = rng.choice(("as it is", "cut", "end", "bytes", "magic", "chunk", "size", "schema", "name"))
    expected = OPEN
    if kind == "as it is":
        expected = VALID
    elif kind == "cut":
        data = data[: rng.randint(0, len(data))]
        expected = INVALID if len(data) < 8 else OPEN
    elif kind == "bytes":
        data = data[:8] + flipped(rng, data[8:])
    elif kind == "magic":
        data, expected = bytes(rng.randrange(1, 256) for _ in range(8)) + data[8:], INVALID
    elif kind == "end":  # in the summary and its index
        data = data[: -rng.randint(1, len(data) // 4)]
    elif kind == "size":  # of a record, or of the chunk in it
        at = data.index(b"zstd") - rng.choice((0, 8, 16, 24, 32, 37, 45))
        data = data[:at] + rng.choice((2**64 - 1, 2**63, 2**40, 0, 1)).to_bytes(8, "little") + data[at + 8 :]
    elif kind == "schema":
        kinds = rng.sample(DEFINITION_NAMES, 2)
        data = _recording(kinds[0], kinds[1])
    elif kind == "name":
        data = _recording(
            topic=rng.choice(("", "/", "/a\nb", "/\x1b[31mred", "/" + "x" * 5000, "\u202e/tf", "/tf ", '/a,b"c'))
        )
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
    data = encode(kind, {}, lookup=_look, missing={})
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
        data = data[:4] + flipped(rng, data[4:])
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
                    "color": [1.0, 1, 1, 1], "vertices": [], "faces": []}],
    }  # fmt: skip
    kind, expected = rng.choice(("as it is", "missing", "other", "deep", "text")), INVALID
    text: str | None = None
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
    text = json.dumps(scene) if text is None else text
    return Case(f"scene: {kind}: {text[:60]}", expected, call=lambda: _scene(text))


def _scene(text: str) -> None:
    from wbmpc.recording.reader import Recording, Topic
    from wbmpc.view.replay import Film

    kind = "tf2_msgs/TFMessage"
    header = {"stamp": stamp(0.0), "frame_id": "map"}
    frame = {"header": header, "child_frame_id": "b", "transform": np.array([0, 0, 0, 0, 0, 0, 1.0])}
    topic = Topic(kind, "run.mcap: /tf", [0.0], [encode(kind, {"transforms": [frame]})])
    Film(Recording(Path("run.mcap"), {"/tf": topic}, {}, {"scene.json": (0.0, text.encode())}, True))
