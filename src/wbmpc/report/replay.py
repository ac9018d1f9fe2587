"""The replay of a run inside its report: numbers for ``replay.js``, which draws them with WebGL."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from wbmpc.arrays import Array
from wbmpc.plots.motion import Motion, Part
from wbmpc.report.document import beside

#: Whole numbers of 16 bits stand for positions between two ends, and for components of quaternions; this one for no number.
_FULL, _NONE = 32766, -32768
#: Positions farther away [m] are drawn there.
_FAR = 1000.0
#: Triangles of a world's meshes, at most; of larger ones boxes are drawn.
TRIANGLES = 60_000


def replay(motion: Motion | None) -> str:
    """The section of the page; nothing for a run of which there are no pictures."""
    parts = [] if motion is None else [part for part in motion.parts if len(part.times) > 1]
    if not parts:
        return ""
    return f"""<h2 id="replay">Replay</h2>{_player(parts, _LEGEND + " A click on a plot goes to its time.")}
<script>addEventListener("load", () => {{ {beside("replay.js")} }})</script>"""


def inline(motion: Motion) -> str:
    """The same as a page of its own without anything else, for a frame inside another page. One picture stands still, without a bar."""
    parts = [part for part in motion.parts if part.times]
    plays = any(len(part.times) > 1 for part in parts)
    still = "" if plays else ".replay .bar { display: none }"
    predicted = any(np.isfinite(points[2:]).any() for part in parts for points in part.points)
    return f"""<!doctype html><html lang="en"><meta charset="utf-8"><title>Robot</title><style>{beside("page.css")}
body {{ background: none }} .replay canvas {{ height: calc(100vh - {100 if plays else 40}px) }} {still}</style>
{_player(parts, _LEGEND if predicted else "Drag to turn.")}<script>{beside("replay.js")}</script></html>"""


_LEGEND = (
    " ".join(
        f'<span class="entry"><span class="{kind}">■</span> {text}</span>'
        for kind, text in (
            ("trail", "end effector"),
            ("goal", "its reference"),
            ("plan", "predicted"),
            ("base", "predicted base."),
        )
    )
    + " Drag to turn."
)


def _player(parts: Sequence[Part], hint: str) -> str:
    data = json.dumps([_part(part) for part in parts], separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return f"""<div class="card replay">
<canvas tabindex="0" aria-label="The robot"></canvas>
<div class="bar"><button type="button" class="play">Play</button><input type="range" aria-label="Time" min="0" value="0" step="any">
<output></output><select class="speed" aria-label="Speed"><option value="0.25">¼ ×</option><option value="0.5">½ ×</option>
<option value="1" selected>1 ×</option><option value="2">2 ×</option><option value="5">5 ×</option></select>
<select class="part" aria-label="Part" hidden></select><button type="button" class="out" aria-label="Farther">−</button>
<button type="button" class="in" aria-label="Nearer">+</button><label><input type="checkbox" class="follow" checked> follow</label></div>
<p class="hint">{hint}</p>
<script type="application/json" class="data">{data}</script></div>"""


def _part(part: Part) -> dict[str, Any]:
    poses, points = (np.array(rows, float) for rows in (part.poses, part.points))
    poses[..., :3] = np.clip(np.nan_to_num(poses[..., :3]), -_FAR, _FAR)
    points = np.clip(points, -_FAR, _FAR)
    moves = np.ptp(poses, axis=0).max(axis=1) > 1e-6
    places = np.concatenate([poses[:, moves, :3].reshape(-1, 3), points.reshape(-1, 3)])
    low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    middle, half = 0.5 * (low + high), max(float((high - low).max()) / 2.0, 1e-3)
    whole = lambda values: np.where(np.isfinite(values), np.round(values * _FULL), _NONE).astype("<i2")
    moving = np.concatenate([(poses[:, moves, :3] - middle) / half, np.clip(poses[:, moves, 3:], -1.0, 1.0)], axis=2)
    crowded = sum(len(shape["faces"]) for shape in part.shapes) > 3 * TRIANGLES
    return {
        "name": part.name, "robot": part.robot, "middle": middle.tolist(), "half": half, "full": _FULL, "none": _NONE,
        "times": _packed(np.array(part.times, "<f8")), "bodies": poses[0].round(6).tolist(), "moving": np.flatnonzero(moves).tolist(),
        "poses": _packed(whole(moving)), "points": _packed(whole((points - middle) / half)), "count": points.shape[1],
        "shapes": [_shape(shape, crowded) for shape in part.shapes if shape["kind"] != "plane"],
    }  # fmt: skip


def _shape(shape: Any, crowded: bool) -> dict[str, Any]:
    kept = {k: np.round(shape[k], 6).tolist() for k in ("body", "size", "pose", "color")} | {"kind": shape["kind"]}
    if shape["kind"] != "mesh":
        return kept
    corners = np.reshape(shape["vertices"], (-1, 3))
    if crowded:
        low, high = corners.min(axis=0), corners.max(axis=0)
        return kept | {"kind": "box", "size": ((high - low) / 2).tolist(), "offset": ((high + low) / 2).tolist()}
    return kept | {"vertices": _packed(corners.astype("<f4")), "faces": _packed(np.array(shape["faces"], "<u4"))}


def _packed(array: Array) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
