"""Files of runs, calibrations and buses."""

from __future__ import annotations

import json
import random
import warnings
import zipfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fuzzing.case import INVALID, NEVER, OPEN, VALID, Case, flipped, soup
from wbmpc.configuration import keys


def runs(rng: random.Random, folder: Path) -> Case:
    """log.npz and metrics.json, compared and calibrated from."""
    n = rng.randint(2, 20)
    arrays: dict[str, Any] = {"hand": np.zeros((n, 3)), "hand.time": np.arange(n) * 0.01}
    metrics: dict[str, Any] = {
        "experiment": "toy", "seed": 1, "completed": True, "reason": "", "settings": {"robot": "swerve-ur10"},
        "metrics": {"error": {"value": 0.1, "unit": "m"}},
    }  # fmt: skip
    kind, expected = (
        rng.choice(("as it is", "log cut", "log bytes", "rows", "type", "metric", "json", "archive", "field")),
        INVALID,
    )
    text = ""
    if kind == "as it is":
        expected = VALID
    elif kind == "rows":
        arrays[rng.choice(("hand", "hand.time"))] = rng.choice(
            (np.zeros((n + 1, 3)), np.zeros((n, 3, 3)), np.float64(1.0))
        )
    elif kind == "type":
        arrays[rng.choice(("hand", "hand.time"))] = rng.choice(
            (np.array(["a"] * n), np.full(n, 1j), np.zeros(n, "M8[s]"))
        )
    elif kind == "metric":
        metrics["metrics"] = rng.choice(([], 5, {"error": 5}, {"error": {"value": "x",
        "unit": "m"}}, {"error": {"value": 1}},
                                         {"error": {"value": [1], "unit": "m"}}, {"error": {"unit": "m"}}))  # fmt: skip
    elif kind == "field":
        metrics[rng.choice(("experiment", "completed", "reason", "settings", "metrics"))] = rng.choice(
            (5, [], [[]], 1.5, {"a": "\x1b[31m"})
        )
        expected = OPEN
    elif kind == "json":
        text = rng.choice(
            ("", "[]", "5", "{", "[" * 100000, '{"a":' * 5000, '{"metrics": {"a": {"value": NaN, "unit": ""}}}', "null")
        )
    for name in ("a", "b"):
        (folder / name).mkdir(exist_ok=True)
        (folder / name / "metrics.json").write_text(text if kind == "json" else json.dumps(metrics))
        np.savez(folder / name / "log.npz", **arrays)
    if kind == "archive":
        expected = _archive(rng, folder / "b" / "log.npz")
    if kind in ("log cut", "log bytes"):
        path = folder / "b" / "log.npz"
        data = path.read_bytes()
        path.write_bytes(data[: rng.randint(0, len(data) - 30)] if kind == "log cut" else flipped(rng, data))
        expected = INVALID if kind == "log cut" else OPEN
    if kind not in ("metric", "json") and rng.random() < 0.5:  # these have no channels of wheels
        return Case(f"calibrate: {kind}", INVALID, ["calibrate", str(folder / "b")])
    paths = [str(folder / "a"), str(folder / "b")]
    return Case(
        f"compare: {kind}: {text[:40]}", expected, ["compare", *paths, "--out", str(folder / "page.html"), "--force"]
    )


# ---------------------------------------------------------------------- calibrations and buses
class _Loud:
    """What must never be unpickled."""

    def __reduce__(self) -> Any:
        return print, ("unpickled",)


def _archive(rng: random.Random, path: Path) -> str:
    """Make a log.npz that is a ZIP file, and no log; what is expected of it."""
    kind = rng.choice(("pickle", "bomb", "shape", "type", "names", "empty", "text"))
    if kind == "pickle":
        np.savez(path, hand=np.array([_Loud()], dtype=object))
        return INVALID
    head = {
        "shape": "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }",
        "type": "{'descr': '|O', 'fortran_order': False, 'shape': (3,), }",
        "text": "__import__('os')",
    }.get(kind, "{'descr': '<f8', 'fortran_order': False, 'shape': (1,), }")
    member = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head.encode() + bytes(8)
    with warnings.catch_warnings(), zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        warnings.simplefilter("ignore")  # equal names
        names = {"names": ("hand.npy", "hand.npy", "../hand.npy"), "empty": ()}.get(kind, ("hand.npy",))
        for name in names:
            archive.writestr(name, bytes(80_000_000) if kind == "bomb" else member)
    return OPEN if kind == "empty" else INVALID


@cache
def _base() -> tuple[Any, list[str]]:
    from wbmpc.model.robot import load_robot

    robot = load_robot("swerve-ur10")
    return robot, list(robot.state.groups["steer"])


def calibrations(rng: random.Random, folder: Path) -> Case:
    """Calibrations of wheels."""
    from wbmpc.bases.swerve.wheel_calibration import WheelCalibration

    robot, names = _base()
    rows: dict[str, dict[str, Any]] = {
        n: {"steer_offset": 0.001, "wheel_radius": 0.1, "steer_offset_std": 1e-3, "wheel_radius_std": 1e-3}
        for n in names
    }
    data: dict[str, Any] = {"modules": rows}
    kind, expected = (
        rng.choice(
            ("as it is", "never", "twice", "missing", "unknown", "value", "far", "robot", "correlation", "soup")
        ),
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
    elif kind == "far":
        key = rng.choice(("steer_offset", "leg_offset", "wheel_radius", "steer_offset_std", "wheel_radius_std"))
        rows[name][key] = rng.choice((-1.0, 1.0)) * 10.0 ** rng.uniform(0.0, 300.0)
    elif kind == "robot":
        data["robot"] = rng.choice(("swerve-fixed-ur10", "", 5, True, ["swerve-ur10"], {}))
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
        call=lambda: WheelCalibration.load(path, robot.base.geometry, names, robot.description.name),
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
