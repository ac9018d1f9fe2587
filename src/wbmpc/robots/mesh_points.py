"""Points of a mesh file, for measures that need no faces."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.input_file import read_file
from wbmpc.robots.file_limits import LARGEST_MESH

#: Bytes before the first triangle of a binary STL file, and of each: normal, three points, an attribute.
_HEAD, _TRIANGLE = 84, np.dtype([("normal", "<f4", 3), ("points", "<f4", (3, 3)), ("attribute", "<u2")])
_VERTICES = {
    ".stl": re.compile(rb"^\s*vertex\s+(.+)$", re.MULTILINE),
    ".obj": re.compile(rb"^\s*v\s+(.+)$", re.MULTILINE),
}


def mesh_points(path: Path) -> Array | None:
    """Points (n, 3) of an STL or OBJ file in its own unit; None of other formats, of files that cannot be read or are too large, and of
    what holds no finite points."""
    kind = path.suffix.lower()
    if kind not in _VERTICES:
        return None
    try:
        data = read_file(path, LARGEST_MESH)
        points = _binary(data) if kind == ".stl" else None
        if points is None:
            words = [line.split()[:3] for line in _VERTICES[kind].findall(data)]
            points = np.array([[float(word) for word in row] for row in words if len(row) == 3], float)
    except (InputError, ValueError):
        return None
    return points if points.size and np.isfinite(points).all() else None


def _binary(data: bytes) -> Array | None:
    """Points of a binary STL file; None of what has not the length of one."""
    count = int.from_bytes(data[_HEAD - 4 : _HEAD], "little")
    if len(data) != _HEAD + count * _TRIANGLE.itemsize:
        return None
    return np.frombuffer(data, _TRIANGLE, offset=_HEAD)["points"].reshape(-1, 3).astype(float)
